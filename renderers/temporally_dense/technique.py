"""Temporally dense ray tracing: a quarter of the pixels a frame at four times the rate (Andersson et al., HPG 2019).

Each 2x2 tile traces one pixel a frame in an hourglass or bowtie order chosen by the tile's motion; the other three are
reprojected along the longest motion vector and clamped to the colours of their newest neighbours; static pixels average
their last four jittered samples. The adaptive order is claimed by US patents 11,089,320 and 11,120,609 (NVIDIA).
Simplification: temporal change other than motion (moving shadows) is not detected, as in the paper.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from renderers.backend import dr, mi
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen, opaque_uint
from renderers.parameters import TemporallyDense as TemporallyDenseParameters
from renderers.pixels import tile_order
from renderers.rng import combined
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, Measure, View
from renderers.temporally_dense.compose import STATIC_PX, Settings, compose
from renderers.temporally_dense.pixel_order import STATIC_JITTER, coin_flip, decide, pixel_in_tile
from renderers.vanilla import finished_frame, frame_seed
from stimuli.errors import InputError, problem


def camera_moved(poses: np.ndarray) -> bool:
    """Whether the camera's pose (K, 4, 4: from t0 to t1) at t1 is another than at t0."""
    return not np.array_equal(poses[0], poses[-1])


