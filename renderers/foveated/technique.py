"""Foveated ray tracing with reprojection (Weier et al., Pacific Graphics 2016).

A frame: the last support grid is moved and rasterised (where was each pixel?), what reprojects badly is marked, the
pixels of the fovea, of the support image, the marked and the randomly drawn ones are traced, the last picture is
filtered into the new one (holes come from the support image), samples are merged into it. Frame 0 and cuts trace all.

The paper's scenes are static. Here the mesh moves with rigid movers and is marked between bodies, so that they leave no
trail; their shadows, reflections, and meshes that change their shape are, outside of the fovea, as old as the samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from renderers.backend import dr, is_cuda, mi
from renderers.eccentricity import EyePlane, eye_plane
from renderers.engine import LARGEST, Engine, EngineState
from renderers.eye_angles import pixel_eccentricity_deg, plane_values
from renderers.foveated.compose import NO_SAMPLE, OVERWRITES, Picture, Samples, cacheable, compose, first_picture
from renderers.foveated.eyes import Eyes
from renderers.foveated.mesh_blocks import SIZES, BlockMesh, blocks_of, flat_blocks
from renderers.foveated.post_filter import filter_light
from renderers.foveated.reprojection import look, mark
from renderers.foveated.span_rasteriser import make_rasteriser
from renderers.foveated.support import IS_TEXEL, SupportGrid, extract, move
from renderers.foveated.words import Layout, float_pair, packed
from renderers.frozen import frozen, opaque_float, opaque_uint
from renderers.parameters import Foveated as FoveatedParameters
from renderers.parameters import Vanilla as VanillaParameters
from renderers.pixels import hilbert_order, inverse_order
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
        grey = engine.lighting == "ambient_occlusion"
        self._layout: Layout = ("grey" if grey else "light") if self.noisy else "shown"
        order = hilbert_order(*size_px)
        self._order = opaque_uint(order)
        texel_of = grid.texel_of_pixels()
        self._texel_of = opaque_uint(texel_of[order])  # in the curve's order, as all that is looked at there
        self._scanline = opaque_uint(np.arange(size_px[0] * size_px[1]))
        # where nothing is left out: the lane of each pixel, and of each texel's
        lane_of = inverse_order(order)
        self._all_lanes = opaque_uint(lane_of)
        self._all_texel_lanes = opaque_uint(lane_of[grid.texel_pixels()])
        self._texel_pixel = opaque_uint(grid.texel_pixels())
        self._no_marks = opaque_uint(np.zeros(grid.texels))
        x, y, texel = grid.vertices()
        self._vertices = (opaque_float(x), opaque_float(y), opaque_uint(texel))
        self._blocks = BlockMesh(grid)
        self._block = {size: opaque_uint(np.arange(math.prod(blocks_of(grid, size)))) for size in SIZES}
        k = (params.k_min, params.k_max)
        self._own_light = self.noisy and (params.light_k_min, params.light_k_max) != k
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._rasteriser = make_rasteriser(params.rasteriser, is_cuda(), size_px, *grid.mesh, self._watch.stage)
        self._kernels: dict[str, Callable[..., Any]] = {
            kernel.__name__: frozen(kernel)
            for kernel in (
                self._probabilities, self._move, self._flat, self._look, self._mark, self._select, self._trace,
                self._extract, self._first, self._compose, self._filter,
            )
        }  # fmt: skip
        if grid.texels == 1:
            self._kernels["_select"] = self._select_at_once
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        self._seed = seed
        self._eyes.close()
        if self._full is not None:
            self._full.reset(seed)
            return
        self._picture: Picture | None = None
        self._marks = self._no_marks
        self._mesh: Any = None
        self._plane: EyePlane | None = None
        self._probability: Any = None  # scanline order
        self._draw: Any = None  # the same in the curve's order
        self._sampled: Any = None

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
        """Number of the pixels to trace, in the curve's order; the slot of every pixel, in scanline order, that
        `compose` reads; the lane of every texel; whether the post filter may change a lane's pixel (marked, not in the
        fovea)."""
        marked = dr.gather(mi.UInt32, marks, texel_of & (IS_TEXEL - 1)) > 0
        drawn = mi.Float(combined(seed ^ _DRAW, order) >> 8) * (1 / (1 << 24)) < probability
        lanes = dr.compress(drawn | marked | (texel_of >= IS_TEXEL))
        pixel, texel = dr.gather(mi.UInt32, order, lanes), dr.gather(mi.UInt32, texel_of, lanes)
        fovea = dr.gather(mi.Float, probability, lanes) > 1
        marked = dr.gather(mi.UInt32, marks, texel & (IS_TEXEL - 1)) > 0
        slot = dr.full(mi.UInt32, NO_SAMPLE, self.size_px[0] * self.size_px[1])
        lane = dr.arange(mi.UInt32, dr.width(lanes))
        alone = dr.ReduceMode.NoConflicts
        dr.scatter(slot, dr.select(fovea | marked, lane | OVERWRITES, lane), pixel, mode=alone)
        texel_lanes = dr.empty(mi.UInt32, self.grid.texels)
        dr.scatter(texel_lanes, lane, texel & (IS_TEXEL - 1), texel >= IS_TEXEL, mode=alone)
        return pixel, slot, texel_lanes, marked & ~fovea

    def _select_at_once(self, _: int, *of: Any) -> Any:
        """`_select` without a recording, where a frame may trace one pixel alone: what Dr.Jit 1.5 records of a single
        lane it replays for any number of them, with wrong numbers or a crash."""
        found = self._select(*of)
        dr.eval(found)
        return found

    def _trace(self, state: EngineState, pixel: Any, white: Any, seed: Any) -> tuple[Samples, Any, Any]:
        """A sample a lane.

        Rays keep the coherent mode of full pictures, although 84 % of the pixels are missing: a ray costs 2.1
        (primary), 1.5 (shadow) times what it costs there. CPU time of tunnel_geom, point light, 272k lanes along a Z
        curve: 52 ms; tiles of 4 to 128 no more than 3 % less, a Hilbert curve 7 %; shadow rays not coherent 60; primary
        rays not coherent twice their time; rays that end a little behind the reprojected depth, and go on where nothing
        was there, 4 to 15 % more; the support image is free. 85 % of it are Embree's.
        """
        width = self.size_px[0]
        y = pixel // width
        ray = self.engine.camera_ray(state, mi.Float(pixel - y * width) + 0.5, mi.Float(y) + 0.5)
        got = self.engine.sample(state, ray, rng=combined(seed, pixel), light_samples=self.params.light_samples)
        color = (float_pair(got.color.x, got.color.y), float_pair(got.color.z, dr.minimum(got.z, FARTHEST)))
        values = {"shown": got.color}
        if self.noisy:
            for name in ("surface", "albedo", "light"):
                value = getattr(got, name)
                values[name] = dr.select(dr.isnan(value), 0, dr.clip(value, 0, LARGEST))
        normal = mi.Vector3f(got.normal_geometric)
        words = packed(self._layout, cacheable(values, white))
        samples = Samples(color, words, got.z, tuple(normal), got.mover)
        return samples, got.rays, got.clamped

    def _extract(
        self, state: EngineState, x: Any, y: Any, texel: Any, texel_lanes: Any, z: Any, normal: Any, mover: Any
    ) -> Any:
        lane = dr.gather(mi.UInt32, texel_lanes, texel)
        return extract(self.engine, self.params.reproject_movers, state, x, y, lane, z, normal, mover)

    def _first(self, lane: Any, samples: Samples, white: Any) -> Picture:
        return first_picture(self._layout, self.grid, lane, samples, white, self._own_light)

    def _compose(
        self, place: Any, depth: Any, slot: Any, samples: Samples, texel_lanes: Any, old: Picture, to_world: Any,
        t_max: Any, white: Any, seed: Any,
    ) -> Picture:  # fmt: skip
        return compose(
            self.params, self.grid, self._layout, place, depth, slot, samples, texel_lanes, old, to_world, t_max, white,
            seed ^ _TAPS,
        )  # fmt: skip

    def _filter(self, pixels: Any, chosen: Any, marks: Any, seed: Any, picture: Picture) -> tuple[Any, Any, Any]:
        pixel = dr.gather(mi.UInt32, pixels, chosen)
        taps, own = self.params.post_filter, seed ^ _FILTER
        return pixel, *filter_light(taps, self.grid, self._layout, marks, pixel, own, picture)

    # A frame --------------------------------------------------------------------------------------------------------

    def render(self, view: View) -> Frame:
        """This refresh, for the view's gaze; of a view with viewports each of them, with a history of its own."""
        if view.viewports:
            return self._eyes.render(view)
        if self._full is not None:
            return self._full.render(view)
        if view.cut:
            self._picture, self._marks = None, self._no_marks
        stage, run = self._watch.stage, self._kernels
        width, height = self.size_px
        pixels, texels, vertices = width * height, self.grid.texels, self.grid.mesh[0] * self.grid.mesh[1]
        with self._watch.frame():
            with stage("state"):
                state = self.engine.state(view, self.size_px)
                exposure, white = opaque_float(view.exposure), opaque_float(1 / view.exposure)
                seed = frame_seed(self._seed, view.index)
                self._see(view)
            old = self._picture
            if old is not None:
                with stage("move"):
                    moved, edge = run["_move"](vertices, state, *self._vertices[:2], self._mesh)
                with stage("raster"):
                    triangles = self._blocks.indices(self._flat_of(moved))
                place, depth = self._rasteriser.draw(moved, triangles)
                with stage("marks"):
                    mover = self._mesh[3] if self.engine.tracer.bodies and self.params.reproject_movers else None
                    looks = run["_look"](
                        texels, place, depth, old.shown, edge, mover, state.to_world, exposure, self._texel_pixel
                    )
                    self._marks = run["_mark"](texels, looks)
            with stage("select"):
                if old is not None:
                    pixel, slot, texel_lanes, chosen = run["_select"](
                        pixels, self._order, self._draw, self._texel_of, self._marks, seed
                    )
                else:
                    pixel, slot, texel_lanes = self._order, self._all_lanes, self._all_texel_lanes
                lanes = dr.width(pixel)
            with stage("trace"):
                samples, rays, clamped = run["_trace"](lanes, state, pixel, white, seed)
            with stage("extract"):
                self._mesh = run["_extract"](
                    vertices, state, *self._vertices, texel_lanes, samples.z, samples.normal, samples.mover
                )
            with stage("compose"):
                if old is not None:
                    new = run["_compose"](
                        pixels, place, depth, slot, samples, texel_lanes, old, state.to_world,
                        opaque_float(self.t_max(view)), white, seed,
                    )  # fmt: skip
                else:
                    new = run["_first"](pixels, slot, samples, white)
            if old is not None and self.noisy and self.params.post_filter:
                with stage("post filter"):
                    # compressed outside of the recording: Dr.Jit 1.5 aborts where a recorded result has no lanes
                    chosen = dr.compress(chosen)
                    if count := dr.width(chosen):
                        where, colors, found = run["_filter"](count, pixel, chosen, self._marks, seed, new)
                        # outside as well: a recording would copy the picture before it writes into it
                        dr.scatter(new.shown, colors, where, found, mode=dr.ReduceMode.NoConflicts)
                        dr.eval(new.shown)
        self._sampled, self._picture = pixel, new
        return Frame(
            color=new.shown.numpy().reshape(height, width, 4)[..., :3],
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
        assert self._picture is not None
        sampled = np.zeros(width * height, np.float32)
        sampled[self._sampled.numpy()] = 1
        texel = self.grid.texel_of_pixels() & (IS_TEXEL - 1)
        rho, age = self._picture.info.numpy().view(np.float32).reshape(-1, 2).T
        shape = (height, width)
        return {
            "sampled": sampled.reshape(shape),
            "marks": self._marks.numpy()[texel].astype(np.float32).reshape(shape),
            "probability": np.minimum(self._probability.numpy(), 1).reshape(shape),
            "alpha": self._picture.alpha.numpy().reshape(shape),
            "samples": rho.reshape(shape).copy(),
            "age": np.abs(age).reshape(shape),
        }

    def close(self) -> None:
        """Free the OpenGL contexts."""
        self._eyes.close()
        if self._full is None:
            self._rasteriser.close()
