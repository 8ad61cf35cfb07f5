"""Traditional frameless rendering (Bishop et al. 1994): pixels in random order, each shown as it was last sampled.

The baseline of Dayal et al. 2005, Table 1. Each pixel is sampled at its centre once in every random permutation of all.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from renderers.adaptive_frameless.budget import SampleClock
from renderers.adaptive_frameless.rays import CLAMPED, IN, OUT, FramelessRays, counted
from renderers.backend import dr
from renderers.engine import Engine, EngineState
from renderers.parameters import TraditionalFrameless as TraditionalFramelessParameters
from renderers.pixels import pixel_centres, tile_order
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, Measure, View
from stimuli.errors import InputError, problem


class TraditionalFrameless:
    """The newest sample at each pixel."""

    name: ClassVar[str] = "traditional_frameless"
    Params: ClassVar[type[TraditionalFramelessParameters]] = TraditionalFramelessParameters

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: TraditionalFramelessParameters, seed: int,
        measure: Measure,
    ) -> None:  # fmt: skip
        if min(size_px) < 1:
            raise InputError(problem("size_px", "picture size", f"{size_px[0]}x{size_px[1]}", "at least 1x1"))
        self.engine, self.size_px, self.params = engine, size_px, params
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._rays = FramelessRays(engine, visibility=False)
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        width, height = self.size_px
        self._rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
        self._clock = SampleClock(self.params.samples_per_s)
        self._picture = np.zeros((height, width, 3), np.float32)
        self._order = np.zeros(0, np.uint32)
        self._filled = False

    def _show(self, state: EngineState, pixels: np.ndarray, times_s: np.ndarray | float) -> np.ndarray:
        """Sample these pixels (no two alike); the sums of the result columns."""
        rows = np.zeros((len(pixels), IN), np.float32)
        rows[:, 0], rows[:, 1] = pixel_centres(pixels, self.size_px[0])
        rows[:, 2] = times_s
        found = self._rays.trace(state, rows, int(self._rng.integers(1 << 32)))
        self._picture.reshape(-1, 3)[pixels] = found[:, :3]
        return found.sum(axis=0, dtype=np.float64)

    def render(self, view: View) -> Frame:
        """The picture at t1, after this interval's samples; frame 0 and a cut sample every pixel once, at t1."""
        totals, primary = np.zeros(OUT), 0
        with self._watch.frame():
            with self._watch.stage("state"):
                state = self.engine.state(view, self.size_px)
            with self._watch.stage("trace"):
                if view.cut or not self._filled:
                    order = tile_order(*self.size_px)
                    totals, primary = self._show(state, order, 0.0), len(order)
                    self._filled = True
                else:
                    times_s = self._clock.take(view.t1 - view.t0)
                    primary, first = len(times_s), 0
                    while first < primary:
                        if not len(self._order):
                            self._order = self._rng.permutation(self.size_px[0] * self.size_px[1]).astype(np.uint32)
                        now = min(len(self._order), primary - first)
                        totals = totals + self._show(state, self._order[:now], times_s[first : first + now])
                        self._order, first = self._order[now:], first + now
        return Frame(
            color=self._picture,
            rays=counted(totals, primary, 0),
            seconds=dict(self._watch.seconds),
            time_s=float(view.index * (view.t1 - view.t0)),
            clamped=int(totals[CLAMPED]),
        )
