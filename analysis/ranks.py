"""Rank tests over participants: Friedman with its post-hoc tests, and the aligned rank transform."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from analysis.anova import anova_of_cells, effect_rows_columns, effects_of
from analysis.cells import Cells, cell_means
from analysis.log_tails import log10_chi2, p_chi2, p_f, p_t
from analysis.multiplicity import adjust_p
from analysis.results import OK, ROUNDING, TOO_FEW_SUBJECTS, UNDEFINED, ZERO_ERROR_VARIANCE, names_of, result_table

_FRIEDMAN = ["chi2", "df", "p", "log10_p", "kendall_w", "iman_davenport_F", "iman_davenport_p", "n", "k"]


def near_ranks(values: np.ndarray, tolerance: float) -> np.ndarray:
    """Average ranks (1, 2, ...) of a vector in which neighbours closer than ``tolerance`` are tied."""
    order = np.argsort(values, kind="stable")
    new = np.concatenate([[True], np.diff(values[order]) > tolerance])
    group = np.cumsum(new) - 1
    size = np.bincount(group)
    last = np.cumsum(size)
    ranks = np.empty(len(values))
    ranks[order] = (last - (size - 1) / 2)[group]
    return ranks


def _row_ranks(cells: Cells) -> np.ndarray:
    """Ranks within each participant; values that differ by rounding only are tied."""
    if cells.values.size == 0:
        return cells.values
    return np.array([near_ranks(row, cells.rounding) for row in cells.values])


def friedman(table: pd.DataFrame, dv: str, within: str, subject: str) -> pd.DataFrame:
    """Friedman's test, corrected for ties; Kendall's W; Iman & Davenport's (1980) F beside it. One row.

    Repetitions are averaged per participant and level; participants without every level are left out by name. Mean
    ranks are in ``attrs['mean_ranks']``. All tied: ``undefined``. Raises InputError for unknown columns.
    """
    factors = names_of(within)
    cells = cell_means("friedman", table, dv, factors, subject, [])
    n, k = cells.values.shape
    levels = [", ".join(map(str, key)) for key in itertools.product(*cells.levels)]
    method = f"Friedman test with tie correction, {n} participants by {k} levels of {', '.join(factors)}."
    row: dict[str, Any] = dict.fromkeys(_FRIEDMAN, math.nan) | {"n": n, "k": k, "df": k - 1}
    attrs: dict[str, Any] = {"notes": cells.notes}
    ranks = _row_ranks(cells)
    if n:
        attrs["mean_ranks"] = dict(zip(levels, map(float, ranks.mean(axis=0)), strict=True))
    if k < 2:
        row |= {"status": UNDEFINED, "note": f"{within!r} has {k} level"}
    elif n < 2:
        row |= {"status": TOO_FEW_SUBJECTS, "note": f"{n} complete participants, at least 2 are needed"}
    else:
        # Between and total sums of squares of the ranks about their mean (k + 1) / 2.
        deviation = ranks - (k + 1) / 2
        between = float(np.sum(deviation.sum(axis=0) ** 2)) / n
        total = float(np.sum(deviation**2))
        if total == 0:
            row |= {"status": UNDEFINED, "note": "every participant answered alike at every level: all ranks are tied"}
        else:
            chi2 = n * (k - 1) * between / total
            w = between / total
            row |= {"chi2": chi2, "p": p_chi2(chi2, k - 1), "log10_p": log10_chi2(chi2, k - 1), "kendall_w": w}
            row |= {"status": OK, "note": ""}
            row |= _iman_davenport(w, n, k)
    return result_table([row], _FRIEDMAN, method=method, n_subjects=n, dropped=cells.dropped, attrs=attrs)


def _iman_davenport(w: float, n: int, k: int) -> dict[str, Any]:
    if 1 - w < 1e-12:
        note = "all participants rank alike: Iman & Davenport's F is infinite"
        return {"iman_davenport_F": math.inf, "iman_davenport_p": 0.0, "note": note}
    f = (n - 1) * w / (1 - w)
    return {"iman_davenport_F": f, "iman_davenport_p": p_f(f, k - 1, (n - 1) * (k - 1))}


def friedman_posthoc(table: pd.DataFrame, dv: str, within: str, subject: str, adjust: str = "holm") -> pd.DataFrame:
    """All pairs after Friedman: Conover's t (1999, section 5.8; ``p_adjusted``) and Nemenyi's p. One row a pair."""
    factors = names_of(within)
    cells = cell_means("friedman_posthoc", table, dv, factors, subject, [])
    n, k = cells.values.shape
    levels = [key[0] if len(key) == 1 else ", ".join(map(str, key)) for key in itertools.product(*cells.levels)]
    columns = ["a", "b", "mean_rank_diff", "conover_t", "df", "conover_p", "p_adjusted", "nemenyi_q", "nemenyi_p"]
    ranks = _row_ranks(cells)
    sums = ranks.sum(axis=0) if n else np.zeros(k)
    a1, df = float(np.sum(ranks**2)), (n - 1) * (k - 1)
    rows: list[dict[str, Any]] = []
    for i, j in itertools.combinations(range(k), 2):
        row: dict[str, Any] = dict.fromkeys(columns, math.nan) | {"a": levels[i], "b": levels[j], "df": df}
        if n < 2:
            rows.append(row | {"status": TOO_FEW_SUBJECTS, "note": f"{n} complete participants"})
            continue
        difference = float(sums[i] - sums[j])
        row["mean_rank_diff"] = difference / n
        error = 2 * (n * a1 - float(np.sum(sums**2))) / df
        q = abs(difference) / n / math.sqrt(k * (k + 1) / (12 * n))
        row |= {"nemenyi_q": q, "nemenyi_p": float(stats.studentized_range.sf(q, k, np.inf))}
        if error <= 1e-12 * a1:
            alike = difference == 0
            row |= {"conover_t": math.nan if alike else math.inf, "conover_p": math.nan if alike else 0.0}
            row |= {"status": UNDEFINED if alike else ZERO_ERROR_VARIANCE, "note": "all participants rank alike"}
        else:
            t = abs(difference) / math.sqrt(error)
            row |= {"conover_t": t, "conover_p": p_t(t, df), "status": OK, "note": ""}
        rows.append(row)
    for row, p in zip(rows, adjust_p([row["conover_p"] for row in rows], adjust), strict=True):
        row["p_adjusted"] = float(p)
    method = f"Conover's t on Friedman ranks ({adjust}), and Nemenyi's test, family of {len(rows)} pairs."
    return result_table(rows, columns, method=method, n_subjects=n, dropped=cells.dropped)


def aligned_rank_anova(table: pd.DataFrame, dv: str, within: str | list[str], subject: str) -> pd.DataFrame:
    """Aligned rank transform (Wobbrock et al. 2011): one row an effect, tested against its own error stratum.

    For each effect the responses are stripped of all other effects of the cell means, ranked, and put through the
    repeated-measures ANOVA, of which the row of that effect is kept. Aligned values closer than 1e-9 of the data's
    range are tied (rounding would otherwise order them). Columns of ``rm_anova``. Raises InputError for unknown
    columns.
    """
    factors = names_of(within)
    cells = cell_means("aligned_rank_anova", table, dv, factors, subject, [])
    shape = tuple(len(levels) for levels in cells.levels)
    n = len(cells.subjects)
    y = cells.values.reshape((n, *shape))
    rows = []
    for effect in effects_of(factors):
        aligned = y - y.mean(axis=0, keepdims=True) if n else y
        if n:
            aligned = aligned + _effect(y.mean(axis=0), [factors.index(name) for name in effect])
        flat = aligned.ravel()
        spread = float(np.max(np.abs(y - y.mean()))) if n else 0.0
        ranks = near_ranks(flat, max(1e-9 * spread, cells.rounding)) if flat.size else flat
        made = anova_of_cells(
            ranks.reshape(cells.values.shape),
            cells.levels,
            factors,
            np.zeros((n, 0), dtype=np.int64),
            [],
            [],
            ROUNDING * flat.size,
            effects=[effect],
        )
        rows += made
    method = "Aligned rank transform, each effect against its own error stratum; repetitions averaged per cell."
    return result_table(
        rows, effect_rows_columns(), method=method, n_subjects=n, dropped=cells.dropped, attrs={"notes": cells.notes}
    )


def _effect(means: np.ndarray, axes: list[int]) -> np.ndarray:
    """The effect on ``axes`` of an array of cell means, by inclusion and exclusion of marginal means."""
    effect = np.zeros([size if axis in axes else 1 for axis, size in enumerate(means.shape)])
    for count in range(len(axes) + 1):
        for kept in itertools.combinations(axes, count):
            away = tuple(axis for axis in range(means.ndim) if axis not in kept)
            effect = effect + (-1.0) ** (len(axes) - count) * means.mean(axis=away, keepdims=True)
    return effect
