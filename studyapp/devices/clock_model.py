"""A device's clock on the session's: offset, drift and how sure one can be, refitted while the session runs.

Two kinds of evidence. *Round trips*: the device was asked for its time; the answer's moment lies somewhere between
asking and answer, so its error is at most half the window, and short windows weigh most. *Arrivals*: the device stamps
what it sends, and it arrives later by the transport's delay. Delays are never negative, so the earliest arrivals
bound the clock from above (``delay='one_sided'``: the supporting line under all points, Moon, Skelly & Towsley 1999);
where the jitter is known to be symmetric, all arrivals count (``delay='symmetric'``: robust least squares).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

Delay = Literal["round_trip", "one_sided", "symmetric"]


@dataclass(frozen=True)
class ClockFit:
    """session_ns = device_s * 1e9 * (1 + drift_ppm * 1e-6) + offset_ns; ``uncertainty_ns``: one standard error at the
    newest evidence (for round trips at least half the shortest window)."""

    offset_ns: float
    drift_ppm: float
    uncertainty_ns: float
    n: int

    def session_ns(self, device_s: float) -> int:
        """A device stamp on the session clock."""
        return round(device_s * 1e9 + device_s * 1e3 * self.drift_ppm + self.offset_ns)

    def session_ns_many(self, device_s: np.ndarray) -> np.ndarray:
        """Device stamps (N,) float64 on the session clock, (N,) int64."""
        return np.rint(device_s * 1e9 + device_s * 1e3 * self.drift_ppm + self.offset_ns).astype(np.int64)


class ClockModel:
    """Evidence of one device's clock, bounded: the newest ``recent`` pairs, and of older ones the best of each second
    (symmetric jitter: their mean).

    ``fixed_delay_ns`` is the known least transport delay (0 where it is not known: then mapped stamps are late by it).
    """

    def __init__(self, delay: Delay = "one_sided", *, fixed_delay_ns: float = 0.0, recent: int = 2000) -> None:
        self.delay: Delay = delay
        self._fixed_delay_ns = fixed_delay_ns
        self._recent = recent
        self._pairs: list[tuple[float, int, int]] = []  # device s, host ns, window ns
        self._best: dict[int, tuple[float, int, int]] = {}
        self._counts: dict[int, int] = {}  # pairs that went into each of `_best`

    @property
    def ask_again_ns(self) -> float:
        """How long after one question for the device's clock the next is due: often at first, then once a second."""
        return 1e8 if len(self) < 10 else 1e9

    def __len__(self) -> int:
        return len(self._pairs) + len(self._best)

    def arrival(self, device_s: float, host_ns: int) -> None:
        """Something stamped ``device_s`` arrived at ``host_ns``."""
        self._add(device_s, host_ns, 0)

    def round_trip(self, device_s: float, asked_ns: int, answered_ns: int) -> None:
        """The device, asked at ``asked_ns``, gave ``device_s``; the answer was complete at ``answered_ns``."""
        self._add(device_s, (asked_ns + answered_ns) // 2, max(answered_ns - asked_ns, 1))

    def _add(self, device_s: float, host_ns: int, window_ns: int) -> None:
        if not np.isfinite(device_s):
            return
        self._pairs.append((device_s, host_ns, window_ns))
        if len(self._pairs) > 2 * self._recent:
            old, self._pairs = self._pairs[: self._recent], self._pairs[self._recent :]
            for pair in old:
                self._keep(pair)

    def _keep(self, pair: tuple[float, int, int]) -> None:
        """Of each second, the pair with the shortest window, or the earliest arrival."""
        second = int(pair[0] // 1)
        best = self._best.get(second)
        self._counts[second] = count = self._counts.get(second, 0) + 1
        if best is not None and self.delay == "symmetric":
            # A running mean; host times are large integers, so their mean is taken by difference.
            self._best[second] = (
                best[0] + (pair[0] - best[0]) / count,
                best[1] + round((pair[1] - best[1]) / count),
                0,
            )
        elif best is None or self._merit(pair) < self._merit(best):
            self._best[second] = pair

    @staticmethod
    def _merit(pair: tuple[float, int, int]) -> tuple[float, float]:
        device_s, host_ns, window_ns = pair
        return (float(window_ns), host_ns - device_s * 1e9)

    def fit(self) -> ClockFit | None:
        """The fit to all evidence; None before the first pair; drift 0 until the evidence spans 1 s."""
        pairs = [*self._best.values(), *self._pairs]
        if not pairs:
            return None
        device_s = np.array([pair[0] for pair in pairs])
        host_ns = np.array([pair[1] for pair in pairs], dtype=np.int64)
        window_ns = np.array([pair[2] for pair in pairs], dtype=float)
        # Everything relative to the first pair and to a clock without drift: small numbers, no cancellation.
        origin_s, origin_ns = float(device_s[0]), int(host_ns[0])
        x = device_s - origin_s
        y = (host_ns - origin_ns) - x * 1e9
        if self.delay == "round_trip":
            slope, level, sigma = _weighted_line(x, y, window_ns)
        elif self.delay == "one_sided":
            slope, level, sigma = _line_below(x, y)
        else:
            counts = np.array([*self._counts.values(), *([1] * len(self._pairs))], dtype=float)
            slope, level, sigma = _robust_line(x, y, counts)
        drift_ppm = slope * 1e-3
        offset_ns = origin_ns + level - self._fixed_delay_ns - origin_s * 1e9 * (1 + drift_ppm * 1e-6)
        return ClockFit(offset_ns, drift_ppm, sigma, len(pairs))


def _span_allows_drift(x: np.ndarray) -> bool:
    return len(x) >= 3 and float(np.ptp(x)) >= 1.0


def _weighted_line(x: np.ndarray, y: np.ndarray, window: np.ndarray) -> tuple[float, float, float]:
    """Weighted least squares over the round trips whose window is near the shortest; weights 1 / window^2."""
    good = window <= max(3.0 * float(window.min()), float(np.quantile(window, 0.1)))
    x, y, window = x[good], y[good], window[good]
    slope, level, residual_sd, leverage = _least_squares(x, y, 1.0 / window**2)
    return slope, level, float(max(residual_sd * leverage, window.min() / 2 / np.sqrt(len(x))))


def _robust_line(x: np.ndarray, y: np.ndarray, counts: np.ndarray) -> tuple[float, float, float]:
    """Least squares, then five rounds of Huber weights at 1.345 robust standard deviations. ``counts``: how many pairs
    each point is the mean of."""
    weights = counts
    for _ in range(6):
        slope, level, residual_sd, leverage = _least_squares(x, y, weights)
        residual = np.abs(y - slope * x - level) * np.sqrt(counts)
        scale = 1.4826 * float(np.median(residual)) * 1.345
        if scale == 0:
            break
        weights = counts * np.minimum(1.0, scale / np.maximum(residual, 1e-9))
    return slope, level, residual_sd * leverage


def _line_below(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """The line under all points that is nearest to them in the mean: the lower hull's edge over the mean of x."""
    if not _span_allows_drift(x):
        level = float(y.min())
        return 0.0, level, float(np.std(y) / max(len(y), 1))
    order = np.lexsort((y, x))
    hull: list[tuple[float, float]] = []
    for px, py in zip(x[order].tolist(), y[order].tolist(), strict=True):
        if hull and px == hull[-1][0]:
            continue
        while len(hull) >= 2 and _right_turn(hull[-2], hull[-1], (px, py)):
            hull.pop()
        hull.append((px, py))
    centre = float(np.mean(x))
    left, right = next((pair for pair in pairwise(hull) if pair[0][0] <= centre <= pair[1][0]), (hull[0], hull[-1]))
    slope = (right[1] - left[1]) / (right[0] - left[0])
    level = left[1] - slope * left[0]
    # Minimum of n delays of mean d above the least lies about d / n below: that is how sure the bound is.
    excess = y - slope * x - level
    return slope, level, float(np.mean(excess) / np.sqrt(len(x)))


def _right_turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0


def _least_squares(x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> tuple[float, float, float, float]:
    """Weighted line: (slope, level, residual SD, standard error at the newest x in units of that SD)."""
    total = weights.sum()
    mean_x, mean_y = float(np.sum(weights * x) / total), float(np.sum(weights * y) / total)
    spread = float(np.sum(weights * (x - mean_x) ** 2))
    if not _span_allows_drift(x) or spread == 0:
        sd = float(np.sqrt(np.sum(weights * (y - mean_y) ** 2) / total))
        return 0.0, mean_y, sd, 1.0 / np.sqrt(len(x))
    slope = float(np.sum(weights * (x - mean_x) * (y - mean_y)) / spread)
    level = mean_y - slope * mean_x
    residual = y - slope * x - level
    sd = float(np.sqrt(np.sum(weights * residual**2) / total))
    leverage = float(np.sqrt(1.0 / len(x) + (x.max() - mean_x) ** 2 / (len(x) * spread / total)))
    return slope, level, sd, leverage
