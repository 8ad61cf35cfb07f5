"""Samples a second as points in time: a stream that knows no frames, cut into the intervals of the refreshes."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np


class SampleClock:
    """Visits at an even pace of ``visits_per_s``. `take` hands out those of one refresh, and loses none between."""

    def __init__(self, visits_per_s: float) -> None:
        self._rate = Fraction(visits_per_s)
        self._due = Fraction(0)

    def take(self, interval_s: Fraction) -> np.ndarray:
        """(n,) float64 seconds relative to t1, in (-interval, 0], rising: the visits that fall into this interval."""
        self._due += self._rate * interval_s
        count = math.floor(self._due)
        self._due -= count
        if count == 0:
            return np.zeros(0)
        # the last visit fell due so long before t1 as the remainder took to gather
        last = -float(self._due / self._rate)
        return np.maximum(last - np.arange(count - 1, -1, -1) / float(self._rate), -float(interval_s))
