"""Is a display locked: a robust fit of its refreshes to the grid ``t = t0 + k T``.

The standard deviation of intervals is not the criterion: a raster whose timer starts anew after every frame has small
interval SD and a phase that wanders without bound. The residual of the absolute fit finds that.
Limits: residual SD at most 0.05 T, |T - nominal| at most 1 %, nothing lost (research: Psychtoolbox's 0.2 ms at 240 Hz).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from protocols.records import FLIP_EARLY
from studyapp.display.vblank import VblankGrid
from studyapp.seams import Display

WARM_UP = 30
REFRESHES = 480
RESIDUAL_LIMIT = 0.05
RATE_LIMIT = 0.01
FALL_THROUGH = 0.5
"""An interval below this share of the nominal period did not wait for a vblank."""
FALL_THROUGH_SHARE = 0.5
"""More such intervals than this, and there is no vblank at all."""
OUTLIER_SHARE = 0.02
"""More stamps off the grid than this, and the grid is not the display's."""


@dataclass(frozen=True)
class PeriodFit:
    """``t = phase_ns + k period_ns`` over ``refreshes`` stamps. ``residual_sd_ns`` over the stamps kept; ``outliers``
    were not (single late stamps); ``lost``: refreshes between stamps; ``fell_through``: swaps that did not wait."""

    period_ns: float
    period_se_ns: float
    phase_ns: int
    residual_sd_ns: float
    interval_sd_ns: float
    interval_median_ns: float
    lost: int
    outliers: int
    fell_through: int
    refreshes: int


def fit_period(stamps_ns: np.ndarray, nominal_ns: float, numbers: np.ndarray | None = None) -> PeriodFit:
    """Least squares on integer refresh numbers, with single late stamps rejected. ``stamps_ns``: (n,) int64, n >= 3.

    ``numbers``: (n,) refresh numbers where the display counts them itself (a timer, a hardware counter); without them
    each stamp is numbered on the grid that follows the stamps before it. Raises ValueError on fewer than three stamps.
    """
    stamps = np.asarray(stamps_ns, np.int64)
    if stamps.ndim != 1 or len(stamps) < 3:
        raise ValueError(f"fit_period: stamps_ns: got shape {stamps.shape}, wanted (n,) with n >= 3")
    intervals = np.diff(stamps).astype(np.float64)
    median = float(np.median(intervals))
    waited = intervals[intervals >= FALL_THROUGH * nominal_ns]
    fell_through = len(intervals) - len(waited)
    if len(waited) < 2 or fell_through > FALL_THROUGH_SHARE * len(intervals):
        sd = float(np.std(intervals, ddof=1))
        return PeriodFit(median, np.nan, int(stamps[0]), np.nan, sd, median, 0, 0, fell_through, len(stamps))
    if numbers is None:
        counted, fell_through = _number(stamps, float(np.median(waited)))
    else:
        counted, fell_through = np.asarray(numbers, np.int64) - int(numbers[0]), 0
    times = (stamps - stamps[0]).astype(np.float64)
    keep = np.diff(counted, prepend=-1) > 0
    lost = int(counted[-1]) - int(keep.sum()) + 1
    usable = keep.copy()
    for _ in range(8):
        slope, offset = np.polyfit(counted[keep], times[keep], 1)
        residuals = times - offset - slope * counted
        middle = float(np.median(residuals[keep]))
        spread = 1.4826 * float(np.median(np.abs(residuals[keep] - middle)))
        kept = usable & (np.abs(residuals - middle) <= max(5 * spread, 0.02 * slope))
        if np.array_equal(kept, keep) or kept.sum() < 3:
            break
        keep = kept
    count = int(keep.sum())
    residual_sd = float(np.sqrt(np.sum(residuals[keep] ** 2) / max(1, count - 2)))
    spread_of_numbers = float(np.sqrt(np.sum((counted[keep] - counted[keep].mean()) ** 2)))
    single = waited[waited < 1.5 * slope]
    return PeriodFit(
        period_ns=float(slope),
        period_se_ns=residual_sd / spread_of_numbers,
        phase_ns=int(stamps[0]) + round(float(offset)),
        residual_sd_ns=residual_sd,
        interval_sd_ns=float(np.std(single, ddof=1)) if len(single) > 1 else 0.0,
        interval_median_ns=median,
        lost=lost,
        outliers=int(usable.sum()) - count,
        fell_through=fell_through,
        refreshes=len(stamps),
    )


def _number(stamps: np.ndarray, period_ns: float) -> tuple[np.ndarray, int]:
    """Refresh number of each stamp on the grid that follows them, and how many were early swaps."""
    grid = VblankGrid(period_ns)
    placed = [grid.place(stamp) for stamp in stamps.tolist()]
    early = sum(bool(flags & FLIP_EARLY) for _, _, _, flags in placed)
    return np.array([index for index, _, _, _ in placed], np.int64), early


def why_not_locked(fit: PeriodFit, nominal_hz: Fraction) -> tuple[str, ...]:
    """Every reason for which the display does not count as locked at ``nominal_hz``; empty: it is locked."""
    nominal_ns = float(1_000_000_000 / nominal_hz)
    if fit.fell_through > FALL_THROUGH_SHARE * (fit.refreshes - 1):
        return (
            f"no vblank: {fit.fell_through} of {fit.refreshes - 1} swaps did not wait "
            f"(median interval {fit.interval_median_ns / 1e6:.3f} ms, nominal {nominal_ns / 1e6:.3f} ms)",
        )
    reasons = []
    measured_hz = 1e9 / fit.period_ns
    off = measured_hz / float(nominal_hz) - 1
    if abs(fit.period_ns / nominal_ns - 1) > RATE_LIMIT:
        reasons.append(
            f"rate: nominal {float(nominal_hz):g} Hz, measured {measured_hz:.2f} Hz "
            f"({off:+.1%}, limit {RATE_LIMIT:.0%})"
        )
    if fit.residual_sd_ns > RESIDUAL_LIMIT * fit.period_ns:
        reasons.append(
            f"wandering phase: residual SD {fit.residual_sd_ns / 1e6:.3f} ms of t = t0 + k T, limit "
            f"{RESIDUAL_LIMIT * fit.period_ns / 1e6:.3f} ms (interval SD is {fit.interval_sd_ns / 1e6:.3f} ms)"
        )
    if fit.outliers > OUTLIER_SHARE * fit.refreshes:
        reasons.append(f"outliers: {fit.outliers} of {fit.refreshes} stamps off the grid, limit {OUTLIER_SHARE:.0%}")
    if fit.fell_through:
        reasons.append(f"early swaps: {fit.fell_through} swaps did not wait for a vblank")
    if fit.lost:
        reasons.append(f"lost: {fit.lost} refreshes in {fit.refreshes}")
    return tuple(reasons)


def measure(
    display: Display, refreshes: int = REFRESHES, warm_up: int = WARM_UP
) -> tuple[np.ndarray, np.ndarray | None]:
    """(refreshes,) stamps of empty swaps, after ``warm_up`` that are thrown away; and their refresh numbers where the
    display counts them itself (`counts_refreshes`)."""
    flip = display.flip
    for _ in range(warm_up):
        flip()
    stamps, numbers = np.zeros(refreshes, np.int64), np.zeros(refreshes, np.int64)
    for place in range(refreshes):
        done = flip()
        stamps[place], numbers[place] = done.shown_ns, done.index
    return stamps, numbers if getattr(display, "counts_refreshes", False) else None