class TemporallyDense:
    """One ray a 2x2 tile and refresh; `show` gives the debug pictures of the last frame."""

    name: ClassVar[str] = "temporally_dense"
    Params: ClassVar[type[TemporallyDenseParameters]] = TemporallyDenseParameters

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: TemporallyDenseParameters, seed: int, measure: Measure
    ) -> None:
        if min(size_px) < 1:
            raise InputError(problem("size_px", "picture size", f"{size_px[0]}x{size_px[1]}", "at least 1x1"))
        self.engine, self.size_px, self.params = engine, size_px, params
        self.settings = Settings(
            *size_px, params.neighbourhood, params.reproject, params.box_sigmas, params.least_sigma
        )
        self.tiles = self.settings.tiles_x * self.settings.tiles_y
        self._lanes = mi.UInt32(tile_order(self.settings.tiles_x, self.settings.tiles_y))
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._trace_kernel, self._compose_kernel = frozen(self._trace), frozen(compose)
        self._choose_kernel = frozen(self._choose)
        self._four = [opaque_uint(k) for k in range(4)]
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        width, height = self.size_px
        self._seed, self._frame = seed, 0
        self._picture = dr.zeros(mi.Float, width * height * 4)
        self._window = dr.zeros(mi.Float, width * height * 16)
        self._samples = dr.zeros(mi.Float, self.tiles * 4)
        self._motion = dr.zeros(mi.Float, self.tiles * 2)
        self._hourglass = dr.ones(mi.UInt32, self.tiles)
        self._last_dynamic = dr.zeros(mi.UInt32, self.tiles)
        self._tile_motion = (dr.zeros(mi.Float, self.tiles), dr.zeros(mi.Float, self.tiles))
        dr.make_opaque(
            self._picture,
            self._window,
            self._samples,
            self._motion,
            self._hourglass,
            self._last_dynamic,
            self._tile_motion,
        )

    def _trace(
        self, jitter: bool, state: EngineState, tile: Any, hourglass: Any, last_dynamic: Any, subframe: Any, slot: Any,
        frame: Any, seed: Any, samples: Any, motion: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        """The sample of each tile in this subframe, its motion, and the rays it took."""
        s = self.settings
        tile_y = tile // s.tiles_x
        tile_x = tile - tile_y * s.tiles_x
        order = dr.gather(mi.UInt32, hourglass, tile)
        column, row = pixel_in_tile(order == 1, subframe)
        px = dr.minimum(tile_x * 2 + column, s.width - 1)
        py = dr.minimum(tile_y * 2 + row, s.height - 1)
        x, y = mi.Float(0.5), mi.Float(0.5)
        if jitter:
            # the class of the last frame decides; pixels that were dynamic are sampled at their centres
            was_static = dr.gather(mi.UInt32, last_dynamic, tile) + 1 < frame
            jx, jy = mi.Float(0), mi.Float(0)
            for k, (at_x, at_y) in enumerate(STATIC_JITTER):
                jx, jy = dr.select(slot == k, at_x, jx), dr.select(slot == k, at_y, jy)
            x, y = dr.select(was_static, jx, x), dr.select(was_static, jy, y)
        ray = self.engine.camera_ray(state, mi.Float(px) + x, mi.Float(py) + y)
        sample = self.engine.sample(
            state, ray, rng=combined(seed, py * s.width + px), light_samples=self.params.light_samples, want_motion=True
        )
        moved = self.engine.motion(state, sample, reflected=self.params.reflected_motion)
        color = sample.color
        dr.scatter(samples, mi.Vector4f(color.x, color.y, color.z, mi.Float(order)), tile)
        dr.scatter(motion, moved, tile)
        return samples, motion, sample.rays, sample.clamped

    def _choose(self, mx: Any, my: Any, cycle: Any, seed: Any) -> Any:
        """Each tile's order for the next four frames (UInt32, 1 hourglass, 0 bowtie)."""
        order = self.params.order
        coin = coin_flip(dr.arange(mi.UInt32, self.tiles), cycle, seed)
        if order in ("hourglass", "bowtie"):
            chosen = mi.Bool(order == "hourglass") & (mx == mx)
        elif order == "random":
            chosen = coin
        else:
            chosen = decide("dominant" if order == "dominant" else self.params.decision, mx, my, coin)
        return dr.select(chosen, mi.UInt32(1), mi.UInt32(0))

    def render(self, view: View) -> Frame:
        """This refresh: a quarter of the pixels traced at t1, the whole picture composed."""
        if view.cut:
            self._frame = 0
        n = self._frame
        moving, history = camera_moved(self.engine.camera_poses(view)), n > 0
        with self._watch.frame():
            with self._watch.stage("state"):
                state = self.engine.state(view, self.size_px)
                subframe, slot = self._four[n % 4], self._four[n // 4 % 4]
                frame = opaque_uint(n + 1)
                seed = frame_seed(self._seed, view.index)
            with self._watch.stage("trace"):
                self._samples, self._motion, rays, clamped = self._trace_kernel(
                    self.tiles, history and not moving, state, self._lanes, self._hourglass, self._last_dynamic,
                    subframe, slot, frame, seed, self._samples, self._motion,
                )  # fmt: skip
            with self._watch.stage("compose"):
                self._picture, self._window, self._last_dynamic, mx, my = self._compose_kernel(
                    self.tiles, self.settings, moving, history, self._picture, self._samples, self._motion,
                    self._window, self._last_dynamic, subframe, slot, frame,
                )  # fmt: skip
                self._tile_motion = (mx, my)
                if n % 4 == 0:
                    self._hourglass = self._choose_kernel(
                        self.tiles, mx, my, opaque_uint(n // 4), opaque_uint(self._seed % (1 << 32))
                    )
        self._frame += 1
        return finished_frame(view, self.size_px, self._picture, self.tiles, rays, clamped, self._watch)

    def show(self, view: View) -> dict[str, np.ndarray]:
        """Debug pictures of the last frame, (H, W) each: ``segmentation`` (1 hourglass, 0 bowtie; Fig. 9), ``class``
        (0 static, 1 dynamic; + 2 where traced in this frame), ``motion.X``, ``motion.Y``
        (the tile's longest motion, pixels a frame)."""
        s = self.settings
        subframe = (self._frame - 1) % 4
        hourglass = self._hourglass.numpy().reshape(s.tiles_y, s.tiles_x)
        mx, my = (np.broadcast_to(m.numpy(), self.tiles).reshape(s.tiles_y, s.tiles_x) for m in self._tile_motion)
        dynamic = (mx**2 + my**2 >= STATIC_PX**2) | camera_moved(self.engine.camera_poses(view))
        rows, columns = np.mgrid[0 : s.height, 0 : s.width]
        per_tile = {"segmentation": hourglass, "class": dynamic.astype(np.uint32), "motion.X": mx, "motion.Y": my}
        found = {name: values[rows // 2, columns // 2] for name, values in per_tile.items()}
        index = np.full(rows.shape, subframe)
        if subframe in (1, 2):  # the two in which the orders differ
            index = np.where(found["segmentation"] == 1, subframe, 3 - subframe)
        at_x = np.minimum(columns // 2 * 2 + (index & 1), s.width - 1)
        at_y = np.minimum(rows // 2 * 2 + (index >> 1), s.height - 1)
        found["class"] = found["class"] + np.uint32(2) * ((columns == at_x) & (rows == at_y))
        return found
