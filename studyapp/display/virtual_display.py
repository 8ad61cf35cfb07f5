"""A display whose clock is set by the session itself: no pixels, no waiting, scripted faults.

It runs sessions as fast as the machine can (`simulate`), and plants faults whose truth is known (tests). A block of
refreshes without faults costs one numpy expression; a fault goes stamp by stamp through the same grid as a window's.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from protocols.records import FLIP_DTYPE
from studyapp.display.vblank import DEADLINE_SLACK, VblankGrid, grid_time_ns
from studyapp.seams import Flip, StampClass


@dataclass(frozen=True)
class Fault:
    """What goes wrong at one swap. miss: ``amount`` refreshes are lost before it; early: it is shown ``amount`` of a
    period after the last; slip: from here on every refresh is displaced by ``amount`` of a period."""

    kind: Literal["miss", "early", "slip"]
    amount: float = 1.0


def random_faults(
    swaps: int, rng: np.random.Generator, miss: float = 0.0, early: float = 0.0, slip: float = 0.0
) -> dict[int, Fault]:
    """A script with the given probabilities a swap. Slips stand at least 8 swaps from any other fault (a slip is told
    from a late stamp by what follows it), and no more than two early swaps follow one another (three fill a period)."""
    draws = rng.random(swaps)
    faults: dict[int, Fault] = {}
    blocked_until = 0
    for swap in np.flatnonzero(draws < miss + early + slip).tolist():
        if swap < max(2, blocked_until):
            continue
        if draws[swap] < miss:
            faults[swap] = Fault("miss", int(rng.integers(1, 6)))
        elif draws[swap] < miss + early:
            if all(faults.get(near, Fault("miss")).kind == "early" for near in (swap - 1, swap - 2)):
                continue
            faults[swap] = Fault("early", float(rng.uniform(0.05, 0.4)))
        elif swap < swaps - 8 and not any(near in faults for near in range(swap - 8, swap)):
            faults[swap] = Fault("slip", float(rng.choice([-1, 1]) * rng.uniform(0.2, 0.4)))
            blocked_until = swap + 8
    return faults


class VirtualDisplay:
    """See the module. ``faults`` maps the number of a swap (0, 1, ...) to what goes wrong there; ``jitter`` is the SD
    of the stamps as a share of the period (then every stamp is placed one by one)."""

    stamp_class: StampClass = "virtual"

    def __init__(
        self,
        size_px: tuple[int, int] = (1920, 1080),
        rate_hz: Fraction | int = 240,
        faults: Mapping[int, Fault] | None = None,
        jitter: float = 0.0,
        rng: np.random.Generator | None = None,
        start_ns: int = 1_000_000_000,
    ) -> None:
        if jitter and rng is None:
            raise ValueError("VirtualDisplay: rng: got None, wanted a Generator where jitter is not 0")
        self.size_px = size_px
        self.nominal_hz = Fraction(rate_hz)
        self.description = f"virtual display, {size_px[0]}x{size_px[1]} at {float(self.nominal_hz):g} Hz, no pixels"
        self._faults = dict(faults or {})
        self._fault_swaps = sorted(self._faults)
        self._jitter, self._rng = jitter, rng
        self._period_ns = float(1_000_000_000 / self.nominal_hz)
        self._grid = VblankGrid(self._period_ns, DEADLINE_SLACK[self.stamp_class])
        self._start_ns = start_ns
        self._swap = 0
        self._true_index = -1  # the raster's own count, which the grid must find
        self._slipped_ns = 0
        self._now_ns = start_ns - 1

    @property
    def period_ns(self) -> float:
        """The period the grid believes in."""
        return self._grid.period_ns

    def context(self) -> None:
        """No pixels are drawn."""
        return

    def now_ns(self) -> int:
        """The display's own clock: the newest stamp."""
        return self._now_ns

    def flip(self) -> Flip:
        """One swap, through the grid."""
        shown = self._stamp()
        index, due, missed, flags = self._grid.place(shown)
        return Flip(index, due, shown, shown, missed, flags)

    def flip_block(self, count: int, stop_index: int | None = None) -> np.ndarray:
        """Up to ``count`` swaps as (n,) FLIP_DTYPE rows (refresh, due, submitted, shown, missed, flags filled in);
        ends after the swap that reaches refresh ``stop_index`` - 1."""
        parts: list[np.ndarray] = []
        left = count
        while left > 0 and (stop_index is None or self._grid.index < stop_index - 1):
            clean = self._clean_run(left if stop_index is None else min(left, stop_index - 1 - self._grid.index))
            part = self._leap(clean) if clean else self._single()
            parts.append(part)
            left -= len(part)
        return np.concatenate(parts) if parts else np.zeros(0, FLIP_DTYPE)

    def keys(self) -> list[tuple[str, int]]:
        """No keyboard."""
        return []

    def read_pixels(self) -> np.ndarray:
        """A black picture: nothing is drawn here."""
        return np.zeros((self.size_px[1], self.size_px[0], 3), np.uint8)

    def close(self) -> None:
        """Nothing to give back."""

    def _stamp(self) -> int:
        """The next swap's stamp by the script; moves the raster on."""
        fault = self._faults.get(self._swap)
        self._swap += 1
        if fault is not None and fault.kind == "early":
            self._now_ns += round(fault.amount * self._period_ns)
            return self._now_ns
        self._true_index += 1
        if fault is not None and fault.kind == "miss":
            self._true_index += int(fault.amount)
        if fault is not None and fault.kind == "slip":
            self._slipped_ns += round(fault.amount * self._period_ns)
        shown = grid_time_ns(self._start_ns, self._true_index, self.nominal_hz) + self._slipped_ns
        if self._rng is not None and self._jitter:
            shown += round(float(self._rng.normal(0.0, self._jitter)) * self._period_ns)
        self._now_ns = max(shown, self._now_ns + 1)
        return self._now_ns

    def _clean_run(self, wanted: int) -> int:
        """How many of the next ``wanted`` swaps may be taken at once."""
        if self._jitter or self._grid.index < 0:
            return 0
        if self._now_ns != grid_time_ns(self._start_ns, self._true_index, self.nominal_hz) + self._slipped_ns:
            return 0  # just after an early swap
        if abs(self._grid.due_ns(0) - self._now_ns) > 1:
            return 0  # a slip that the grid has not confirmed yet
        place = bisect_left(self._fault_swaps, self._swap)
        until = self._fault_swaps[place] if place < len(self._fault_swaps) else self._swap + wanted
        return min(wanted, until - self._swap)

    def _leap(self, count: int) -> np.ndarray:
        rows = np.zeros(count, FLIP_DTYPE)
        steps = np.arange(1, count + 1, dtype=np.int64)
        number, over = self.nominal_hz.numerator, self.nominal_hz.denominator
        # The same exact rounding as `grid_time_ns`; split so that int64 holds it for any session length.
        whole, part = np.divmod(self._true_index + steps, number)
        shown = self._start_ns + self._slipped_ns + whole * (1_000_000_000 * over)
        shown = shown + (part * (2_000_000_000 * over) + number) // (2 * number)
        rows["refresh"] = self._grid.index + steps
        rows["due_ns"] = rows["submitted_ns"] = rows["shown_ns"] = shown
        self._swap += count
        self._true_index += count
        self._now_ns = int(shown[-1])
        self._grid.leap(count, self._now_ns)
        return rows

    def _single(self) -> np.ndarray:
        flip = self.flip()
        rows = np.zeros(1, FLIP_DTYPE)
        rows["refresh"], rows["due_ns"], rows["submitted_ns"] = flip.index, flip.due_ns, flip.submitted_ns
        rows["shown_ns"], rows["missed"], rows["flags"] = flip.shown_ns, flip.missed, flip.flags
        return rows
