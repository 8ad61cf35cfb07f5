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

from renderers.backend import dr, is_cuda, mi
from renderers.eccentricity import EyePlane, eye_plane
from renderers.engine import LARGEST, Engine, EngineState
from renderers.eye_angles import pixel_eccentricity_deg, plane_values
from renderers.foveated import light_cache
from renderers.foveated.compose import NO_SAMPLE, OVERWRITES, compose, first_samples
from renderers.foveated.eyes import Eyes
from renderers.foveated.mesh_blocks import SIZES, BlockMesh, blocks_of, flat_blocks
from renderers.foveated.post_filter import filter_light
from renderers.foveated.reprojection import look, mark
from renderers.foveated.span_rasteriser import make_rasteriser
from renderers.foveated.support import IS_TEXEL, SupportGrid, extract, move
from renderers.frozen import frozen, opaque_float, opaque_uint
from renderers.parameters import Foveated as FoveatedParameters
from renderers.parameters import Vanilla as VanillaParameters
from renderers.pixels import tile_order
from renderers.rng import combined
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, Measure, View
from renderers.vanilla import Vanilla, frame_seed, ray_counts
from stimuli.errors import InputError, problem

T_MAX_S = Fraction(213, 1000)
FARTHEST = 1e30
"""World units that stand for the infinite depth of a miss where it lies beside a colour."""
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
        self._eyes = Eyes(lambda size: Foveated(engine, size, params, self._seed, measure))
        self._seed = seed
        self._full: Vanilla | None = None
        if math.isinf(params.region[0]):
            same = VanillaParameters(light_samples=params.light_samples, delay_frames=0)
            self._full = Vanilla(engine, size_px, same, seed, measure)
            return
        self.grid = grid = SupportGrid.of(size_px, params.support_divisor)
        sampled = {"area", "sphere"} & set(engine.requirements.lights)
        self.noisy = engine.lighting == "ambient_occlusion" or bool(sampled)
        self._names = light_cache.COLORS if self.noisy else ("shown",)
        self._cache = "cache" if self.noisy else "info"
        self._order = opaque_uint(tile_order(*size_px))
        texel_of = grid.texel_of_pixels()
        self._texel_of = opaque_uint(texel_of[self._order.numpy()])  # in tile order, as all that is looked at there
        self._scanline = opaque_uint(np.arange(size_px[0] * size_px[1]))
        self._texel_pixel = opaque_uint(grid.texel_pixels())
        x, y, texel = grid.vertices()
        self._vertices = (opaque_float(x), opaque_float(y), opaque_uint(texel))
        self._blocks = BlockMesh(grid)
        self._block = {size: opaque_uint(np.arange(math.prod(blocks_of(grid, size)))) for size in SIZES}
        self._rasteriser = make_rasteriser(params.rasteriser, is_cuda(), size_px, *grid.mesh)
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._kernels = {
            kernel.__name__: frozen(kernel)
            for kernel in (
                self._probabilities, self._move, self._flat, self._look, self._mark, self._select, self._trace,
                self._extract, self._first, self._compose, self._filter,
            )
        }  # fmt: skip
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        self._seed, self._history = seed, False
        self._eyes.close()
        if self._full is not None:
            self._full.reset(seed)
            return
        pixels, texels = self.size_px[0] * self.size_px[1], self.grid.texels
        self._now, self._before = (
            {"shown": opaque_float(np.zeros(pixels * 4)), self._cache: self._no_history(pixels)} for _ in range(2)
        )
        self._samples = {
            name: opaque_float(np.zeros(pixels * 4)) for name in ("color", *(self._names if self.noisy else ()))
        }
        self._alpha = opaque_float(np.zeros(pixels))
        self._support = {name: opaque_float(np.zeros(texels * 4)) for name in (*self._names, "normal")}
        self._support |= {"z": opaque_float(np.zeros(texels)), "mover": opaque_uint(np.zeros(texels))}
        self._marks = opaque_uint(np.zeros(texels))
        self._mesh: Any = None
        self._plane: EyePlane | None = None
        self._probability: Any = None  # scanline order
        self._draw: Any = None  # the same in tile order
        self._sampled: Any = None
        self._composed = False

    def _no_history(self, pixels: int) -> Any:
        """The cache of pixels of which nothing is known."""
        if self.noisy:
            return opaque_uint(np.zeros(pixels * light_cache.WORDS, np.uint32))
        return opaque_float(np.zeros(pixels * 2, np.float32))

    # Kernels --------------------------------------------------------------------------------------------------------

    def _probabilities(self, plane: Any, pixel: Any) -> Any:
        """How likely each of the pixels is traced (Float); `FOVEA` up to r0."""
        width = self.size_px[0]
        y = pixel // width
        e = pixel_eccentricity_deg(plane, mi.Float(pixel - y * width) + 0.5, mi.Float(y) + 0.5)
        r0, r1, p_min = self.params.region
        slope = (1 - p_min) / (r1 - r0) if r0 < r1 < math.inf else 0.0
        inner = 1 - slope * (e - r0)
        return dr.select(e <= r0, FOVEA, dr.select(e >= r1, p_min, inner))

    def _move(self, state: EngineState, x: Any, y: Any, mesh: tuple[Any, ...]) -> tuple[Any, Any]:
        return move(self.engine, state, x, y, *mesh)

    def _flat(self, size: int, vertices: Any, block: Any) -> Any:
        return flat_blocks(self.grid, size, vertices, block)

    def _look(self, *of: Any) -> Any:
        return look(self.grid, *of)

    def _mark(self, looks: Any) -> Any:
        return mark(self.params, self.grid, looks)

    def _select(self, order: Any, probability: Any, texel_of: Any, marks: Any, seed: Any) -> tuple[Any, Any, Any, Any]:
        """Number and texel of the pixels to trace, in tile order; the slot of every pixel, in scanline order, that
        `compose` reads; whether the post filter may change a lane's pixel (marked, outside of the fovea)."""
        marked = dr.gather(mi.UInt32, marks, texel_of & (IS_TEXEL - 1)) > 0
        drawn = mi.Float(combined(seed ^ _DRAW, order) >> 8) * (1 / (1 << 24)) < probability
        lanes = dr.compress(drawn | marked | (texel_of >= IS_TEXEL))
        pixel, texel = dr.gather(mi.UInt32, order, lanes), dr.gather(mi.UInt32, texel_of, lanes)
        fovea = dr.gather(mi.Float, probability, lanes) > 1
        marked = dr.gather(mi.UInt32, marks, texel & (IS_TEXEL - 1)) > 0
        slot = dr.full(mi.UInt32, NO_SAMPLE, self.size_px[0] * self.size_px[1])
        lane = dr.arange(mi.UInt32, dr.width(lanes))
        dr.scatter(slot, dr.select(fovea | marked, lane | OVERWRITES, lane), pixel)
        return pixel, texel, slot, marked & ~fovea

    def _trace(
        self, state: EngineState, pixel: Any, texel: Any, seed: Any, samples: dict[str, Any], support: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any], Any, Any]:
        """A sample a lane, packed; those of the support image are written there too, with the G-buffer.

        Lanes keep the order of full pictures, and rays their coherent mode, although 84 % of the pixels are missing: a
        ray costs 2.1 (primary), 1.5 (shadow) times what it costs there. CPU time of tunnel_geom, point light, 272k
        lanes: 52 ms; no other order (tiles of 4 to 128, Z curve) is more than 3 % faster; shadow rays not coherent 60;
        primary rays not coherent twice their time; rays that end a little behind the reprojected depth, and go on where
        nothing was there, 4 to 15 % more; the support image is free.
        """
        width = self.size_px[0]
        y = pixel // width
        ray = self.engine.camera_ray(state, mi.Float(pixel - y * width) + 0.5, mi.Float(y) + 0.5)
        got = self.engine.sample(state, ray, rng=combined(seed, pixel), light_samples=self.params.light_samples)
        values = {"color": (got.color, dr.minimum(got.z, FARTHEST))}
        if self.noisy:
            for name in self._names:
                value = getattr(got, name)
                values[name] = (dr.select(dr.isnan(value), 0, dr.clip(value, 0, LARGEST)), mi.Float(0))
        lane = dr.arange(mi.UInt32, dr.width(pixel))
        own, texel = texel >= IS_TEXEL, texel & (IS_TEXEL - 1)
        for name, (c, spare) in values.items():
            packet = mi.Vector4f(c.x, c.y, c.z, spare)
            dr.scatter(samples[name], packet, lane)
            if name in self._names or not self.noisy:
                dr.scatter(support["shown" if name == "color" else name], packet, texel, own)
        n = got.normal_geometric
        dr.scatter(support["normal"], mi.Vector4f(n.x, n.y, n.z, 0), texel, own)
        dr.scatter(support["z"], got.z, texel, own)
        dr.scatter(support["mover"], got.mover, texel, own)
        return samples, support, got.rays, got.clamped

    def _extract(self, state: EngineState, x: Any, y: Any, texel: Any, z: Any, normal: Any, mover: Any) -> Any:
        return extract(self.engine, self.params.reproject_movers, state, x, y, texel, z, normal, mover)

    def _first(self, pixel: Any, samples: dict[str, Any], buffers: dict[str, Any]) -> dict[str, Any]:
        return first_samples(pixel, samples, buffers)

    def _compose(
        self, place: Any, depth: Any, slot: Any, samples: Any, old: Any, support: Any, to_world: Any, t_max: Any,
        seed: Any, new: Any, weight: Any,
    ) -> tuple[dict[str, Any], Any]:  # fmt: skip
        taps = seed ^ _TAPS
        return compose(
            self.params, self.grid, self._names, place, depth, slot, samples, old, support, to_world, t_max, taps, new,
            weight,
        )  # fmt: skip

    def _filter(
        self, pixels: Any, chosen: Any, marks: Any, probability: Any, seed: Any, buffers: dict[str, Any]
    ) -> Any:
        pixel = dr.gather(mi.UInt32, pixels, chosen)
        return filter_light(self.params.post_filter, self.grid, marks, probability, pixel, seed ^ _FILTER, buffers)

    # A frame --------------------------------------------------------------------------------------------------------

    def render(self, view: View) -> Frame:
        """This refresh, for the view's gaze; of a view with viewports each of them, with a history of its own."""
        if view.viewports:
            return self._eyes.render(view)
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
            self._now, self._before = self._before, self._now
            if self._history:
                with stage("move"):
                    moved, edge = run["_move"](vertices, state, *self._vertices[:2], self._mesh)
                with stage("raster"):
                    place, depth = self._rasteriser.draw(moved, self._blocks.indices(self._flat_of(moved)))
                with stage("marks"):
                    exposure = opaque_float(view.exposure)
                    looks = run["_look"](
                        texels, place, depth, self._before["shown"], edge, state.to_world, exposure, self._texel_pixel
                    )
                    self._marks = run["_mark"](texels, looks)
            with stage("select"):
                if self._history:
                    pixel, texel, slot, chosen = run["_select"](
                        pixels, self._order, self._draw, self._texel_of, self._marks, seed
                    )
                else:
                    pixel, texel = self._order, self._texel_of
                lanes = dr.width(pixel)
            with stage("trace"):
                self._samples, self._support, rays, clamped = run["_trace"](
                    lanes, state, pixel, texel, seed, self._samples, self._support
                )
            with stage("extract"):
                z, normal, mover = (self._support[name] for name in ("z", "normal", "mover"))
                self._mesh = run["_extract"](vertices, state, *self._vertices, z, normal, mover)
            with stage("compose"):
                if self._history:
                    colors = {name: self._support[name] for name in self._names}
                    carried = (self._cache,) if self.noisy else (self._cache, "shown")
                    old = {name: self._before[name] for name in carried}
                    self._now, self._alpha = run["_compose"](
                        pixels, place, depth, slot, self._samples, old, colors, state.to_world,
                        opaque_float(self.t_max(view)), seed, self._now, self._alpha,
                    )  # fmt: skip
                else:
                    self._now = run["_first"](lanes, pixel, self._samples, self._now)
            if self._history and self.noisy and self.params.post_filter:
                with stage("post filter"):
                    # compressed outside of the recording: Dr.Jit 1.5 aborts where a recorded result has no lanes
                    chosen = dr.compress(chosen)
                    if count := dr.width(chosen):
                        self._now["shown"] = run["_filter"](
                            count, pixel, chosen, self._marks, self._probability, seed, self._now
                        )
        self._sampled, self._composed, self._history = pixel, self._history, True
        return Frame(
            color=self._now["shown"].numpy().reshape(height, width, 4)[..., :3],
            rays=ray_counts(lanes, rays),
            seconds=dict(self._watch.seconds),
            time_s=float(view.index * (view.t1 - view.t0)),
            clamped=int(dr.sum(clamped)[0]),
        )

    def _flat_of(self, vertices: Any) -> dict[int, np.ndarray]:
        """For each size of block which are flat."""
        found = {
            size: self._kernels["_flat"](dr.width(block), size, vertices, block) for size, block in self._block.items()
        }
        return {size: np.zeros(0) if flat is None else flat.numpy() for size, flat in found.items()}

    def t_max(self, view: View) -> int:
        """Frames after which a cached pixel is old: the parameter, or 0.213 s at the view's rate, at least 1."""
        return self.params.t_max or max(1, round(T_MAX_S * view.rate_hz))

    def _see(self, view: View) -> None:
        """Probabilities for the view's gaze, computed anew where it or the geometry changed."""
        plane = eye_plane(self.size_px, view.camera.yfov_rad, view.geometry, view.gaze)
        if plane != self._plane:
            pixels = self.size_px[0] * self.size_px[1]
            self._plane = plane
            values, run = plane_values(plane), self._kernels["_probabilities"]
            self._draw = run(pixels, values, self._order)
            self._probability = run(pixels, values, self._scanline)

    def show(self, view: View) -> dict[str, np.ndarray]:
        """Debug pictures of the last frame, (H, W) each: ``sampled``, ``marks`` (0 or 1), ``probability``, ``alpha``
        (weight of this frame's samples; 0: none), and of the cache ``samples`` (rho; 0: from the support image) and
        ``age`` (frames)."""
        if view.viewports:
            return self._eyes.show(view)
        width, height = self.size_px
        if self._full is not None:
            one = np.ones((height, width), np.float32)
            return {"sampled": one, "marks": 0 * one, "probability": one, "alpha": one, "samples": one, "age": 0 * one}
        sampled = np.zeros(width * height, np.float32)
        pixel = self._sampled.numpy()
        sampled[pixel] = 1
        alpha = np.zeros(width * height, np.float32)
        alpha[pixel] = self._alpha.numpy()[: len(pixel)] if self._composed else 1
        texel = self.grid.texel_of_pixels() & (IS_TEXEL - 1)
        info = self._now[self._cache].numpy().reshape(height, width, -1)
        if self.noisy:
            info = info[..., light_cache.RHO : light_cache.AGE + 1].copy().view(np.float32)
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
        """Free the OpenGL contexts."""
        self._eyes.close()
        if self._full is None:
            self._rasteriser.close()
