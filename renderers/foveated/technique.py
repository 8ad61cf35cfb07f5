"""Foveated ray tracing with reprojection (Weier et al., Pacific Graphics 2016).

A frame: the last support grid is moved and rasterised (where was each pixel?), what reprojects badly is marked, the
pixels of the fovea, of the support image, the marked and the randomly drawn ones are traced, the last picture is
filtered into the new one (holes come from the support image), samples are merged into it. Frame 0 and cuts trace all.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from renderers.backend import dr, mi
from renderers.eccentricity import EyePlane, eye_plane
from renderers.engine import LARGEST, Engine, EngineState
from renderers.eye_angles import pixel_eccentricity_deg, plane_values
from renderers.foveated.cache import first_samples, merge
from renderers.foveated.post_filter import filter_light
from renderers.foveated.reprojection import BACKGROUND, look, mark, resolve, world_depth
from renderers.foveated.support import IS_TEXEL, SupportGrid, extract, move
from renderers.frozen import frozen, opaque_float, opaque_uint
from renderers.gl.context import MeshRasteriser
from renderers.parameters import Foveated as FoveatedParameters
from renderers.parameters import Vanilla as VanillaParameters
from renderers.pixels import tile_order
from renderers.rng import combined, uniform
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, Measure, View
from renderers.vanilla import Vanilla, frame_seed, ray_counts
from stimuli.errors import InputError, problem

T_MAX_S = Fraction(213, 1000)
FOVEA = 2.0
"""Stands for the probability of a pixel of the fovea, whose sample is shown as it is."""
_DRAW, _TAPS, _FILTER = 0x1B873593, 0xCC9E2D51, 0xE6546B64
"""Tell apart what a frame's seed is used for."""


