"""Temporal antialiasing: a jittered sample a pixel and refresh, accumulated along the motion, in two documented forms.

The forms are those of `renderers.taa_resolve`; both jitter by the first eight points of Halton(2, 3).
"""

from __future__ import annotations

from typing import Any, ClassVar

from renderers.backend import dr, mi
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen
from renderers.image import store
from renderers.parameters import TemporalAntialiasing as TemporalAntialiasingParameters
from renderers.rng import combined
from renderers.stopwatch import Stopwatch
from renderers.taa_resolve import HALTON_8, resolve
from renderers.technique import Frame, Measure, View
from renderers.vanilla import delayed, finished_frame, frame_lanes, frame_seed


class TemporalAntialiasing:
    """One sample a pixel; the picture shown is the accumulated one."""

    name: ClassVar[str] = "taa"
    Params: ClassVar[type[TemporalAntialiasingParameters]] = TemporalAntialiasingParameters

    def __init__(
        self,
        engine: Engine,
        size_px: tuple[int, int],
        params: TemporalAntialiasingParameters,
        seed: int,
        measure: Measure,
    ) -> None:
        self.engine, self.size_px, self.params = engine, size_px, params
        self._pixel, self._x, self._y = frame_lanes(size_px)
        self._alpha = dr.opaque(mi.Float, params.alpha)
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._trace_kernel, self._resolve_kernel = frozen(self._trace), frozen(resolve)
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        pixels = self.size_px[0] * self.size_px[1]
        self._seed, self._frame = seed, 0
        self._current = dr.zeros(mi.Float, pixels * 4)
        self._motion = dr.zeros(mi.Float, pixels * 2)
        self._history = dr.zeros(mi.Float, pixels * 4)
        dr.make_opaque(self._current, self._motion, self._history)

    def _trace(
        self, state: EngineState, pixel: Any, x: Any, y: Any, jitter: Any, seed: Any, current: Any, motion: Any
    ) -> tuple[Any, ...]:
        """The jittered sample of every pixel and its motion."""
        ray = self.engine.camera_ray(state, x + jitter.x, y + jitter.y)
        sample = self.engine.sample(
            state, ray, rng=combined(seed, pixel), light_samples=self.params.light_samples, want_motion=True
        )
        store(current, sample.color, mi.Float(0), pixel)
        dr.scatter(motion, self.engine.motion(state, sample, reflected=self.params.reflected_motion), pixel)
        return current, motion, sample.rays, sample.clamped

    def render(self, view: View) -> Frame:
        """The accumulated picture at t1, ``delay_frames`` refreshes ago."""
        width, height = self.size_px
        if view.cut:
            self._frame = 0
        with self._watch.frame():
            with self._watch.stage("state"):
                state = self.engine.state(delayed(view, self.params.delay_frames), self.size_px)
                jx, jy = HALTON_8[self._frame % len(HALTON_8)]
                jitter = mi.Vector2f(dr.opaque(mi.Float, jx - 0.5), dr.opaque(mi.Float, jy - 0.5))
                seed = frame_seed(self._seed, view.index)
            with self._watch.stage("trace"):
                self._current, self._motion, rays, clamped = self._trace_kernel(
                    width * height, state, self._pixel, self._x, self._y, jitter, seed, self._current, self._motion
                )
            with self._watch.stage("resolve"):
                history = self._history if self._frame else self._current
                alpha = self._alpha if self._frame else dr.opaque(mi.Float, 1.0)
                self._history = self._resolve_kernel(
                    width * height, self.params.form, width, height, self.params.box_sigmas, self._current,
                    self._motion, history, alpha,
                )  # fmt: skip
        self._frame += 1
        return finished_frame(view, self.size_px, self._history, width * height, rays, clamped, self._watch)
