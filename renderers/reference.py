"""The gold standard that techniques are compared with: many samples a pixel, no delay.

Averaging order: the samples of a pixel are averaged as linear light, before exposure, tone curve and clipping, over the
pixel's square (box filter). Sample places are the R2 sequence (Roberts 2018), turned by a hash of pixel and seed, the
same in every frame, so that what rests looks at rest.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from renderers.backend import dr, mi
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen, opaque_float, opaque_uint
from renderers.parameters import Reference
from renderers.rng import combined
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, Measure, View
from renderers.units import average_blocks, block_sizes
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
        self._buffer = opaque_float(np.zeros(size_px[0] * size_px[1] * 3))
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._kernel = frozen(self._add)
        self._write = frozen(lambda pixel, color, share, buffer: interleaved(color * share, pixel, buffer))
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        self._seed = opaque_uint(seed % (1 << 32))

    def _zeros(self, lanes: int) -> tuple[Any, dict[str, Any], Any]:
        """Empty sums, in memory."""
        kinds = ("shadow", "ambient_occlusion", "reflection", "transmission", "probe")
        empty = (
            dr.zeros(mi.Color3f, lanes),
            {kind: dr.zeros(mi.UInt32, lanes) for kind in kinds},
            dr.zeros(mi.UInt32, lanes),
        )
        dr.make_opaque(empty)
        return empty

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
        """The average of ``spp`` samples at t1: of blocks of `SAMPLE_BLOCK`, the same whoever renders them."""
        sizes = block_sizes(self.params.spp)
        blocks = [self.render_samples(view, sum(sizes[:k]), size) for k, size in enumerate(sizes)]
        if len(blocks) == 1:
            return blocks[0]
        return replace(
            blocks[0],
            color=average_blocks([block.color for block in blocks], sizes),
            rays={kind: sum(block.rays[kind] for block in blocks) for kind in blocks[0].rays},
            seconds={stage: sum(block.seconds[stage] for block in blocks) for stage in blocks[0].seconds},
            clamped=sum(block.clamped for block in blocks),
        )

    def render_samples(self, view: View, first: int, count: int) -> Frame:
        """The average of the samples [first, first + count) of the pixel's ``spp``; arrays of its own."""
        width, height = self.size_px
        lanes = width * height
        with self._watch.frame():
            with self._watch.stage("state"):
                state = self.engine.state(view, self.size_px)
                narrowing = opaque_float(self.params.spp**-0.5)
                total, rays, wrong = self._zeros(lanes)
            with self._watch.stage("trace"):
                for number in range(first, first + count):
                    total, rays, wrong = self._kernel(
                        lanes,
                        state,
                        self._pixel,
                        self._x,
                        self._y,
                        self._seed,
                        opaque_uint(number),
                        narrowing,
                        total,
                        rays,
                        wrong,
                    )
            with self._watch.stage("write"):
                self._buffer = self._write(lanes, self._pixel, total, opaque_float(1 / count), self._buffer)
        return Frame(
            color=np.array(self._buffer.numpy()).reshape(height, width, 3),
            rays=ray_counts(lanes * count, rays),
            seconds=dict(self._watch.seconds),
            time_s=float(view.index * (view.t1 - view.t0)),
            clamped=int(dr.sum(wrong)[0]),
        )