class Foveated:
    """Gaze-contingent; `show` gives the debug pictures of the last frame. Configuration 'full' is `Vanilla` itself."""

    name: ClassVar[str] = "foveated"
    Params: ClassVar[type[FoveatedParameters]] = FoveatedParameters

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: FoveatedParameters, seed: int, measure: Measure
    ) -> None:
        if min(size_px) < 1:
            raise InputError(problem("size_px", "picture size", f"{size_px[0]}x{size_px[1]}", "at least 1x1"))
        self.engine, self.size_px, self.params = engine, size_px, params
        self._full: Vanilla | None = None
        if math.isinf(params.region[0]):
            same = VanillaParameters(light_samples=params.light_samples, delay_frames=0)
            self._full = Vanilla(engine, size_px, same, seed, measure)
            return
        self.grid = grid = SupportGrid.of(size_px, params.support_divisor)
        sampled = {"area", "sphere"} & set(engine.requirements.lights)
        self.noisy = engine.lighting == "ambient_occlusion" or bool(sampled)
        self._names = ("surface", "albedo", "light") if self.noisy else ("shown",)
        self._order = opaque_uint(tile_order(*size_px))
        self._texel_of = opaque_uint(grid.texel_of_pixels())
        self._texel_pixel = opaque_uint(grid.texel_pixels())
        x, y, texel = grid.vertices()
        self._vertices = (opaque_float(x), opaque_float(y), opaque_uint(texel))
        self._rasteriser = MeshRasteriser(size_px, *grid.mesh)
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._kernels = {
            kernel.__name__: frozen(kernel)
            for kernel in (
                self._probabilities, self._move, self._look, self._mark, self._select, self._trace, self._extract,
                self._resolve, self._merge, self._choose, self._filter,
            )
        }  # fmt: skip
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        self._seed, self._history = seed, False
        if self._full is not None:
            self._full.reset(seed)
            return
        pixels, texels = self.size_px[0] * self.size_px[1], self.grid.texels
        sizes = dict.fromkeys((*self._names, "shown"), 4) | {"info": 2} | ({"rho_light": 1} if self.noisy else {})
        self._now, self._before = (
            {name: opaque_float(np.zeros(pixels * size)) for name, size in sizes.items()} for _ in range(2)
        )
        self._carried = tuple(name for name in sizes if name != "shown" or not self.noisy)
        self._support = {name: opaque_float(np.zeros(texels * 4)) for name in (*self._names, "normal")}
        self._support |= {"z": opaque_float(np.zeros(texels)), "mover": opaque_uint(np.zeros(texels))}
        self._marks = opaque_uint(np.zeros(texels))
        self._mesh: Any = None
        self._plane: EyePlane | None = None
        self._probability: Any = None
        self._sampled: Any = None
        self._alpha: Any = None

    # Kernels --------------------------------------------------------------------------------------------------------

    def _probabilities(self, plane: Any, texel_of: Any) -> Any:
        """How likely each pixel is traced (Float, scanline order); `FOVEA` up to r0."""
        width = self.size_px[0]
        index = dr.arange(mi.UInt32, dr.width(texel_of))
        y = index // width
        e = pixel_eccentricity_deg(plane, mi.Float(index - y * width) + 0.5, mi.Float(y) + 0.5)
        r0, r1, p_min = self.params.region
        slope = (1 - p_min) / (r1 - r0) if r0 < r1 < math.inf else 0.0
        inner = 1 - slope * (e - r0)
        return dr.select(e <= r0, FOVEA, dr.select(e >= r1, p_min, inner))

    def _move(self, state: EngineState, x: Any, y: Any, mesh: tuple[Any, ...]) -> tuple[Any, Any]:
        return move(self.engine, state, x, y, *mesh)

    def _look(self, *of: Any) -> Any:
        return look(self.grid, *of)

    def _mark(self, looks: Any) -> Any:
        return mark(self.params, self.grid, looks)

    def _select(self, history: bool, order: Any, probability: Any, texel_of: Any, marks: Any, seed: Any) -> Any:
        """The numbers of the pixels to trace, in tile order."""
        if not history:
            return order
        texel = dr.gather(mi.UInt32, texel_of, order)
        drawn = uniform(combined(seed ^ _DRAW, order), 0) < dr.gather(mi.Float, probability, order)
        marked = dr.gather(mi.UInt32, marks, texel & (IS_TEXEL - 1)) > 0
        lanes = dr.compress(drawn | marked | (texel >= IS_TEXEL))
        return dr.gather(mi.UInt32, order, lanes)

    def _trace(
        self, state: EngineState, pixel: Any, texel_of: Any, seed: Any, support: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any], Any, Any]:
        """A sample a lane; those of the support image are written there, with the G-buffer.

        Lanes keep the 8x8 tile order, and rays their coherent mode, although 84 % of the pixels are missing: 120 ms
        (274k lanes, point light, loaded machine) against 139 to 154 in tiles of 4, 16, 32 and Morton order, 232 if not
        coherent.
        """
        width = self.size_px[0]
        y = pixel // width
        ray = self.engine.camera_ray(state, mi.Float(pixel - y * width) + 0.5, mi.Float(y) + 0.5)
        got = self.engine.sample(state, ray, rng=combined(seed, pixel), light_samples=self.params.light_samples)
        sample = {"color": got.color, "z": got.z}
        if self.noisy:
            for name in ("surface", "albedo", "light"):
                value = getattr(got, name)
                sample[name] = dr.select(dr.isnan(value), 0, dr.clip(value, 0, LARGEST))
        texel = dr.gather(mi.UInt32, texel_of, pixel)
        own, texel = texel >= IS_TEXEL, texel & (IS_TEXEL - 1)
        for name in self._names:
            value = sample["color" if name == "shown" else name]
            dr.scatter(support[name], mi.Vector4f(value.x, value.y, value.z, 0), texel, own)
        n = got.normal_geometric
        dr.scatter(support["normal"], mi.Vector4f(n.x, n.y, n.z, 0), texel, own)
        dr.scatter(support["z"], got.z, texel, own)
        dr.scatter(support["mover"], got.mover, texel, own)
        return sample, support, got.rays, got.clamped

    def _extract(self, state: EngineState, x: Any, y: Any, texel: Any, z: Any, normal: Any, mover: Any) -> Any:
        return extract(self.engine, self.params.reproject_movers, state, x, y, texel, z, normal, mover)

    def _resolve(self, place: Any, old: Any, support: Any, seed: Any, new: Any) -> Any:
        return resolve(self.params, self.grid, self._names, place, old, support, seed ^ _TAPS, new)

    def _merge(
        self, pixel: Any, sample: dict[str, Any], probability: Any, texel_of: Any, marks: Any, depth: Any,
        to_world: Any, t_max: Any, buffers: dict[str, Any],
    ) -> tuple[dict[str, Any], Any]:  # fmt: skip
        if depth is None:
            return first_samples(pixel, sample, buffers)
        texel = dr.gather(mi.UInt32, texel_of, pixel) & (IS_TEXEL - 1)
        overwrite = (dr.gather(mi.Float, probability, pixel) > 1) | (dr.gather(mi.UInt32, marks, texel) > 0)
        z_cache = world_depth(dr.gather(mi.Float, depth, pixel), to_world)
        far = to_world * BACKGROUND
        return merge(self.params, pixel, sample, overwrite, z_cache, far, t_max, buffers)

    def _choose(self, pixel: Any, probability: Any, texel_of: Any, marks: Any) -> Any:
        """Which of the traced pixels the post filter may change (Bool): those marked, outside the fovea."""
        texel = dr.gather(mi.UInt32, texel_of, pixel) & (IS_TEXEL - 1)
        return (dr.gather(mi.UInt32, marks, texel) > 0) & (dr.gather(mi.Float, probability, pixel) <= 1)

    def _filter(
        self, pixels: Any, chosen: Any, marks: Any, probability: Any, seed: Any, buffers: dict[str, Any]
    ) -> Any:
        pixel = dr.gather(mi.UInt32, pixels, chosen)
        return filter_light(self.params.post_filter, self.grid, marks, probability, pixel, seed ^ _FILTER, buffers)

    # A frame --------------------------------------------------------------------------------------------------------

    def render(self, view: View) -> Frame:
        """This refresh, for the view's gaze."""
        if self._full is not None:
            return self._full.render(view)
        if view.cut:
            self._history = False
        stage, run = self._watch.stage, self._kernels
        width, height = self.size_px
        pixels, texels, vertices = width * height, self.grid.texels, self.grid.mesh[0] * self.grid.mesh[1]
        with self._watch.frame():
            with stage("state"):
                state = self.engine.state(view, self.size_px)
                seed = frame_seed(self._seed, view.index)
                self._see(view)
            place = depth = None
            self._now, self._before = self._before, self._now
            if self._history:
                with stage("move"):
                    moved, edge = run["_move"](vertices, state, *self._vertices[:2], self._mesh)
                with stage("raster"):
                    place, depth = self._rasteriser.draw(moved)
                with stage("marks"):
                    exposure = opaque_float(view.exposure)
                    looks = run["_look"](
                        texels, place, depth, self._before["shown"], edge, state.to_world, exposure, self._texel_pixel
                    )
                    self._marks = run["_mark"](texels, looks)
            with stage("select"):
                pixel = run["_select"](
                    pixels, self._history, self._order, self._probability, self._texel_of, self._marks, seed
                )
                lanes = dr.width(pixel)
            with stage("trace"):
                sample, self._support, rays, clamped = run["_trace"](
                    lanes, state, pixel, self._texel_of, seed, self._support
                )
            with stage("extract"):
                z, normal, mover = (self._support[name] for name in ("z", "normal", "mover"))
                self._mesh = run["_extract"](vertices, state, *self._vertices, z, normal, mover)
            if self._history:
                with stage("resolve"):
                    colors = {name: self._support[name] for name in self._names}
                    old = {name: self._before[name] for name in self._carried}
                    self._now = run["_resolve"](pixels, place, old, colors, seed, self._now)
            with stage("merge"):
                t_max = opaque_float(self.t_max(view))
                self._now, self._alpha = run["_merge"](
                    lanes, pixel, sample, self._probability, self._texel_of, self._marks, depth, state.to_world,
                    t_max, self._now,
                )  # fmt: skip
            if self._history and self.noisy and self.params.post_filter:
                with stage("post filter"):
                    # compressed outside of the recording: Dr.Jit 1.5 aborts where a recorded result has no lanes
                    chosen = dr.compress(run["_choose"](lanes, pixel, self._probability, self._texel_of, self._marks))
                    if count := dr.width(chosen):
                        self._now["shown"] = run["_filter"](
                            count, pixel, chosen, self._marks, self._probability, seed, self._now
                        )
        self._sampled, self._history = pixel, True
        return Frame(
            color=self._now["shown"].numpy().reshape(height, width, 4)[..., :3],
            rays=ray_counts(lanes, rays),
            seconds=dict(self._watch.seconds),
            time_s=float(view.index * (view.t1 - view.t0)),
            clamped=int(dr.sum(clamped)[0]),
        )

    def t_max(self, view: View) -> int:
        """Frames after which a cached pixel is old: the parameter, or 0.213 s at the view's rate, at least 1."""
        return self.params.t_max or max(1, round(T_MAX_S * view.rate_hz))

    def _see(self, view: View) -> None:
        """Probabilities for the view's gaze, computed anew where it or the geometry changed."""
        plane = eye_plane(self.size_px, view.camera.yfov_rad, view.geometry, view.gaze)
        if plane != self._plane:
            pixels = self.size_px[0] * self.size_px[1]
            self._plane = plane
            self._probability = self._kernels["_probabilities"](pixels, plane_values(plane), self._texel_of)

    def show(self, view: View) -> dict[str, np.ndarray]:
        """Debug pictures of the last frame, (H, W) each: ``sampled``, ``marks`` (0 or 1), ``probability``, ``alpha``
        (weight of this frame's samples; 0: none), and of the cache ``samples`` (rho; 0: from the support image) and
        ``age`` (frames)."""
        width, height = self.size_px
        if self._full is not None:
            one = np.ones((height, width), np.float32)
            return {"sampled": one, "marks": 0 * one, "probability": one, "alpha": one, "samples": one, "age": 0 * one}
        sampled = np.zeros(width * height, np.float32)
        pixel = self._sampled.numpy()
        sampled[pixel] = 1
        alpha = np.zeros(width * height, np.float32)
        alpha[pixel] = self._alpha.numpy()
        texel = self._texel_of.numpy() & (IS_TEXEL - 1)
        info = self._now["info"].numpy().reshape(height, width, 2)
        shape = (height, width)
        return {
            "sampled": sampled.reshape(shape),
            "marks": self._marks.numpy()[texel].astype(np.float32).reshape(shape),
            "probability": np.minimum(self._probability.numpy(), 1).reshape(shape),
            "alpha": alpha.reshape(shape),
            "samples": info[..., 0].copy(),
            "age": info[..., 1].copy(),
        }

    def close(self) -> None:
        """Free the OpenGL context."""
        if self._full is None:
            self._rasteriser.close()
