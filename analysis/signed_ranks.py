"""Wilcoxon's signed-rank test with ties, zeros and the exact conditional distribution."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from analysis.cells import shift_and_scale
from analysis.log_tails import log10_z, p_z
from analysis.ranks import near_ranks
from analysis.results import OK, ROUNDING, TOO_FEW_SUBJECTS, UNDEFINED, one_of, result_table
from stimuli.errors import InputError, problem

COLUMNS = ["statistic", "z", "p", "log10_p", "n_used", "zeros", "rank_biserial"]
EXACT_UP_TO = 50
EXACT_LIMIT = 1000


def paired(where: str, x: Any, y: Any) -> tuple[np.ndarray, np.ndarray, int]:
    """Both as float64 without pairs that lack a value, and how many were left out; InputError if lengths differ."""
    first, second = np.asarray(x, dtype=float).ravel(), np.asarray(y, dtype=float).ravel()
    if len(first) != len(second):
        raise InputError(problem(where, "y", f"{len(second)} values", f"as many as x, {len(first)}"))
    use = np.isfinite(first) & np.isfinite(second)
    return first[use], second[use], int((~use).sum())


def _exact_p(doubled: np.ndarray, statistic: float) -> float:
    """Two-sided p over all sign patterns, given the (doubled, whole) ranks: exact with ties and zeros."""
    total = int(doubled.sum())
    probability = np.zeros(total + 1)
    probability[0] = 1.0
    reached = 0
    for rank in doubled.astype(int):
        # Each rank is in the sum or not, with probability one half.
        shifted = probability[: reached + 1].copy()
        probability[: reached + 1] *= 0.5
        probability[rank : rank + reached + 1] += 0.5 * shifted
        reached += rank
    below = min(statistic, total / 2 - statistic) * 2
    return min(1.0, 2.0 * float(np.sum(probability[: round(below) + 1])))


def wilcoxon(
    x: Any, y: Any = None, zeros: str = "wilcox", exact: bool | None = None, correction: bool = False
) -> pd.DataFrame:
    """Signed-rank test of paired ``x`` and ``y`` (or of ``x`` against 0); one row.

    ``statistic`` is the sum of the ranks of positive differences (R's V). ``zeros``: 'wilcox' drops differences of zero
    before ranking, 'pratt' ranks them and drops their ranks. ``exact``: True for the exact conditional distribution,
    right with ties; False for the normal approximation (tie-corrected variance, no continuity correction unless
    asked for); None: exact for at most 50 pairs. ``z`` is always the approximation's. All differences zero:
    ``undefined``. Pairs with a missing value are left out and counted. Raises InputError for unequal lengths.
    """
    one_of("wilcoxon", "zeros", zeros, ("wilcox", "pratt"))
    first = np.asarray(x, dtype=float).ravel()
    a, b, missing = paired("wilcoxon", first, np.zeros(len(first)) if y is None else y)
    largest = max(float(np.max(np.abs(a), initial=0.0)), float(np.max(np.abs(b), initial=0.0)))
    difference = a - b
    tolerance = ROUNDING * largest
    difference[np.abs(difference) <= tolerance] = 0.0
    none = difference == 0
    kept = difference if zeros == "pratt" else difference[~none]
    dropped = {"missing": f"{missing} pairs without both values"} if missing else {}
    row: dict[str, Any] = {"n_used": int((~none).sum()), "zeros": int(none.sum())}
    method = f"Wilcoxon signed-rank test, zeros: {zeros}."
    if not row["n_used"]:
        row |= dict.fromkeys(("statistic", "z", "p", "log10_p", "rank_biserial"), math.nan)
        row |= {"status": UNDEFINED, "note": "all differences are zero" if len(difference) else "no pairs"}
        return result_table([row], COLUMNS, method=method, n_subjects=len(a), dropped=dropped)
    ranks = near_ranks(np.abs(kept), 2 * tolerance)
    used = kept != 0
    ranks, sign = ranks[used], np.sign(kept[used])
    statistic, total = float(ranks[sign > 0].sum()), float(ranks.sum())
    # Under the null each rank has a random sign: mean total / 2, variance sum of squares / 4.
    away = statistic - total / 2
    if correction:
        away = math.copysign(max(abs(away) - 0.5, 0.0), away)
    z = away / math.sqrt(float(np.sum(ranks**2)) / 4)
    n = len(ranks)
    note = ""
    if exact is None:
        exact = n <= EXACT_UP_TO
    elif exact and n > EXACT_LIMIT:
        exact, note = False, f"more than {EXACT_LIMIT} pairs: normal approximation"
    if exact:
        p = _exact_p(np.round(2 * ranks), statistic)
        log10_p = math.log10(p)
        method = f"Wilcoxon signed-rank test, exact conditional distribution, zeros: {zeros}."
    else:
        p, log10_p = p_z(z), log10_z(z)
        method = f"Wilcoxon signed-rank test, normal approximation with tie correction, zeros: {zeros}."
    row |= {
        "statistic": statistic,
        "z": z,
        "p": p,
        "log10_p": log10_p,
        "rank_biserial": (2 * statistic - total) / total,
    }
    row |= {"status": OK, "note": note}
    if len(a) < 2:
        row |= {"status": TOO_FEW_SUBJECTS, "note": "one pair: p can only be 1"}
    return result_table([row], COLUMNS, method=method, n_subjects=len(a), dropped=dropped)


__all__ = ["paired", "shift_and_scale", "wilcoxon"]
