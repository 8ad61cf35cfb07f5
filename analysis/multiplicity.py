"""p values adjusted for the number of tests (as R's p.adjust)."""

from __future__ import annotations

from typing import Any

import numpy as np

from analysis.results import one_of

METHODS = ("holm", "hochberg", "hommel", "bonferroni", "BH", "fdr", "BY", "none")
ALIASES = {"fdr_bh": "BH", "bh": "BH", "fdr_by": "BY", "by": "BY"}
"""Other names of the same methods (statsmodels' and the protocol's)."""


def _hommel(p: np.ndarray) -> np.ndarray:
    """Hommel (1988) by Wright's (1992) algorithm; ``p`` ascending."""
    m = len(p)
    rank = np.arange(1, m + 1)
    q = np.full(m, np.min(m * p / rank))
    adjusted = q.copy()
    for j in range(m - 1, 1, -1):
        low, high = np.arange(m - j + 1), np.arange(m - j + 1, m)
        least = np.min(j * p[high] / np.arange(2, j + 1))
        q[low] = np.minimum(j * p[low], least)
        q[high] = q[m - j]
        adjusted = np.maximum(adjusted, q)
    return np.maximum(adjusted, p)


def adjust_p(p: Any, method: str = "holm") -> np.ndarray:
    """Adjusted p values, same shape and order as ``p``; nan stays nan and does not count in the family.

    ``method``: holm, hochberg, hommel, bonferroni, BH (or fdr), BY, none. Raises InputError for another name.
    """
    method = ALIASES.get(method, method)
    one_of("adjust_p", "method", method, METHODS)
    given = np.asarray(p, dtype=float)
    flat = given.ravel()
    result = np.full(flat.shape, np.nan)
    present = np.flatnonzero(~np.isnan(flat))
    m = len(present)
    if m == 0:
        return result.reshape(given.shape)
    order = present[np.argsort(flat[present], kind="stable")]
    up = flat[order]
    rank = np.arange(1, m + 1)
    if method == "none":
        adjusted = up
    elif method == "bonferroni":
        adjusted = m * up
    elif method == "holm":
        adjusted = np.maximum.accumulate((m - rank + 1) * up)
    elif method == "hommel":
        adjusted = _hommel(up) if m > 1 else up
    else:
        weight = {"hochberg": m - rank + 1.0, "BY": m / rank * np.sum(1.0 / rank)}.get(method, m / rank)
        adjusted = np.minimum.accumulate((weight * up)[::-1])[::-1]
    result[order] = np.minimum(adjusted, 1.0)
    return result.reshape(given.shape)
