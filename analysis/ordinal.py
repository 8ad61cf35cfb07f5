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

from analysis.formula import ModelFrame, independent_columns, model_frame
from analysis.laplace import fit_crossed
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
from analysis.threshold_model import LINKS, Bounds, ThresholdFit, collapsed, fit_fixed, fit_mixed, separation_direction
from stimuli.errors import InputError, problem

MAX_CATEGORIES = 100
COLUMNS = ["term", "estimate", "se", "z", "p", "log10_p", "ci_low", "ci_high"]


def cumulative_link(
    table: pd.DataFrame,
    formula: str,
    random: str | Sequence[str] | None = None,
    link: str = "logit",
    nodes: int = 21,
) -> pd.DataFrame:
    """Cumulative link (mixed) model by maximum likelihood: P(Y <= j) = F(threshold_j - x'b - u).

    ``formula`` 'rating ~ a * b'; categories in numeric, categorical or sorted order, unused ones left out. Terms are
    named as R names them, thresholds ``1|2`` first. ``random``: '(1|participant)' or the column's name: normal
    intercepts, integrated by adaptive Gauss-Hermite quadrature with ``nodes`` nodes (1: Laplace); several, a list:
    Laplace. ``link``: logit, probit, cloglog. ``attrs``: log_likelihood, aic, n, random_sd {name: SD}. A random SD
    of 0 makes rows ``boundary`` (the numbers are those of the model without it). Complete or quasi-complete
    separation is found before fitting by linear programming. Raises InputError for unknown columns or formulas.
    """
    one_of("cumulative_link", "link", link, LINKS)
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
    return _fit(
        frame,
        Bounds(upper, lower, top, bottom, np.ones(n)),
        start,
        labels,
        aliased,
        link,
        nodes,
        j,
        what,
        np.ones(j + q),
    )


def binomial_mixed(
    table: pd.DataFrame,
    formula: str,
    random: str | Sequence[str] | None = None,
    link: str = "logit",
    nodes: int = 21,
    likelihood_ratio: bool = False,
) -> pd.DataFrame:
    """Logistic (or probit) regression of a true/false answer with a random intercept per participant.

    ``formula`` 'chosen ~ a * b'; the response is boolean, 0 / 1, or two levels of which the second counts as success.
    Terms in R's names, ``(Intercept)`` first; ``random``, ``nodes``, ``attrs`` and statuses as in ``cumulative_link``.
    ``likelihood_ratio``: each term is also tested by the fit without it (columns ``p_lr``, ``log10_p_lr``, chi-square
    on 1 df), which keeps the 5 % better than Wald's z with a dozen participants (tests.prove.statistics_calibration).
    """
    one_of("binomial_mixed", "link", link, LINKS[:2])
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
    bounds = Bounds(np.where(one[:, None], 0.0, -x), np.where(one[:, None], -x, 0.0), one, ~one, np.ones(len(y)))
    what = f"Binomial {link} model, {formula}"
    if not len(y):
        made = _nothing(frame, [*labels, *aliased], UNDEFINED, "no valid answer", what)
        return made.assign(p_lr=math.nan, log10_p_lr=math.nan) if likelihood_ratio else made
    made = _fit(frame, bounds, np.zeros(len(used)), labels, aliased, link, nodes, 0, what, np.ones(len(used)))
    if not likelihood_ratio:
        return made
    made["p_lr"], made["log10_p_lr"] = math.nan, math.nan
    for k in np.flatnonzero(made["status"].isin([OK, BOUNDARY]) & made["term"].isin(labels)):
        rest = [j for j in range(len(used)) if j != k]
        without = Bounds(bounds.upper[:, rest], bounds.lower[:, rest], one, ~one, bounds.weight)
        names = [labels[j] for j in rest]
        null = _fit(frame, without, np.zeros(len(rest)), names, [], link, nodes, 0, what, np.ones(len(rest)))
        gain = 2 * (made.attrs["log_likelihood"] - null.attrs["log_likelihood"])
        # the square root of chi-square on 1 df is the absolute value of z
        root = math.sqrt(max(gain, 0.0)) if not math.isnan(gain) else math.nan
        made.loc[k, ["p_lr", "log10_p_lr"]] = [p_z(root), log10_z(root)]
    return made


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
    attrs = {"log_likelihood": math.nan, "random_sd": {}, "n": len(frame.rows)}
    return result_table(rows, COLUMNS, method=what, n_subjects=_groups(frame), dropped=frame.dropped, attrs=attrs)


