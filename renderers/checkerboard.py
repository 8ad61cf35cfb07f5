"""Checkerboard rendering: half of the pixels a refresh, alternating; the others from the last frame along the motion.

The related method of Andersson et al. 2019's introduction. A missing pixel takes the longest motion of its four traced
neighbours, is fetched bilinearly from the last picture, and clamped to their mean +- sigma in YCoCg; without history,
or from outside the picture, it is their mean. Details that no source fixes are those of `temporally_dense`.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from renderers.backend import dr, mi
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen, opaque_uint
from renderers.image import bilinear, fetch, from_ycocg, longest, mean_and_deviation, rgb, store, to_ycocg
from renderers.parameters import Checkerboard as CheckerboardParameters
from renderers.pixels import pixel_centres, tile_order
from renderers.rng import combined
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, Measure, View
from renderers.vanilla import finished_frame, frame_seed
from stimuli.errors import InputError, problem

_NEIGHBOURS = ((0, -1), (-1, 0), (1, 0), (0, 1))


def fill(
    width: int, height: int, box_sigmas: float, has_history: bool, phase: Any, current: Any, motion: Any, previous: Any
) -> Any:
    """The whole picture from the pixels with (x + y + phase) even, their motion (pairs) and the last picture."""
    index = dr.arange(mi.UInt32, width * height)
    y = mi.Int32(index // width)
    x = mi.Int32(index) - y * width
    traced = (mi.UInt32(x + y) + phase) & 1 == 0
    samples, vectors = [], []
    for ox, oy in _NEIGHBOURS:
        inside = (x + ox >= 0) & (x + ox < width) & (y + oy >= 0) & (y + oy < height)
        at = mi.UInt32(dr.clip(y + oy, 0, height - 1) * width + dr.clip(x + ox, 0, width - 1))
        samples.append((to_ycocg(rgb(fetch(current, at))), inside))
        vector = dr.gather(mi.Vector2f, motion, at)
        vectors.append((vector.x, vector.y, inside))
    mean, sigma, count = mean_and_deviation(samples)
    colour = mean
    if has_history:
        mx, my = longest(vectors)
        from_x, from_y = mi.Float(x) + 0.5 - mx, mi.Float(y) + 0.5 - my
        within = (from_x >= 0) & (from_x <= width) & (from_y >= 0) & (from_y <= height)
        history = to_ycocg(bilinear(previous, from_x, from_y, width, height, ~traced))
        # a picture of one pixel has no neighbours: its history stays
        clamped = dr.select(count > 0, dr.clip(history, mean - sigma * box_sigmas, mean + sigma * box_sigmas), history)
        colour = dr.select(within, clamped, mean)
    shown = dr.select(traced, rgb(fetch(current, index)), dr.maximum(from_ycocg(colour), 0))
    picture = dr.zeros(mi.Float, width * height * 4)
    store(picture, shown, mi.Float(0), index)
    return picture


class Checkerboard:
    """Half of the pixels a refresh."""

    name: ClassVar[str] = "checkerboard"
    Params: ClassVar[type[CheckerboardParameters]] = CheckerboardParameters

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: CheckerboardParameters, seed: int, measure: Measure
    ) -> None:
        if min(size_px) < 1:
            raise InputError(problem("size_px", "picture size", f"{size_px[0]}x{size_px[1]}", "at least 1x1"))
        self.engine, self.size_px, self.params = engine, size_px, params
        order = tile_order(*size_px)
        parity = (order % size_px[0] + order // size_px[0]) % 2
        self._lanes = []
        for phase in (0, 1):
            pixels = order[parity == phase]
            x, y = pixel_centres(pixels, size_px[0])
            self._lanes.append((len(pixels), mi.UInt32(pixels), mi.Float(x), mi.Float(y)))
        self._watch = Stopwatch(measure, dr.sync_thread)
        # the two halves have their own kernels: an odd picture's differ by a pixel, and may be of width 1 and 0
        self._trace_kernels = (frozen(self._trace), frozen(self._trace))
        self._fill_kernel = frozen(fill)
        self._none = opaque_uint(0)
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        pixels = self.size_px[0] * self.size_px[1]
        self._seed, self._frame = seed, 0
        self._current = dr.zeros(mi.Float, pixels * 4)
        self._motion = dr.zeros(mi.Float, pixels * 2)
        self._picture = dr.zeros(mi.Float, pixels * 4)
        dr.make_opaque(self._current, self._motion, self._picture)

    def _trace(
        self, state: EngineState, pixel: Any, x: Any, y: Any, seed: Any, current: Any, motion: Any
    ) -> tuple[Any, ...]:
        """The samples of this refresh's half and their motion."""
        ray = self.engine.camera_ray(state, x, y)
        sample = self.engine.sample(
            state, ray, rng=combined(seed, pixel), light_samples=self.params.light_samples, want_motion=True
        )
        store(current, sample.color, mi.Float(0), pixel)
        dr.scatter(motion, self.engine.motion(state, sample, reflected=self.params.reflected_motion), pixel)
        return current, motion, sample.rays, sample.clamped

    def render(self, view: View) -> Frame:
        """This refresh: half of the pixels traced at t1, the other half filled in."""
        width, height = self.size_px
        if view.cut:
            self._frame = 0
        phase = self._frame % 2
        count, *lanes = self._lanes[phase]
        rays: dict[str, Any] = {}
        clamped = self._none
        with self._watch.frame():
            with self._watch.stage("state"):
                state = self.engine.state(view, self.size_px)
                seed = frame_seed(self._seed, view.index)
            with self._watch.stage("trace"):
                traced = self._trace_kernels[phase](count, state, *lanes, seed, self._current, self._motion)
                if traced is not None:
                    self._current, self._motion, rays, clamped = traced
            with self._watch.stage("fill"):
                self._picture = self._fill_kernel(
                    width * height, width, height, self.params.box_sigmas, self._frame > 0, mi.UInt32([phase]),
                    self._current, self._motion, self._picture,
                )  # fmt: skip
        self._frame += 1
        return finished_frame(view, self.size_px, self._picture, count, rays, clamped, self._watch)

    def show(self, view: View) -> dict[str, np.ndarray]:
        """Debug pictures of the last frame, (H, W) each: ``sampled`` (1 where this refresh traced the pixel)."""
        rows, columns = np.mgrid[0 : self.size_px[1], 0 : self.size_px[0]]
        return {"sampled": ((rows + columns) % 2 == (self._frame - 1) % 2).astype(np.float32)}
