"""Equivalence of two conditions: two one-sided tests."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from analysis.cells import shift_and_scale
from analysis.log_tails import log10_t_upper
from analysis.results import OK, TOO_FEW_SUBJECTS, UNDEFINED, ZERO_ERROR_VARIANCE, result_table
from analysis.signed_ranks import paired
from stimuli.errors import InputError, problem

COLUMNS = ["mean_diff", "ci_low", "ci_high", "t_low", "t_high", "df", "p_low", "p_high", "p", "log10_p", "n"]


def tost(x: Any, y: Any = None, low: float = -1.0, high: float = 1.0, alpha: float = 0.05) -> pd.DataFrame:
    """Are paired ``x`` and ``y`` (or ``x`` and 0) equivalent, their mean difference within (low, high)? One row.

    Two one-sided t tests (Schuirmann 1987): ``t_low`` against ``low``, ``t_high`` against ``high``, ``p`` the larger of
    their p values; p < alpha where the 1 - 2 alpha interval ``ci_low``, ``ci_high`` (90 % by default) lies within the
    bounds. One value a participant: average trials first. Raises InputError for unequal lengths or low >= high.
    """
    if not low < high:
        raise InputError(problem("tost", "low", low, f"below high = {high}"))
    first = np.asarray(x, dtype=float).ravel()
    a, b, missing = paired("tost", first, np.zeros(len(first)) if y is None else y)
    n = len(a)
    row: dict[str, Any] = dict.fromkeys(COLUMNS, math.nan) | {"n": n, "df": max(n - 1, 0)}
    dropped = {"missing": f"{missing} pairs without both values"} if missing else {}
    method = (
        f"Two one-sided paired t tests against [{low:g}, {high:g}], {1 - 2 * alpha:.0%} interval, {n} participants."
    )
    if n < 2:
        row |= {"status": TOO_FEW_SUBJECTS, "note": f"{n} participants, at least 2 are needed"}
        return result_table([row], COLUMNS, method=method, n_subjects=n, dropped=dropped)
    _, _, _, rounding = shift_and_scale(np.concatenate([a, b]))
    largest = float(np.max(np.abs(np.concatenate([a, b])))) or 1.0
    difference = a - b
    mean = math.fsum(difference) / n
    ss = math.fsum((difference - mean) ** 2)
    zero = 2 * 64 * np.finfo(float).eps * largest if rounding else 0.0
    if not ss > zero**2 * n:
        mean = 0.0 if abs(mean) <= zero else mean
        row |= {"mean_diff": mean, "ci_low": mean, "ci_high": mean}
        row |= {"t_low": _infinite(mean - low, zero), "t_high": _infinite(mean - high, zero)}
        if math.isnan(row["t_low"]) or math.isnan(row["t_high"]):
            row |= {"status": UNDEFINED, "note": "every participant differs by exactly a bound: t is 0 / 0"}
        else:
            inside = low < mean < high
            row |= {"p_low": 0.0 if mean > low else 1.0, "p_high": 0.0 if mean < high else 1.0}
            row |= {"p": 0.0 if inside else 1.0, "log10_p": -math.inf if inside else 0.0}
            row |= {"status": ZERO_ERROR_VARIANCE, "note": "every participant differs by the same amount"}
        return result_table([row], COLUMNS, method=method, n_subjects=n, dropped=dropped)
    se = math.sqrt(ss / (n - 1) / n)
    t_low, t_high = (mean - low) / se, (mean - high) / se
    half = float(special.stdtrit(n - 1, 1 - alpha)) * se
    p_low, p_high = float(special.stdtr(n - 1, -t_low)), float(special.stdtr(n - 1, t_high))
    log10_p = max(log10_t_upper(t_low, n - 1), log10_t_upper(-t_high, n - 1))
    row |= {"mean_diff": mean, "ci_low": mean - half, "ci_high": mean + half, "t_low": t_low, "t_high": t_high}
    row |= {"p_low": p_low, "p_high": p_high, "p": max(p_low, p_high), "log10_p": log10_p, "status": OK, "note": ""}
    return result_table([row], COLUMNS, method=method, n_subjects=n, dropped=dropped)


def _infinite(distance: float, zero: float) -> float:
    return math.copysign(math.inf, distance) if abs(distance) > zero else math.nan
