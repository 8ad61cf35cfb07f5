"""Do raters agree? Intraclass correlations, Krippendorff's alpha and Kendall's W, with intervals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from analysis.cells import cell_means, shift_and_scale
from analysis.ranks import near_ranks
from analysis.results import (
    OK,
    TOO_FEW_SUBJECTS,
    UNDEFINED,
    ZERO_ERROR_VARIANCE,
    coded,
    numbers,
    one_of,
    require_columns,
    result_table,
)

COLUMNS = ["measure", "value", "ci_low", "ci_high"]
_ICC = ("ICC1", "ICC2", "ICC3", "ICC1k", "ICC2k", "ICC3k")


def agreement(
    table: pd.DataFrame, item: str, rater: str, rating: str, level: str = "interval", seed: int = 0, n_boot: int = 2000
) -> pd.DataFrame:
    """One row a measure of agreement of raters on items, with 95 % intervals.

    ``ICC1``, ``ICC2`` (absolute agreement), ``ICC3`` (consistency) and their means of k raters (``...k``), named and
    computed as Shrout & Fleiss (1979), intervals of McGraw & Wong (1996), on items that every rater judged.
    ``alpha``: Krippendorff's at ``level`` (nominal, ordinal, interval), also ``alpha_nominal``, ``alpha_ordinal``,
    ``alpha_interval``, on all ratings; interval by bootstrap over items (``seed``, ``n_boot``). ``W``: Kendall's
    coefficient of concordance, corrected for ties, its interval from that of the consistency of ranks. Several ratings
    of an item by a rater are averaged for ICC and W. Raises InputError for unknown columns.
    """
    one_of("agreement", "level", level, ("nominal", "ordinal", "interval"))
    require_columns("agreement", table, [item, rater, rating])
    # Items play the participants' part here: those without every rater are left out.
    cells = cell_means("agreement", table, rating, [rater], item, [])
    rows = _icc_rows(cells.values, cells.rounding)
    rows += _alpha_rows(table, item, rater, rating, level, seed, n_boot)
    rows.append(_w_row(cells.values, cells.rounding))
    n, k = cells.values.shape
    method = (
        f"Agreement of {k} raters on {n} items rated by all; alpha's intervals by bootstrap over items "
        f"({n_boot} resamples, seed {seed}), at the {level} level."
    )
    return result_table(rows, COLUMNS, method=method, n_subjects=k, dropped=cells.dropped)


def _mean_squares(values: np.ndarray) -> tuple[float, float, float, float]:
    """Mean squares of items, raters, residual, and within items."""
    n, k = values.shape
    y = values - values.mean()
    of_items, of_raters = y.mean(axis=1), y.mean(axis=0)
    ss_items, ss_raters = k * float(of_items @ of_items), n * float(of_raters @ of_raters)
    rest = y - of_items[:, None] - of_raters
    ss_rest = float(np.sum(rest**2))
    return ss_items / (n - 1), ss_raters / (k - 1), ss_rest / ((n - 1) * (k - 1)), (ss_raters + ss_rest) / (n * (k - 1))


def _consistency(f: float, n: int, k: int, df2: float) -> tuple[float, float, float]:
    """(F - 1) / (F + k - 1) and its 95 % interval."""
    if math.isinf(f):
        return 1.0, 1.0, 1.0
    low = f / float(stats.f.ppf(0.975, n - 1, df2))
    high = f * float(stats.f.ppf(0.975, df2, n - 1))
    return (f - 1) / (f + k - 1), (low - 1) / (low + k - 1), (high - 1) / (high + k - 1)


def _absolute(msr: float, msc: float, mse: float, n: int, k: int) -> tuple[float, float, float]:
    """ICC(2, 1) and its interval."""
    value = (msr - mse) / (msr + (k - 1) * mse + k * (msc - mse) / n)
    a, b = k * value, n * (1 + (k - 1) * value) - k * value
    fj = msc / mse
    below = (n - 1) * (a * fj) ** 2 + b**2
    v = (k - 1) * (n - 1) * (a * fj + b) ** 2 / below
    upper, lower = float(stats.f.ppf(0.975, n - 1, v)), float(stats.f.ppf(0.975, v, n - 1))
    rest = k * msc + (k * n - k - n) * mse
    return value, n * (msr - upper * mse) / (upper * rest + n * msr), n * (lower * msr - mse) / (rest + n * lower * msr)


def _of_mean(value: float, k: int) -> float:
    """Spearman & Brown."""
    below = 1 + (k - 1) * value
    return k * value / below if below != 0 else -math.inf


def _icc_rows(values: np.ndarray, rounding: float) -> list[dict[str, Any]]:
    n, k = values.shape
    empty: dict[str, Any] = {"value": math.nan, "ci_low": math.nan, "ci_high": math.nan}
    if n < 2 or k < 2:
        note = f"{n} items rated by all of {k} raters: at least 2 of each are needed"
        return [{"measure": m, **empty, "status": TOO_FEW_SUBJECTS, "note": note} for m in _ICC]
    zero = rounding**2 * max(k, n)
    msr, msc, mse, msw = (ms if ms > zero else 0.0 for ms in _mean_squares(values))
    found: dict[str, tuple[float, float, float] | None] = {
        "ICC1": _consistency(msr / msw if msw else math.inf, n, k, n * (k - 1)) if msr or msw else None,
        "ICC2": (_absolute(msr, msc, mse, n, k) if mse else _without_rest(msr, msc, n, k))
        if msr or msc or mse
        else None,
        "ICC3": _consistency(msr / mse if mse else math.inf, n, k, (n - 1) * (k - 1)) if msr or mse else None,
    }
    rows: list[dict[str, Any]] = []
    for mean in (False, True):
        for name, triple in found.items():
            row: dict[str, Any] = {"measure": name + ("k" if mean else "")}
            if triple is None:
                rows.append(row | empty | {"status": UNDEFINED, "note": "the ratings do not vary"})
                continue
            value, low, high = (_of_mean(v, k) for v in triple) if mean else triple
            row |= {"value": value, "ci_low": low, "ci_high": high, "status": OK, "note": ""}
            if (mse if name != "ICC1" else msw) == 0:
                row |= {"status": ZERO_ERROR_VARIANCE, "note": "the residual variance is zero"}
            rows.append(row)
    return rows


def _without_rest(msr: float, msc: float, n: int, k: int) -> tuple[float, float, float]:
    value = msr / (msr + k * msc / n)
    return value, value if msc == 0 else math.nan, value if msc == 0 else math.nan


def _alpha_rows(
    table: pd.DataFrame, item: str, rater: str, rating: str, level: str, seed: int, n_boot: int
) -> list[dict[str, Any]]:
    """Krippendorff's alpha at three levels: observed over expected disagreement of pairs."""
    y = numbers("agreement", table, rating)
    code, items = coded(table, item)
    who, _ = coded(table, rater)
    use = np.isfinite(y) & (code >= 0) & (who >= 0)
    y, code = y[use], code[use]
    per_item = np.bincount(code, minlength=len(items))
    paired = per_item[code] >= 2
    y, code = y[paired], code[paired]
    kept, code = np.unique(code, return_inverse=True)
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    n = len(kept)
    weights = rng.multinomial(n, np.full(n, 1 / n), size=n_boot).astype(float) if n else np.zeros((0, 0))
    rows: list[dict[str, Any]] = []
    values, _, _, _ = shift_and_scale(y)
    # The ordinal distance is that of the middle ranks; nominal ones are indicators of each category.
    middle = near_ranks(values, 0.0) if n else values
    categories, index = np.unique(values, return_inverse=True)
    indicators = np.eye(len(categories))[index] if len(categories) <= 200 else None
    made = {"ordinal": middle[:, None], "interval": values[:, None], "nominal": indicators}
    for name in (level, "nominal", "ordinal", "interval"):
        label = "alpha" if not rows else f"alpha_{name}"
        row: dict[str, Any] = {"measure": label, "value": math.nan, "ci_low": math.nan, "ci_high": math.nan}
        data = made[name]
        if n < 1:
            rows.append(row | {"status": TOO_FEW_SUBJECTS, "note": "no item has two ratings"})
            continue
        if data is None:
            rows.append(row | {"status": UNDEFINED, "note": "more than 200 different ratings are no categories"})
            continue
        value, boot = _alpha(data, code, n, weights)
        if math.isnan(value):
            rows.append(row | {"status": UNDEFINED, "note": "all ratings are the same"})
            continue
        row["value"] = value
        boot = boot[np.isfinite(boot)]
        if n < 2 or len(boot) < 2:
            rows.append(row | {"status": TOO_FEW_SUBJECTS, "note": "one item: no interval"})
            continue
        low, high = np.quantile(boot, [0.025, 0.975])
        rows.append(row | {"ci_low": float(low), "ci_high": float(high), "status": OK, "note": ""})
    return rows


