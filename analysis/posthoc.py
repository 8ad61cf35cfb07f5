"""Paired comparisons of a factor's levels after a repeated-measures analysis."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from analysis.cells import cell_means
from analysis.effect_sizes import dz_interval
from analysis.log_tails import log10_t, p_t
from analysis.multiplicity import ALIASES, METHODS, adjust_p
from analysis.results import OK, TOO_FEW_SUBJECTS, UNDEFINED, ZERO_ERROR_VARIANCE, names_of, one_of, result_table

COLUMNS = [
    "a",
    "b",
    "mean_diff",
    "ci_low",
    "ci_high",
    "t",
    "df",
    "p",
    "p_adjusted",
    "log10_p",
    "dz",
    "dz_low",
    "dz_high",
    "n",
]


def paired_t(difference: np.ndarray, rounding: float, level: float = 0.95) -> dict[str, Any]:
    """Student's t test of differences against 0, as one row; differences within ``rounding`` of alike are alike."""
    n = len(difference)
    row: dict[str, Any] = dict.fromkeys(COLUMNS[2:], math.nan) | {"n": n, "df": max(n - 1, 0)}
    if n < 2:
        if n:
            row["mean_diff"] = float(difference[0])
        return row | {"status": TOO_FEW_SUBJECTS, "note": f"{n} complete participants, at least 2 are needed"}
    mean = math.fsum(difference) / n
    ss = math.fsum((difference - mean) ** 2)
    row["mean_diff"] = mean
    if not ss > rounding**2 * n:
        if not abs(mean) > rounding:
            row |= {"mean_diff": 0.0, "ci_low": 0.0, "ci_high": 0.0}
            return row | {"status": UNDEFINED, "note": "no participant differs between the two: t is 0 / 0"}
        infinite = math.copysign(math.inf, mean)
        row |= {"ci_low": mean, "ci_high": mean, "t": infinite, "p": 0.0, "log10_p": -math.inf, "dz": infinite}
        row |= {"dz_low": infinite, "dz_high": infinite}
        return row | {"status": ZERO_ERROR_VARIANCE, "note": "every participant differs by the same amount"}
    sd = math.sqrt(ss / (n - 1))
    se = sd / math.sqrt(n)
    t = mean / se
    half = float(special.stdtrit(n - 1, 0.5 + level / 2)) * se
    row |= {"ci_low": mean - half, "ci_high": mean + half, "t": t, "p": p_t(t, n - 1), "log10_p": log10_t(t, n - 1)}
    row["dz"] = mean / sd
    row["dz_low"], row["dz_high"] = dz_interval(t, n, level)
    return row | {"status": OK, "note": ""}


def posthoc_t(table: pd.DataFrame, dv: str, within: str, subject: str, adjust: str = "holm") -> pd.DataFrame:
    """Paired t tests of every pair of levels of ``within``; one row a pair, ``mean_diff`` = a - b.

    Values are averaged per participant and level (over repetitions and other factors); participants without every
    level are left out by name, as in ``rm_anova``. 95 % intervals of the difference are not adjusted; dz = mean / SD of
    the differences, with its interval by the noncentral t. ``p_adjusted`` over all pairs by ``adjust`` (see
    ``adjust_p``; tests that are undefined do not count in the family). Raises InputError for unknown names.
    """
    one_of("posthoc_t", "adjust", adjust, (*METHODS, *ALIASES))
    factors = names_of(within)
    cells = cell_means("posthoc_t", table, dv, factors, subject, [])
    keys = list(itertools.product(*cells.levels))
    levels = [key[0] if len(key) == 1 else ", ".join(map(str, key)) for key in keys]
    rows: list[dict[str, Any]] = []
    for i, j in itertools.combinations(range(len(levels)), 2):
        row = paired_t(cells.values[:, i] - cells.values[:, j], 2 * cells.rounding)
        for name in ("mean_diff", "ci_low", "ci_high"):
            row[name] *= cells.scale
        rows.append({"a": levels[i], "b": levels[j]} | row)
    for row, p in zip(rows, adjust_p([row["p"] for row in rows], adjust), strict=True):
        row["p_adjusted"] = float(p)
    n, family = len(cells.subjects), sum(not math.isnan(row["p"]) for row in rows)
    method = f"Paired t tests between levels of {', '.join(factors)}, {n} participants, {adjust} over {family} tests."
    attrs = {"notes": cells.notes, "family": family, "adjust": adjust}
    return result_table(rows, COLUMNS, method=method, n_subjects=n, dropped=cells.dropped, attrs=attrs)
