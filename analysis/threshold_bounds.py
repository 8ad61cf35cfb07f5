"""Observations of threshold models, P = F(a) - F(b): their bounds, log-likelihood and its derivatives, separation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import optimize, special

LINKS = ("logit", "probit", "cloglog")


@dataclass(frozen=True)
class Bounds:
    """``upper``, ``lower`` (rows, parameters), where they are infinite, and how many observations a row stands for.

    ``added`` (rows, 2): what known parameters add to the upper and the lower bound.
    """

    upper: np.ndarray
    lower: np.ndarray
    no_upper: np.ndarray
    no_lower: np.ndarray
    weight: np.ndarray
    added: np.ndarray

    def rows(self, index: np.ndarray) -> Bounds:
        """Some rows, or the rows in another order."""
        parts = (self.upper, self.lower, self.no_upper, self.no_lower, self.weight, self.added)
        return Bounds(*(part[index] for part in parts))

    def known(self, k: int, value: float) -> Bounds:
        """The model in which parameter ``k`` is known to be ``value``."""
        added = self.added + value * np.column_stack([self.upper[:, k], self.lower[:, k]])
        upper, lower = np.delete(self.upper, k, axis=1), np.delete(self.lower, k, axis=1)
        return Bounds(upper, lower, self.no_upper, self.no_lower, self.weight, added)

    def at(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Upper and lower bounds (rows,) without the random part."""
        return self.upper @ phi + self.added[:, 0], self.lower @ phi + self.added[:, 1]

    def terms(self, a: np.ndarray, b: np.ndarray, link: str) -> tuple[np.ndarray, ...]:
        """``point_terms`` times the rows' weights; ``a``, ``b`` (rows,) or (rows, nodes)."""
        no_upper, no_lower, weight = self._flags(a)
        return tuple(weight * part for part in point_terms(a, b, no_upper, no_lower, link))

    def values(self, a: np.ndarray, b: np.ndarray, link: str) -> np.ndarray:
        """log P alone, times the rows' weights."""
        no_upper, no_lower, weight = self._flags(a)
        return np.asarray(weight * point_values(a, b, no_upper, no_lower, link))

    def _flags(self, like: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        flags = (self.no_upper, self.no_lower, self.weight)
        return (flags[0][:, None], flags[1][:, None], flags[2][:, None]) if like.ndim == 2 else flags


def collapsed(bounds: Bounds, groups: list[np.ndarray]) -> tuple[Bounds, list[np.ndarray]]:
    """Equal observations of equal groups as one row with a weight: what a study with few conditions comes down to."""
    key = np.zeros(len(bounds.weight), dtype=np.int64)
    columns = [*bounds.upper.T, *bounds.lower.T, bounds.no_upper, bounds.no_lower, *bounds.added.T, *groups]
    for column in columns:
        codes, unique = pd.factorize(column)
        key = pd.factorize(key * len(unique) + codes)[0].astype(np.int64)
    first = np.unique(key, return_index=True)[1]
    made = bounds.rows(first)
    weight = np.bincount(key, weights=bounds.weight, minlength=len(first))
    return (
        Bounds(made.upper, made.lower, made.no_upper, made.no_lower, weight, made.added),
        [group[first] for group in groups],
    )


# A bound at infinity: F is 0 or 1 there and the density 0, to the last digit, whatever the link.
_INFINITE = 1000.0


def _distribution(x: np.ndarray, link: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """F, 1 - F, density and its derivative."""
    if link == "logit":
        e = np.exp(-np.abs(x))
        near = 1 / (1 + e)
        far = e * near
        up = x >= 0
        p, q = np.where(up, near, far), np.where(up, far, near)
        f = near * far
        return p, q, f, f * (q - p)
    if link == "probit":
        f = np.exp(-x * x / 2) / math.sqrt(2 * math.pi)
        return special.ndtr(x), special.ndtr(-x), f, -x * f
    e = np.exp(np.minimum(x, 700))
    q = np.exp(-e)
    f = np.where(q > 0, e * q, 0.0)
    return -np.expm1(-e), q, f, np.where(f > 0, f * (1 - e), 0.0)


def _within(a: np.ndarray, b: np.ndarray, no_upper: np.ndarray, no_lower: np.ndarray, link: str) -> tuple[
    np.ndarray, np.ndarray
]:  # fmt: skip
    """The bounds, as far out as the distribution is told from 0 and 1, and at infinity."""
    far = {"logit": 40.0, "probit": 37.0, "cloglog": 600.0}[link]
    a = np.where(no_upper, _INFINITE, np.minimum(np.maximum(a, -far), far))
    return a, np.where(no_lower, -_INFINITE, np.minimum(np.maximum(b, -far), far))


def point_values(a: np.ndarray, b: np.ndarray, no_upper: np.ndarray, no_lower: np.ndarray, link: str) -> np.ndarray:
    """log P alone."""
    a, b = _within(a, b, no_upper, no_lower, link)
    (fa, qa, *_), (fb, qb, *_) = _distribution(a, link), _distribution(b, link)
    return np.log(np.maximum(np.where(fb > 0.5, qb - qa, fa - fb), 1e-300))


def point_terms(
    a: np.ndarray, b: np.ndarray, no_upper: np.ndarray, no_lower: np.ndarray, link: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """log P, its derivatives by a and b, and second ones (aa, bb, ab)."""
    a, b = _within(a, b, no_upper, no_lower, link)
    fa, qa, da, ca = _distribution(a, link)
    fb, qb, db, cb = _distribution(b, link)
    # The difference on the side where it keeps its digits.
    p = np.maximum(np.where(fb > 0.5, qb - qa, fa - fb), 1e-300)
    # Where an impossible bound leaves no probability the slopes stay large but finite.
    ga, gb = np.minimum(da / p, 1e50), -np.minimum(db / p, 1e50)
    above = np.minimum(np.maximum(ca / p, -1e100), 1e100)
    below = np.minimum(np.maximum(cb / p, -1e100), 1e100)
    return np.log(p), ga, gb, above - ga * ga, -below - gb * gb, -ga * gb


def separation_direction(bounds: Bounds) -> np.ndarray | None:
    """A direction along which no observation becomes less likely and some more (no finite maximum), or None."""
    rows = np.vstack([bounds.upper[~bounds.no_upper], -bounds.lower[~bounds.no_lower]])
    if rows.size == 0:
        return None
    rows = np.unique(np.round(rows, 12), axis=0)
    scale = np.max(np.abs(rows), axis=0)
    scale[scale == 0] = 1.0
    rows = rows / scale
    found = optimize.linprog(
        -rows.sum(axis=0), A_ub=-rows, b_ub=np.zeros(len(rows)), bounds=[(-1, 1)] * rows.shape[1], method="highs"
    )
    if found.status != 0 or found.fun is None or not float(found.fun) < -1e-7:
        return None
    return np.asarray(found.x) / scale