def _fit(
    frame: ModelFrame,
    bounds: Bounds,
    start: np.ndarray,
    labels: list[str],
    aliased: list[str],
    link: str,
    nodes: int,
    thresholds: int,
    what: str,
    sign: np.ndarray,
) -> pd.DataFrame:
    """Fit, and make the table: one row a threshold or term, then aliased terms and factors with one level."""
    status, note = OK, ""
    for term in frame.random:
        if len(term.levels) < 2:
            lacking = f"{term.name!r} has {len(term.levels)} group: no inference about others"
            return _nothing(frame, [*labels, *aliased, *frame.empty], TOO_FEW_SUBJECTS, lacking, what)
    m = len(frame.random)
    codes_and_designs = [*(term.codes for term in frame.random), *(term.design for term in frame.random)]
    bounds, parts = collapsed(bounds, codes_and_designs)
    random = [replace(t, codes=c, design=d) for t, c, d in zip(frame.random, parts[:m], parts[m:], strict=True)]
    direction = separation_direction(bounds)
    if direction is not None:
        return _separated(frame, direction, labels, aliased, what)
    fit = fit_fixed(bounds, start, link)
    random_sd: dict[str, float] = {}
    extra: dict[str, Any] = {}
    if nodes > 1 and m == 1 and (random[0].design == 1).all():
        fit = fit_mixed(bounds, random[0].codes, fit, link, nodes, thresholds)
        random_sd[random[0].name] = fit.sd
        extra["random_sd_se"] = fit.sd_se
        how = f"adaptive Gauss-Hermite quadrature, {nodes} nodes"
    elif random:
        fit, found = fit_crossed(bounds, random, fit, link, thresholds)
        random_sd = found
        how = "Laplace approximation"
    else:
        how = "maximum likelihood"
    if any(sd == 0 for sd in random_sd.values()):
        status, note = BOUNDARY, "a random intercept's SD is estimated as 0: the model is that without it"
    if not fit.converged:
        status, note = NOT_CONVERGED, "the search for the maximum did not end"
    rows = [_row(label, fit, k, status, note) for k, label in enumerate(labels)]
    rows += _aliased_rows(aliased, "is a linear combination of other terms")
    rows += _aliased_rows(frame.empty, "has one level")
    count = len(labels) + len(random_sd)
    attrs = {
        "log_likelihood": fit.log_likelihood,
        "aic": 2 * count - 2 * fit.log_likelihood,
        "n": len(frame.rows),
        "random_sd": random_sd,
        "covariance": fit.covariance.tolist(),
        **extra,
    }
    method = f"{what}; {', '.join(f'(1|{name})' for name in random_sd) or 'no random effects'}; {how}."
    return result_table(rows, COLUMNS, method=method, n_subjects=_groups(frame), dropped=frame.dropped, attrs=attrs)


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
    frame: ModelFrame, direction: np.ndarray, labels: list[str], aliased: list[str], what: str
) -> pd.DataFrame:
    """No finite maximum: infinite where the likelihood grows without end, nan elsewhere."""
    rows = []
    for label, d in zip(labels, direction, strict=True):
        grows = abs(d) > 1e-9 * float(np.max(np.abs(direction)))
        row: dict[str, Any] = {"term": label, **dict.fromkeys(COLUMNS[1:], math.nan), "status": SEPARATED}
        if grows:
            row |= {"estimate": math.copysign(math.inf, d), "se": math.inf, "ci_low": -math.inf, "ci_high": math.inf}
            row["note"] = "the answers are separated: the likelihood grows without end along this term"
        else:
            row["note"] = "other terms separate the answers: no finite maximum of the likelihood"
        rows.append(row)
    rows += _aliased_rows([*aliased, *frame.empty], "has no coefficient of its own")
    attrs = {"log_likelihood": math.nan, "random_sd": {}, "n": len(frame.rows)}
    return result_table(rows, COLUMNS, method=what, n_subjects=_groups(frame), dropped=frame.dropped, attrs=attrs)
