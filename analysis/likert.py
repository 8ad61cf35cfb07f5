"""Ratings counted and described; univariate summaries without loss of digits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from analysis.cells import shift_and_scale
from analysis.results import OK, TOO_FEW_SUBJECTS, UNDEFINED, coded, numbers, require_columns, result_table
from stimuli.errors import InputError, problem


def moments(values: np.ndarray) -> tuple[int, float, float]:
    """n, mean and standard deviation (n - 1) of the finite values, in two passes after shifting by the first value."""
    values = values[np.isfinite(values)]
    n = len(values)
    if n == 0:
        return 0, math.nan, math.nan
    shifted, offset, scale, _ = shift_and_scale(values)
    centre = math.fsum(shifted) / n
    deviation = shifted - centre
    # The second pass takes what rounding left of the mean out of the variance.
    ss = math.fsum(deviation * deviation) - math.fsum(deviation) ** 2 / n
    sd = math.sqrt(max(ss, 0.0) / (n - 1)) * scale if n > 1 else math.nan
    return n, offset + scale * centre, sd


def _groups(table: pd.DataFrame, by: list[str]) -> list[tuple[tuple[Any, ...], np.ndarray]]:
    """The level combinations that occur, in order, and their rows; rows without a level are in none."""
    if not by:
        return [((), np.arange(len(table)))]
    found = [coded(table, name) for name in by]
    known = np.all([codes >= 0 for codes, _ in found], axis=0)
    key = np.zeros(len(table), dtype=np.int64)
    for codes, levels in found:
        key = key * max(len(levels), 1) + codes
    rows = np.flatnonzero(known)
    rows = rows[np.argsort(key[rows], kind="stable")]
    if len(rows) == 0:
        return []
    parts = np.split(rows, np.flatnonzero(np.diff(key[rows])) + 1)
    return [(tuple(levels[codes[part[0]]] for codes, levels in found), part) for part in parts]


def likert_summary(
    table: pd.DataFrame,
    dv: str,
    by: str | list[str] | None = None,
    scale: tuple[int, int] = (-3, 3),
    subject: str | None = None,
) -> pd.DataFrame:
    """Ratings by condition: ``by`` columns, n, mean, sd, median, ``share_C`` per category C, disagree, neutral, agree.

    ``scale``: lowest and highest category, whole numbers; neutral is its midpoint (no category of an even scale).
    Shares are of the n answers; n counts ratings, and ``n_subjects`` participants where ``subject`` names them.
    Ratings off the scale are left out and counted in ``attrs['dropped']``. Raises InputError for unknown columns.
    """
    by = [by] if isinstance(by, str) else list(by or [])
    require_columns("likert_summary", table, [dv, *by, *([subject] if subject else [])])
    low, high = scale
    if not (float(low).is_integer() and float(high).is_integer() and high > low):
        raise InputError(problem("likert_summary", "scale", scale, "two whole numbers, the lower first"))
    categories = np.arange(int(low), int(high) + 1)
    middle = (low + high) / 2
    y = numbers("likert_summary", table, dv)
    on_scale = np.isfinite(y) & (y >= low) & (y <= high) & (y == np.round(y))
    dropped: dict[Any, str] = {}
    if (off := int((np.isfinite(y) & ~on_scale).sum())) > 0:
        dropped["off_scale"] = f"{off} ratings that are not a category of {int(low)} to {int(high)}"
    if (missing := int((~np.isfinite(y)).sum())) > 0:
        dropped["missing"] = f"{missing} rows without a rating"
    share_names = [f"share_{c}" for c in categories]
    columns = [*by, "n", "mean", "sd", "median", *share_names, "disagree", "neutral", "agree"]
    rows: list[dict[str, Any]] = []
    for key, part in _groups(table, by):
        ratings = y[part][on_scale[part]]
        n, mean, sd = moments(ratings)
        row: dict[str, Any] = dict(zip(by, key, strict=True))
        share = np.array([np.mean(ratings == c) for c in categories]) if n else np.full(len(categories), math.nan)
        row |= {"n": n, "mean": mean, "sd": sd, "median": float(np.median(ratings)) if n else math.nan}
        row |= dict(zip(share_names, map(float, share), strict=True))
        row |= {
            "disagree": float(np.mean(ratings < middle)) if n else math.nan,
            "neutral": float(np.mean(ratings == middle)) if n else math.nan,
            "agree": float(np.mean(ratings > middle)) if n else math.nan,
        }
        if n == 0:
            row |= {"status": UNDEFINED, "note": "no valid rating"}
        elif n == 1:
            row |= {"status": TOO_FEW_SUBJECTS, "note": "one rating: no standard deviation"}
        else:
            row |= {"status": OK}
        rows.append(row)
    n_subjects = len(coded(table, subject)[1]) if subject else 0
    method = (
        f"Shares of ratings on the scale {int(low)} to {int(high)}; disagree and agree are below and above {middle:g}."
    )
    return result_table(rows, columns, method=method, n_subjects=n_subjects, dropped=dropped)


def describe(table: pd.DataFrame, dv: str, by: str | list[str] | None = None) -> pd.DataFrame:
    """n, mean, sd, lag-1 autocorrelation, median, minimum, maximum per combination of ``by`` (rows in table order)."""
    by = [by] if isinstance(by, str) else list(by or [])
    require_columns("describe", table, [dv, *by])
    y = numbers("describe", table, dv)
    rows: list[dict[str, Any]] = []
    for key, part in _groups(table, by):
        values = y[part][np.isfinite(y[part])]
        n, mean, sd = moments(values)
        row: dict[str, Any] = {**dict(zip(by, key, strict=True)), "n": n, "mean": mean, "sd": sd}
        row["autocorrelation"] = _lag_one(values)
        for name, function in (("median", np.median), ("minimum", np.min), ("maximum", np.max)):
            row[name] = float(function(values)) if n else math.nan
        rows.append(row)
    columns = [*by, "n", "mean", "sd", "autocorrelation", "median", "minimum", "maximum"]
    return result_table(rows, columns, method="Two-pass moments of shifted values.", n_subjects=0)


def _lag_one(values: np.ndarray) -> float:
    """Lag-1 autocorrelation; nan for constant values."""
    if len(values) < 2:
        return math.nan
    shifted, _, _, rounding = shift_and_scale(values)
    deviation = shifted - math.fsum(shifted) / len(values)
    ss = math.fsum(deviation**2)
    return math.fsum(deviation[1:] * deviation[:-1]) / ss if ss > rounding**2 * len(values) else math.nan