def _alpha(data: np.ndarray, code: np.ndarray, n: int, weights: np.ndarray) -> tuple[float, np.ndarray]:
    """alpha of squared distances, and of every set of item weights."""
    data = data - data.mean(axis=0)
    count = np.bincount(code, minlength=n).astype(float)
    total = np.stack([np.bincount(code, weights=column, minlength=n) for column in data.T], axis=1)
    squares = np.bincount(code, weights=np.sum(data**2, axis=1), minlength=n)
    # Sum over ordered pairs in an item of squared distance, over (ratings - 1).
    observed = 2 * (count * squares - np.sum(total**2, axis=1)) / (count - 1)

    def alpha(w: np.ndarray) -> np.ndarray:
        ratings = w @ count
        expected = 2 * (ratings * (w @ squares) - np.sum((w @ total) ** 2, axis=-1)) / (ratings - 1)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(expected > 1e-12 * ratings, 1 - (w @ observed) / expected, np.nan)

    return float(alpha(np.ones(n))), alpha(weights)


def _w_row(values: np.ndarray, rounding: float) -> dict[str, Any]:
    """Kendall's W over raters' rankings of the items."""
    n, k = values.shape
    row: dict[str, Any] = {"measure": "W", "value": math.nan, "ci_low": math.nan, "ci_high": math.nan}
    if n < 2 or k < 2:
        return row | {"status": TOO_FEW_SUBJECTS, "note": f"{n} items rated by all of {k} raters"}
    ranks = np.stack([near_ranks(column, rounding) for column in values.T], axis=1) - (n + 1) / 2
    total = float(np.sum(ranks**2))
    if total == 0:
        return row | {"status": UNDEFINED, "note": "no rater tells the items apart"}
    w = float(np.sum(ranks.sum(axis=1) ** 2)) / k / total
    msr, _, mse, _ = _mean_squares(ranks)
    f = msr / mse if mse > 1e-12 * total else math.inf
    _, low, high = _consistency(f, n, k, (n - 1) * (k - 1))
    bounds = [min(1.0, max(0.0, (1 + (k - 1) * r) / k)) for r in (low, high)]
    return row | {"value": w, "ci_low": bounds[0], "ci_high": bounds[1], "status": OK, "note": ""}
