"""The gold standard that techniques are compared with: many samples a pixel, no delay.

Averaging order: the samples of a pixel are averaged as linear light, before exposure, tone curve and clipping, over the
pixel's square (box filter). Sample places are the R2 sequence (Roberts 2018), turned by a hash of pixel and seed, the
same in every frame, so that what rests looks at rest.
"""

from __future__ import annotations

from typing import Any, ClassVar

from renderers.backend import dr, mi
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen
from renderers.parameters import Reference
from renderers.rng import combined
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, Measure, View
from renderers.vanilla import frame_lanes, interleaved, ray_counts

_R2 = (3242174889, 2447445414)  # 2^32 / g and 2^32 / g^2 for the plastic number g
_UNIT = 1.0 / (1 << 24)


class ReferenceRenderer:
    """``spp`` samples a pixel at t1."""

    name: ClassVar[str] = "reference"
    Params: ClassVar[type[Reference]] = Reference

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: Reference, seed: int, measure: Measure
    ) -> None:
        self.engine, self.size_px, self.params = engine, size_px, params
        self._pixel, self._x, self._y = frame_lanes(size_px)
        self._buffer = dr.zeros(mi.Float, size_px[0] * size_px[1] * 3)
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._kernel = frozen(self._add)
        self._write = frozen(lambda pixel, color, share, buffer: interleaved(color * share, pixel, buffer))
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        self._seed = mi.UInt32([seed % (1 << 32)])

    def _add(
        self,
        state: EngineState,
        pixel: Any,
        x: Any,
        y: Any,
        seed: Any,
        number: Any,
        narrowing: Any,
        total: Any,
        rays: Any,
        wrong: Any,
    ) -> tuple[Any, ...]:
        """One more sample of every pixel."""
        own = combined(seed, pixel)
        # Exact in 32-bit fixed point, however many samples.
        dx = mi.Float((combined(own, 1) + number * mi.UInt32(_R2[0])) >> 8) * _UNIT - 0.5
        dy = mi.Float((combined(own, 2) + number * mi.UInt32(_R2[1])) >> 8) * _UNIT - 0.5
        ray = self.engine.camera_ray(state, x + dx, y + dy)
        ray.spread = ray.spread * narrowing
        sample = self.engine.sample(state, ray, rng=combined(own, number + 3))
        return total + sample.color, {kind: rays[kind] + sample.rays[kind] for kind in rays}, wrong + sample.clamped

    def render(self, view: View) -> Frame:
        """The average of ``spp`` samples at t1."""
        width, height = self.size_px
        lanes = width * height
        spp = self.params.spp
        with self._watch.frame():
            with self._watch.stage("state"):
                state = self.engine.state(view, self.size_px)
                narrowing = mi.Float([spp**-0.5])
                total = dr.zeros(mi.Color3f, lanes)
                rays = {
                    kind: dr.zeros(mi.UInt32, lanes)
                    for kind in ("shadow", "reflection", "transmission", "ambient_occlusion", "probe")
                }
                wrong = dr.zeros(mi.UInt32, lanes)
            with self._watch.stage("trace"):
                for number in range(spp):
                    total, rays, wrong = self._kernel(
                        lanes,
                        state,
                        self._pixel,
                        self._x,
                        self._y,
                        self._seed,
                        mi.UInt32([number]),
                        narrowing,
                        total,
                        rays,
                        wrong,
                    )
            with self._watch.stage("write"):
                self._buffer = self._write(lanes, self._pixel, total, mi.Float([1 / spp]), self._buffer)
        return Frame(
            color=self._buffer.numpy().reshape(height, width, 3),
            rays=ray_counts(lanes * spp, rays),
            seconds=dict(self._watch.seconds),
            time_s=float(view.index * (view.t1 - view.t0)),
            clamped=int(dr.sum(wrong)[0]),
        )
