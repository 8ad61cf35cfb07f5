"""Cumulative link models of ratings and logistic models of choices, with a random intercept per participant."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from analysis.coefficient_tests import (
    LIKELIHOOD_RATIO,
    PARTICIPANTS,
    STATISTICS,
    TESTS,
    WALD,
    ThresholdModel,
    put_tests,
    separated_test,
    usual_test,
)
from analysis.formula import ModelFrame, independent_columns, model_frame
from analysis.joint_scores import joint_tests
from analysis.log_tails import log10_z, p_z
from analysis.results import (
    BOUNDARY,
    NOT_CONVERGED,
    OK,
    SEPARATED,
    TOO_FEW_SUBJECTS,
    UNDEFINED,
    coded,
    numbers,
    one_of,
    result_table,
)
from analysis.threshold_bounds import LINKS, Bounds, collapsed, separation_direction
from analysis.threshold_model import ThresholdFit
from stimuli.errors import InputError, problem

MAX_CATEGORIES = 100
COLUMNS = ["term", "estimate", "se", "z", "p", "log10_p", "ci_low", "ci_high"]


def cumulative_link(
    table: pd.DataFrame,
    formula: str,
    random: str | Sequence[str] | None = None,
    link: str = "logit",
    nodes: int = 21,
    test: str | None = WALD,
) -> pd.DataFrame:
    """Cumulative link (mixed) model by maximum likelihood: P(Y <= j) = F(threshold_j - x'b - u).

    ``formula`` 'rating ~ a * b'; categories in numeric, categorical or sorted order, unused ones left out. Terms are
    named as R names them, thresholds ``1|2`` first. ``random``: '(1|participant)' or the column's name: normal
    intercepts, integrated by adaptive Gauss-Hermite quadrature with ``nodes`` nodes (1: Laplace); several, a list:
    Laplace. ``link``: logit, probit, cloglog. ``attrs``: log_likelihood, aic, n, random_sd {name: SD}. A random SD
    of 0 makes rows ``boundary`` (the numbers are those of the model without it). Complete or quasi-complete
    separation is found before fitting by linear programming. ``test``: p and interval of the terms as in
    ``binomial_mixed`` (None: the usual one); 'wald', the default, is what ordinal's clm and clmm print, and too liberal
    where participants differ in the effect itself. With 'participants' also f_tests [{term, df1, df2, F, p, log10_p}]:
    all coefficients of a term together (`analysis.joint_scores`). Raises InputError for unknown columns or formulas.
    """
    one_of("cumulative_link", "link", link, LINKS)
    one_of("cumulative_link", "test", test, (None, *TESTS))
    frame = model_frame("cumulative_link", table, formula, random)
    codes, levels = coded(table.iloc[frame.rows], frame.response)
    names = [f"{_plain(a)}|{_plain(b)}" for a, b in itertools.pairwise(levels)]
    keep = [j for j, term in enumerate(frame.terms) if term != "(Intercept)"]
    x, terms = frame.x[:, keep], [frame.terms[j] for j in keep]
    # The thresholds take the place of the intercept: what is constant is aliased.
    used = independent_columns(np.column_stack([np.ones(len(x)), x]))
    used = used[used > 0] - 1
    j, n, q = len(names), len(codes), len(used)
    what = f"Cumulative {link} model, {formula}"
    if j > MAX_CATEGORIES:
        return _nothing(frame, terms, UNDEFINED, f"{j + 1} different answers are no rating scale", what)
    upper, lower = np.zeros((n, j + q)), np.zeros((n, j + q))
    rows = np.arange(n)
    top, bottom = codes == j, codes == 0
    upper[rows[~top], codes[~top]] = 1.0
    lower[rows[~bottom], codes[~bottom] - 1] = 1.0
    upper[~top, j:] = -x[~top][:, used]
    lower[~bottom, j:] = -x[~bottom][:, used]
    share = np.cumsum(np.bincount(codes, minlength=j + 1))[:-1] / max(n, 1)
    start = np.concatenate([_quantile(share, link), np.zeros(q)])
    if j == 0:
        note = "all answers are in one category" if n else "no valid answer"
        return _nothing(frame, [*names, *terms], UNDEFINED, note, what)
    labels = [*names, *(terms[k] for k in used)]
    aliased = [t for k, t in enumerate(terms) if k not in set(used.tolist())]
    bounds = Bounds(upper, lower, top, bottom, np.ones(n), np.zeros((n, 2)))
    return _fit(frame, ThresholdModel(bounds, [], start, link, nodes, j), labels, aliased, what, test)


def binomial_mixed(
    table: pd.DataFrame,
    formula: str,
    random: str | Sequence[str] | None = None,
    link: str = "logit",
    nodes: int = 21,
    test: str | None = None,
) -> pd.DataFrame:
    """Logistic (or probit) regression of a true/false answer with a random intercept per participant.

    ``formula`` 'chosen ~ a * b'; the response is boolean, 0 / 1, or two levels of which the second counts as success.
    Terms in R's names, ``(Intercept)`` first; ``random``, ``nodes``, ``attrs`` and statuses as in ``cumulative_link``.

    ``test`` says where p and the interval come from (``z`` = estimate / se is Wald's always). None is the usual one:
    'participants' with one random intercept: the score test whose unit is the participant (columns ``t``, ``df``;
    `analysis.participant_score`), which keeps the 5 % with a dozen participants, whatever they differ in;
    'likelihood_ratio' with several: columns ``chi2`` (1 df), profile-likelihood intervals; 'wald' without any. An
    interval that does not close has an infinite end and a status; where the answers are separated it is one-sided.
    """
    one_of("binomial_mixed", "link", link, LINKS[:2])
    one_of("binomial_mixed", "test", test, (None, *TESTS))
    frame = model_frame("binomial_mixed", table, formula, random)
    part = table.iloc[frame.rows]
    try:
        y = numbers("binomial_mixed", part, frame.response)
    except InputError:
        codes, levels = coded(part, frame.response)
        if len(levels) > 2:
            message = problem("binomial_mixed", f"column {frame.response!r}", f"{len(levels)} levels", "two")
            raise InputError(message) from None
        y = codes.astype(float)
    if not np.isin(y, (0.0, 1.0)).all():
        raise InputError(
            problem("binomial_mixed", f"column {frame.response!r}", "other values", "true or false (1 or 0)")
        )
    used = independent_columns(frame.x)
    aliased = [t for k, t in enumerate(frame.terms) if k not in set(used.tolist())]
    labels, x = [frame.terms[k] for k in used], frame.x[:, used]
    one = y == 1
    # P(1) = 1 - F(-x'b - u): the bounds are -x'b, below for a success and above for a failure.
    upper, lower = np.where(one[:, None], 0.0, -x), np.where(one[:, None], -x, 0.0)
    bounds = Bounds(upper, lower, one, ~one, np.ones(len(y)), np.zeros((len(y), 2)))
    what = f"Binomial {link} model, {formula}"
    if not len(y):
        return _nothing(frame, [*labels, *aliased], UNDEFINED, "no valid answer", what)
    return _fit(frame, ThresholdModel(bounds, [], np.zeros(len(used)), link, nodes, 0), labels, aliased, what, test)


def _plain(level: Any) -> str:
    """A category's name: 2.0, a rating in a column with missing values, is 2."""
    return f"{level:g}" if isinstance(level, float) else str(level)


def _quantile(share: np.ndarray, link: str) -> np.ndarray:
    if link == "logit":
        return np.asarray(special.logit(share))
    return np.asarray(special.ndtri(share)) if link == "probit" else np.log(-np.log1p(-share))


def _groups(frame: ModelFrame) -> int:
    return len(frame.random[0].levels) if frame.random else len(frame.rows)


def _nothing(frame: ModelFrame, terms: list[str], status: str, note: str, what: str) -> pd.DataFrame:
    """A table that says why there is no estimate."""
    empty = dict.fromkeys(COLUMNS[1:], math.nan)
    rows = [{"term": t, **empty, "status": status, "note": note} for t in terms or ["(Intercept)"]]
    attrs = {"log_likelihood": math.nan, "random_sd": {}, "n": len(frame.rows), "references": frame.references}
    return result_table(rows, COLUMNS, method=what, n_subjects=_groups(frame), dropped=frame.dropped, attrs=attrs)


def _fit(
    frame: ModelFrame, model: ThresholdModel, labels: list[str], aliased: list[str], what: str, test: str | None
) -> pd.DataFrame:
    """Fit, and make the table: one row a threshold or term, then aliased terms and factors with one level."""
    status, note = OK, ""
    for term in frame.random:
        if len(term.levels) < 2:
            lacking = f"{term.name!r} has {len(term.levels)} group: no inference about others"
            return _nothing(frame, [*labels, *aliased, *frame.empty], TOO_FEW_SUBJECTS, lacking, what)
    m = len(frame.random)
    codes_and_designs = [*(term.codes for term in frame.random), *(term.design for term in frame.random)]
    bounds, parts = collapsed(model.bounds, codes_and_designs)
    random = [replace(t, codes=c, design=d) for t, c, d in zip(frame.random, parts[:m], parts[m:], strict=True)]
    model = replace(model, bounds=bounds, random=random)
    test = test or usual_test(model)
    if test == PARTICIPANTS and not model.one_intercept:
        raise InputError(problem("test", "random", _random_text(frame), "one random intercept, and nodes above 1"))
    direction = separation_direction(bounds)
    if direction is not None:
        return _separated(frame, model, direction, labels, aliased, what, test)
    fit, random_sd = model.maximum()
    if any(sd == 0 for sd in random_sd.values()):
        status, note = BOUNDARY, "a random intercept's SD is estimated as 0: the model is that without it"
    if not fit.converged:
        status, note = NOT_CONVERGED, "the search for the maximum did not end"
    rows = [_row(label, fit, k, status, note) for k, label in enumerate(labels)]
    if test != WALD:
        put_tests(model, fit, rows, test)
    together = joint_tests(frame, model, fit, labels) if test == PARTICIPANTS and fit.converged else []
    rows += _aliased_rows(aliased, "is a linear combination of other terms")
    rows += _aliased_rows(frame.empty, "has one level")
    count = len(labels) + len(random_sd)
    attrs = {
        "log_likelihood": fit.log_likelihood,
        "aic": 2 * count - 2 * fit.log_likelihood,
        "n": len(frame.rows),
        "references": frame.references,
        "random_sd": random_sd,
        "covariance": fit.covariance.tolist(),
        "test": test,
        "f_tests": together,
        **({"random_sd_se": fit.sd_se} if model.one_intercept else {}),
    }
    method = f"{what}; {_random_text(frame)}; {model.method}; {_HOW_TESTED[test]}."
    return result_table(
        rows, _columns(test), method=method, n_subjects=_groups(frame), dropped=frame.dropped, attrs=attrs
    )


_HOW_TESTED = {
    PARTICIPANTS: "terms are tested by the score with the participant as the unit (t), and intervals hold what that "
    "test does not reject; the coefficients of a term together by the same test (F), over the levels of other factors",
    LIKELIHOOD_RATIO: "terms are tested by the likelihood ratio, with profile-likelihood intervals",
    WALD: "Wald tests and intervals",
}


def _columns(test: str) -> list[str]:
    """Column names of the result: the test's own statistic stands after Wald's z."""
    return [*COLUMNS[:4], *STATISTICS[test], *COLUMNS[4:]]


def _random_text(frame: ModelFrame) -> str:
    return ", ".join(f"(1|{term.name})" for term in frame.random) or "no random effects"


def _row(label: str, fit: ThresholdFit, k: int, status: str, note: str) -> dict[str, Any]:
    estimate, se = float(fit.phi[k]), math.sqrt(max(float(fit.covariance[k, k]), 0.0))
    row: dict[str, Any] = {"term": label, "estimate": estimate, "se": se, "status": status, "note": note}
    z = estimate / se if se > 0 else math.nan
    half = float(special.ndtri(0.975)) * se
    return row | {"z": z, "p": p_z(z), "log10_p": log10_z(z), "ci_low": estimate - half, "ci_high": estimate + half}


def _aliased_rows(terms: list[str], why: str) -> list[dict[str, Any]]:
    empty = dict.fromkeys(COLUMNS[1:], math.nan)
    return [{"term": t, **empty, "status": UNDEFINED, "note": f"{t} {why}: no coefficient"} for t in terms]


def _separated(
    frame: ModelFrame, model: ThresholdModel, direction: np.ndarray, labels: list[str], aliased: list[str], what: str,
    test: str,
) -> pd.DataFrame:  # fmt: skip
    """No finite maximum: infinite where the likelihood grows without end, nan elsewhere.

    Where one term alone separates, its p and the finite end of its interval are the likelihood ratio's.
    """
    rows = []
    grows = np.abs(direction) > 1e-9 * float(np.max(np.abs(direction)))
    for k, (label, d) in enumerate(zip(labels, direction, strict=True)):
        row: dict[str, Any] = {"term": label, **dict.fromkeys(COLUMNS[1:], math.nan), "status": SEPARATED}
        if grows[k]:
            row |= {"estimate": math.copysign(math.inf, d), "se": math.inf, "ci_low": -math.inf, "ci_high": math.inf}
            row["note"] = "the answers are separated: the likelihood grows without end along this term"
            found = separated_test(model, k, d) if k >= model.thresholds else None
            if found is not None:
                row |= {"p": found.p, "log10_p": found.log10_p, "ci_low": found.ci_low, "ci_high": found.ci_high}
                row["note"] += "; p and the interval's finite end, where there are any, are the likelihood ratio's"
        else:
            row["note"] = "other terms separate the answers: no finite maximum of the likelihood"
        rows.append(row)
    rows += _aliased_rows([*aliased, *frame.empty], "has no coefficient of its own")
    attrs = {
        "log_likelihood": math.nan,
        "random_sd": {},
        "n": len(frame.rows),
        "references": frame.references,
        "test": test,
    }
    return result_table(
        rows, _columns(test), method=what, n_subjects=_groups(frame), dropped=frame.dropped, attrs=attrs
    )
