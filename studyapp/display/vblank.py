"""Which refresh a stamp belongs to: the grid ``t = t0 + k T``, and what went wrong between two stamps.

Every display puts its stamps through here, so a miss means the same on a window, off-screen and in a test.
Design: absolute index k = round((t - t0) / T), missed = k - k_previous - 1; early swap: nearer to the last refresh
than to any later one; late: past the deadline of 1.05 T (hardware stamps) or 1.2 T (software stamps), as
Psychtoolbox does it; phase slip: three stamps in a row displaced by the same amount.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from fractions import Fraction

from protocols.records import FLIP_EARLY, FLIP_LATE, FLIP_PHASE_SLIP

DEADLINE_SLACK = {"hardware": 1.05, "software": 1.2, "timer": 1.05, "virtual": 1.05}
SLIP_LIMIT = 0.15
"""Share of the period beyond which a displaced stamp is suspected of a phase slip."""
SLIP_SPREAD = 0.1
"""Suspected stamps must agree to this share of the period to be one slip."""
SLIP_CONFIRM = 3
PHASE_GAIN = 0.1
PERIOD_GAIN = 2e-4
WANDERING_PHASE_GAIN, WANDERING_PERIOD_GAIN = 0.5, 0.02
"""For a raster without a steady phase (a compositor's timer): follow the last stamps, claim no phase."""


class VblankGrid:
    """The grid of a display's refreshes, slowly refitted to its stamps (phase and period), never to outliers.

    ``period_ns`` is the measured period. Refresh ``index`` is due at ``due_ns``. Before the first stamp the grid has
    no phase: the first stamp is refresh 0. ``wandering``: the display was found to have no steady phase; the grid then
    follows the last stamps, after a miss anew, and phase slips (which it has all the time) are not flagged.
    """

    def __init__(self, period_ns: float, slack: float = 1.2, wandering: bool = False) -> None:
        self.wandering = wandering
        self.period_ns = float(period_ns)
        self.slack = slack
        self.index = -1
        self._anchor_ns = 0
        self._rest_ns = 0.0  # sub-nanosecond part of the anchor, kept apart: a float64 of session ns would lose it
        self._last_ns = 0
        self._suspects: list[float] = []

    def due_ns(self, steps: int = 1) -> int:
        """When the refresh ``steps`` after the last one is due."""
        return self._anchor_ns + round(self._rest_ns + steps * self.period_ns)

    def place(self, shown_ns: int) -> tuple[int, int, int, int]:
        """(index, due_ns, missed, FLIP_* flags) of a swap that was shown at ``shown_ns``."""
        if self.index < 0:
            self.index, self._anchor_ns, self._last_ns = 0, shown_ns, shown_ns
            return 0, shown_ns, 0, 0
        period = self.period_ns
        gap = (shown_ns - self._anchor_ns) - self._rest_ns
        steps = round(gap / period)
        off_grid = abs(gap - steps * period) > SLIP_LIMIT * period
        hurried = off_grid and shown_ns - self._last_ns < 0.5 * period
        self._last_ns = shown_ns
        if steps < 1 or hurried:
            # Nearer to the refresh already shown, or on the heels of another swap: it did not wait for the next one.
            return self.index, self.due_ns(1), 0, FLIP_EARLY
        flags = FLIP_LATE if gap > (steps - 1 + self.slack) * period else 0
        residual = gap - steps * period
        due = self.due_ns(steps)
        self._advance(steps * period)
        self.index += steps
        if self.wandering:
            self._advance(residual if steps > 1 else WANDERING_PHASE_GAIN * residual)
            self.period_ns += WANDERING_PERIOD_GAIN * residual if steps == 1 else 0.0
            return self.index, due, steps - 1, flags
        if not off_grid:
            # An ordinary stamp: follow the crystal slowly.
            self._suspects.clear()
            self._advance(PHASE_GAIN * residual)
            self.period_ns += PERIOD_GAIN * residual / steps
            return self.index, due, steps - 1, flags
        flags |= self._suspect(residual)
        return self.index, due, steps - 1, flags

    def leap(self, steps: int, anchor_ns: int) -> None:
        """Take ``steps`` faultless refreshes at once, the last of them at ``anchor_ns`` (virtual display only)."""
        self.index += steps
        self._anchor_ns, self._rest_ns, self._last_ns = anchor_ns, 0.0, anchor_ns
        self._suspects.clear()

    def _suspect(self, residual: float) -> int:
        """Remember a displaced stamp; the third that agrees is a phase slip, and the grid moves there."""
        self._suspects.append(residual)
        recent = self._suspects[-SLIP_CONFIRM:]
        self._suspects = recent
        if len(recent) < SLIP_CONFIRM or max(recent) - min(recent) > SLIP_SPREAD * self.period_ns:
            return 0
        self._advance(statistics.median(recent))
        self._suspects = []
        return FLIP_PHASE_SLIP

    def _advance(self, by_ns: float) -> None:
        whole, self._rest_ns = divmod(self._rest_ns + by_ns, 1.0)
        self._anchor_ns += int(whole)


def grid_time_ns(start_ns: int, index: int, rate_hz: Fraction) -> int:
    """Exact time of refresh ``index`` of a grid that began at ``start_ns``, rounded to the nanosecond."""
    return start_ns + (index * 1_000_000_000 * rate_hz.denominator * 2 + rate_hz.numerator) // (2 * rate_hz.numerator)


def wait_until(target_ns: int, now_ns: Callable[[], int], sleep: Callable[[float], None], spin_ns: int) -> int:
    """Hybrid wait: sleep until ``spin_ns`` before the target, then read the clock; returns the time."""
    now = now_ns()
    while target_ns - now > spin_ns:
        sleep((target_ns - now - spin_ns) * 1e-9)
        now = now_ns()
    while now < target_ns:
        now = now_ns()
    return now
