"""Fixation: is the observer looking where the trial wants it, before it (drift check) and during it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studyapp.gaze.angles import separation_dva
from studyapp.seams import GazeSource


@dataclass(frozen=True)
class DriftCheck:
    """Mean gaze against a fixation target: offset in degrees (right, up), its size, how many valid samples."""

    x_dva: float
    y_dva: float
    size_deg: float
    n: int

    def within(self, limit_deg: float) -> bool:
        """False where nothing was seen."""
        return self.n > 0 and self.size_deg <= limit_deg


def drift_check(samples: np.ndarray, target_dva: tuple[float, float] = (0.0, 0.0)) -> DriftCheck:
    """From (N, 3) samples x_dva, y_dva, valid; medians, so that a blink's edge does not count."""
    seen = samples[samples[:, 2] > 0] if len(samples) else np.zeros((0, 3))
    if not len(seen):
        return DriftCheck(float("nan"), float("nan"), float("nan"), 0)
    x, y = float(np.median(seen[:, 0])), float(np.median(seen[:, 1]))
    return DriftCheck(x - target_dva[0], y - target_dva[1], float(separation_dva(x, y, *target_dva)), len(seen))


@dataclass(frozen=True)
class Fixation:
    """Gaze during a trial. ``outside``: share of valid samples beyond the limit; ``worst_deg``: the farthest;
    ``loss``: share not valid. nan where there were none."""

    outside: float
    worst_deg: float
    loss: float
    n: int


class FixationWatch:
    """A `GazeSource` that the presenter asks once a refresh, and that remembers how far gaze strayed from ``target``.

    Its arrays are made beforehand: asking allocates next to nothing.
    """

    def __init__(self, gaze: GazeSource, target_dva: tuple[float, float] = (0.0, 0.0), capacity: int = 1 << 16) -> None:
        self.name = gaze.name
        self._gaze, self._target = gaze, target_dva
        self._rows = np.zeros((capacity, 3))
        self._n = 0

    def newest(self) -> tuple[float, float, int, bool] | None:
        sample = self._gaze.newest()
        if sample is not None and self._n < len(self._rows):
            row = self._rows[self._n]
            row[0], row[1], row[2] = sample[0], sample[1], sample[3]
            self._n += 1
        return sample

    def alive(self) -> bool:
        return self._gaze.alive()

    def begin(self) -> None:
        """Forget what was seen: a trial begins."""
        self._n = 0

    def first(self, count: int) -> DriftCheck:
        """The drift check on the first ``count`` refreshes (the fixation cross before the stimulus)."""
        return drift_check(self._rows[: min(count, self._n)], self._target)

    def result(self, limit_deg: float) -> Fixation:
        """What was seen since `begin`."""
        rows = self._rows[: self._n]
        seen = rows[rows[:, 2] > 0]
        if not len(rows) or not len(seen):
            return Fixation(float("nan"), float("nan"), float("nan") if not len(rows) else 1.0, 0)
        distance = separation_dva(seen[:, 0], seen[:, 1], *self._target)
        outside = float(np.mean(distance > limit_deg))
        return Fixation(outside, float(distance.max()), 1 - len(seen) / len(rows), len(seen))
