"""A share of choices against chance, with the participant as the unit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from scipy import special, stats

from analysis.log_tails import log10_binomial, log10_t, p_t
from analysis.results import (
    OK,
    TOO_FEW_SUBJECTS,
    UNDEFINED,
    ZERO_ERROR_VARIANCE,
    coded,
    numbers,
    require_columns,
    result_table,
)
from stimuli.errors import InputError, problem

COLUMNS = ["k", "n", "share", "p", "log10_p", "exact_low", "exact_high", "wilson_low", "wilson_high"]


def exact_interval(k: float, n: float, level: float = 0.95) -> tuple[float, float]:
    """Clopper & Pearson (1934); ``k`` and ``n`` may be fractional (Korn & Graubard 1998)."""
    tail = (1 - level) / 2
    low = float(special.betaincinv(k, n - k + 1, tail)) if k > 0 else 0.0
    high = float(special.betaincinv(k + 1, n - k, 1 - tail)) if k < n else 1.0
    return low, high


def wilson_interval(share: float, n: float, level: float = 0.95) -> tuple[float, float]:
    """Wilson's (1927) score interval, exactly 0 or 1 at the ends."""
    z2 = float(special.ndtri(0.5 + level / 2)) ** 2
    centre = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = math.sqrt(z2 * (share * (1 - share) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    return (0.0 if share <= 0 else max(0.0, centre - half)), (1.0 if share >= 1 else min(1.0, centre + half))


def _counts_row(k: int, n: int, p0: float) -> dict[str, Any]:
    """One answer a participant: the exact binomial test."""
    if n == 0:
        nothing = dict.fromkeys(COLUMNS[2:], math.nan)
        return {"k": k, "n": n, **nothing, "status": UNDEFINED, "note": "no answers"}
    low, high = exact_interval(k, n)
    wilson_low, wilson_high = wilson_interval(k / n, n)
    log10_p = log10_binomial(k, n, p0)
    p = float(stats.binomtest(k, n, p0).pvalue) if 0 < p0 < 1 else 10.0**log10_p
    return {
        "k": k,
        "n": n,
        "share": k / n,
        "p": min(p, 1.0),
        "log10_p": math.log10(p) if p > 1e-280 and p < 1 else log10_p,
        "exact_low": low,
        "exact_high": high,
        "wilson_low": wilson_low,
        "wilson_high": wilson_high,
        "status": OK,
        "note": "",
    }


def _whole(what: str, value: Any) -> int:
    if isinstance(value, bool) or not float(value).is_integer() or value < 0:
        raise InputError(problem("binomial_choice", what, value, "a whole number that is not negative"))
    return int(value)


def binomial_choice(
    k: Any = None,
    n: Any = None,
    p0: float = 0.5,
    *,
    choice: str | None = None,
    observer: str | None = None,
    table: pd.DataFrame | None = None,
) -> pd.DataFrame:
    """Is the share of a choice p0? ``(k, n, p0=)``: k of n participants, or ``(table, choice=, observer=, p0=)``.

    Counts (or arrays of them, a row each): two-sided exact binomial p (outcomes not more likely than k), Clopper &
    Pearson and Wilson 95 % intervals. With a table, ``choice`` holds true/1 where the answer was the one asked about
    (missing answers are left out), and the participant is the unit: n participants, ``share`` the mean of their
    shares, k = share n. Where each gave one answer this is the test on counts. With more, p is that of Student's t on
    the participants' shares, and the intervals are Korn & Graubard's (1998) and Wilson's at the effective sample size
    share (1 - share) / SE^2, with their correction for degrees of freedom (t(n - 1) for z). The counts of trials
    stand in ``attrs['pooled, not for inference']``. Raises InputError for unknown columns, k > n, or p0 outside [0,
    1].
    """
    if not 0 <= p0 <= 1:
        raise InputError(problem("binomial_choice", "p0", p0, "a probability"))
    if isinstance(k, pd.DataFrame):
        table, k = k, None
    if table is None:
        if k is None or n is None:
            raise InputError(problem("binomial_choice", "arguments", "neither counts nor a table", "k and n, or table"))
        ks, ns = np.broadcast_arrays(np.atleast_1d(k), np.atleast_1d(n))
        rows = []
        for one_k, one_n in zip(ks.ravel().tolist(), ns.ravel().tolist(), strict=True):
            if one_k > one_n:
                raise InputError(problem("binomial_choice", "k", one_k, f"at most n = {one_n}"))
            rows.append(_counts_row(_whole("k", one_k), _whole("n", one_n), p0))
        method = f"Exact two-sided binomial test against {p0:g}, one answer a participant."
        return result_table(rows, COLUMNS, method=method, n_subjects=int(ns.sum()))
    if choice is None or observer is None:
        raise InputError(problem("binomial_choice", "arguments", "a table alone", "choice= and observer= with it"))
    return _table_choice(table, choice, observer, p0)


def _table_choice(table: pd.DataFrame, choice: str, observer: str, p0: float) -> pd.DataFrame:
    require_columns("binomial_choice", table, [choice, observer])
    y = numbers("binomial_choice", table, choice)
    person, observers = coded(table, observer)
    use = np.isfinite(y) & (person >= 0)
    if not np.isin(y[use], (0.0, 1.0)).all():
        raise InputError(problem("binomial_choice", f"column {choice!r}", "other values", "true or false (1 or 0)"))
    trials = np.bincount(person[use], minlength=len(observers))
    chosen = np.bincount(person[use], weights=y[use], minlength=len(observers))
    answered = trials > 0
    dropped = {observers[i]: "gave no valid answer: left out" for i in np.flatnonzero(~answered)}
    trials, chosen = trials[answered], chosen[answered]
    n, k_trials, n_trials = len(trials), int(chosen.sum()), int(trials.sum())
    pooled = {"k": k_trials, "n": n_trials, "share": k_trials / n_trials if n_trials else math.nan}
    attrs = {"pooled, not for inference": pooled, "trials": n_trials}
    if n == 0 or trials.max() == 1:
        row = _counts_row(k_trials, n, p0)
        method = f"Exact two-sided binomial test against {p0:g}, one answer a participant."
        return result_table([row], COLUMNS, method=method, n_subjects=n, dropped=dropped, attrs=attrs)
    shares = chosen / trials
    share = float(shares.mean())
    se = float(shares.std(ddof=1)) / math.sqrt(n) if n > 1 else math.nan
    method = f"Student's t test of the participants' shares against {p0:g}; the participant is the unit."
    row = {"k": share * n, "n": n, "share": share, "status": OK, "note": ""}
    if n < 2:
        row |= dict.fromkeys(COLUMNS[3:], math.nan)
        row |= {"status": TOO_FEW_SUBJECTS, "note": "one participant: no inference about others"}
    elif se < 1e-12:
        row |= _alike_row(share, n, p0)
    else:
        t = (share - p0) / se
        # Effective number of independent answers, and how far t quantiles widen the interval.
        widen = float(special.ndtri(0.975) / special.stdtrit(n - 1, 0.975)) ** 2
        n_effective = share * (1 - share) / se**2 * widen
        low, high = exact_interval(share * n_effective, n_effective)
        wilson_low, wilson_high = wilson_interval(share, n_effective)
        row |= {"p": p_t(t, n - 1), "log10_p": log10_t(t, n - 1), "exact_low": low, "exact_high": high}
        row |= {"wilson_low": wilson_low, "wilson_high": wilson_high}
        attrs["t"], attrs["df"], attrs["se"] = t, n - 1, se
    return result_table([row], COLUMNS, method=method, n_subjects=n, dropped=dropped, attrs=attrs)


def _alike_row(share: float, n: int, p0: float) -> dict[str, Any]:
    """Every participant has the same share: the sign test over participants is all that can be said."""
    if abs(share - p0) < 1e-12:
        return {"p": 1.0, "log10_p": 0.0} | _intervals(
            share, n, UNDEFINED, "all participants have exactly the share p0"
        )
    k = n if share > p0 else 0
    log10_p = log10_binomial(k, n, p0)
    note = f"all {n} participants have the same share: p is that of the exact sign test over participants"
    return {"p": 10.0**log10_p, "log10_p": log10_p} | _intervals(share, n, ZERO_ERROR_VARIANCE, note)


def _intervals(share: float, n: int, status: str, note: str) -> dict[str, Any]:
    low, high = exact_interval(share * n, n)
    wilson_low, wilson_high = wilson_interval(share, n)
    return {
        "exact_low": low,
        "exact_high": high,
        "wilson_low": wilson_low,
        "wilson_high": wilson_high,
        "status": status,
        "note": note,
    }
