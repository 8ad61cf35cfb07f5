"""The Human Eye Resolution Ray Tracer (Peuhkurinen and Mikkonen, GRAPP 2021): rays in a polar buffer around the gaze.

Each eye has one buffer; every panel of that eye (the picture, or a headset's inset and surround) is resolved from it.
Only texels that some pixel reads are traced. Area lights are sampled on an even grid, without noise and without any
filter over time. Departure from the paper: the resolved pictures are returned, not warped by a headset's compositor.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from renderers.backend import dr, mi
from renderers.camera import Ray
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen, opaque_float
from renderers.parameters import Polar as PolarParameters
from renderers.polar.panels import MAIN, Eye, Panel, eyes_of
from renderers.polar.polar_map import RadialMap, buffer_size, farthest_deg, width_in_use
from renderers.polar.quality import light_samples, pose_delta
from renderers.polar.resolve import (
    PanelState,
    PolarState,
    in_use,
    look_up,
    panel_state,
    pixel_direction,
    polar_state,
    resolve,
    texel_direction,
)
from renderers.polar.shadow_catcher import ShadowCatcher, composited
from renderers.poses import pose_at
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, LazyCounts, Measure, View
from stimuli.errors import InputError, problem

_PLANS, _PLANNED_PIXELS = 8, 1 << 24  # gazes and widths whose look-ups are remembered, and the pixels of all of them
_PICTURES = 8  # panels whose memory is kept
RING_DEG = 15.0


@dataclass
class _Plan:
    """What follows from gaze, panels and width alone: one eye's buffer, where its pixels read it, the texels in use."""

    polar: PolarState
    panels: list[PanelState]
    places: list[Any]
    size: tuple[int, int]
    texels: Any
    eye: Any


class Polar:
    """One buffer an eye; `show` gives debug pictures (rings every 15 degrees, HERR's Fig. 6)."""

    name: ClassVar[str] = "polar"
    Params: ClassVar[type[PolarParameters]] = PolarParameters

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: PolarParameters, seed: int, measure: Measure
    ) -> None:
        if min(size_px) < 1:
            raise InputError(problem("size_px", "picture size", f"{size_px[0]}x{size_px[1]}", "at least 1x1"))
        self.engine = engine.with_probes(params.probe_settings, seed) if params.probes else engine
        self.size_px, self.params = size_px, params
        own_probes = None if self.engine.indirect is None else self.engine.indirect.settings
        self._catcher = ShadowCatcher(self.engine, own_probes, seed) if params.mixed_reality else None
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._trace_kernel, self._mark_kernel, self._use_kernel = frozen(self._trace), frozen(look_up), frozen(in_use)
        self._resolve_kernel, self._tile_kernel = frozen(resolve), frozen(self._tiles)
        self._capture_kernel = frozen(self._capture)
        self._plans: OrderedDict[tuple, _Plan] = OrderedDict()
        self._arange: dict[int, Any] = {}
        self._pictures: dict[tuple[str, tuple[int, int]], Any] = {}
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        grids = [e.indirect for e in self._engines if e.indirect is not None]
        for grid in grids:
            grid.seed = seed
            grid.reset()

    @property
    def _engines(self) -> tuple[Engine, ...]:
        return (self.engine,) if self._catcher is None else (self.engine, self._catcher.engine)

    # Plans ----------------------------------------------------------------------------------------------------------

    def _size_in_use(self, view: View, eye: Eye) -> tuple[RadialMap, tuple[int, int]]:
        """The radial map to the farthest corner, and the buffer's (W in use, H)."""
        p = self.params
        gaze = np.asarray(eye.panels[0].plane.gaze)
        most = max(farthest_deg(panel.plane, panel.size_px, gaze) for panel in eye.panels)
        radial = RadialMap(p.mapping, max(most, 1e-3), p.mar_slope, p.mar_foveal_deg)
        ppd, pixels = max(panel.ppd for panel in eye.panels), sum(map(_pixels, eye.panels))
        width, height = buffer_size(ppd, radial.most_deg, p.width, p.height, pixels)
        if p.dynamic_width:
            turning = pose_delta(view, self.engine.space.radius).turning_deg_s
            width = width_in_use(width, turning, p.width_slope_s_per_deg, p.least_width)
        return radial, (width, height)

    def _plan(self, view: View, eye: Eye) -> _Plan:
        radial, size = self._size_in_use(view, eye)
        key = (eye, radial, size)
        if key in self._plans:
            self._plans.move_to_end(key)
            return self._plans[key]
        polar = polar_state(radial, size, eye.panels[0].plane.gaze)
        panels = [panel_state(panel) for panel in eye.panels]
        marks = dr.zeros(mi.UInt32, size[0] * size[1])
        dr.make_opaque(marks)
        places = []
        for panel, state in zip(eye.panels, panels, strict=True):
            found = dr.zeros(mi.UInt32, 2 * _pixels(panel))
            dr.make_opaque(found)
            marks, found = self._mark_kernel(_pixels(panel), polar, state, self._numbers(_pixels(panel)), marks, found)
            places.append(found)
        lanes = size[0] * -(-size[1] // 4) * 4
        texel, used = self._use_kernel(lanes, polar, self._numbers(lanes), marks)
        texels = dr.gather(mi.UInt32, texel, dr.compress(used))
        dr.make_opaque(texels)
        plan = _Plan(polar, panels, places, size, texels, opaque_float([eye.offset_m, _least_angle(eye)]))
        self._plans[key] = plan
        most = max(1, min(_PLANS, _PLANNED_PIXELS // max(1, sum(map(_pixels, eye.panels)))))
        while len(self._plans) > most:
            self._plans.popitem(last=False)
        return plan

    def _numbers(self, count: int) -> Any:
        """0, 1, ... ``count`` - 1 on the device, kept for the counts that were asked for last."""
        if count not in self._arange:
            if len(self._arange) >= _PLANS:
                self._arange.pop(next(iter(self._arange)))
            numbers = dr.arange(mi.UInt32, count)
            dr.make_opaque(numbers)
            self._arange[count] = numbers
        return self._arange[count]

    # Kernels --------------------------------------------------------------------------------------------------------

    def _trace(
        self, samples: int, state: EngineState, room: EngineState | None, captured: Any, polar: PolarState,
        panel: PanelState, eye: Any, texel: Any, buffer: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        """Trace and shade the texels in use."""
        d, solid_angle = texel_direction(polar, texel)
        sample = self.engine.sample(state, _ray(state, panel, eye, d, solid_angle), light_samples=samples)
        c = sample.color
        value = mi.Vector4f(c.x, c.y, c.z, 1)
        if self._catcher is not None and room is not None:
            value = self._catcher.covered(sample, room, _ray(room, panel, eye, d, solid_angle), captured, samples)
        dr.scatter(buffer, value, texel)
        return buffer, sample.rays, sample.clamped

    def _capture(self, room: EngineState, panel: PanelState, eye: Any, pixel: Any, picture: Any) -> Any:
        """The camera's picture of the room in one panel (not the technique's work: a headset's camera delivers it)."""
        y = pixel // panel.width
        d = pixel_direction(panel, mi.Float(pixel - y * panel.width) + 0.5, mi.Float(y) + 0.5)
        assert self._catcher is not None
        c = self._catcher.camera_picture(room, _ray(room, panel, eye, d, mi.Float(0)))
        dr.scatter(picture, mi.Vector4f(c.x, c.y, c.z, 1), pixel)
        return picture

    def _tiles(self, polar: PolarState, texel: Any, buffer: Any) -> Any:
        """Colours of 15 degree tiles of eccentricity and angle, and the eccentricity (degrees) as fourth channel."""
        row = texel // polar.width
        column = texel - row * polar.width
        theta = dr.gather(mi.Float, polar.centres, column + 1) * (180 / math.pi)
        ring = mi.UInt32(theta * (1 / RING_DEG))
        sector = mi.UInt32((mi.Float(row) + 0.5) / mi.Float(polar.height) * (360 / RING_DEG))
        light = dr.select((ring + sector) % 2 == 0, 0.9, 0.45)
        color = mi.Color3f(*(0.35 + 0.65 * mi.Float((ring + k) % 3 == 0) for k in range(3))) * light
        dr.scatter(buffer, mi.Vector4f(color.x, color.y, color.z, theta), texel)
        return buffer

    # Frames ---------------------------------------------------------------------------------------------------------

    def _resolved(self, plan: _Plan, eye: Eye, buffer: Any) -> dict[str, Any]:
        """Flat H * W * 4 of every panel, in memory that the next frame takes again."""
        found = {}
        for panel, places in zip(eye.panels, plan.places, strict=True):
            key, n = (panel.name, panel.size_px), _pixels(panel)
            picture = self._pictures.pop(key) if key in self._pictures else _zeros(4 * n)
            found[panel.name] = self._pictures[key] = self._resolve_kernel(
                n, plan.polar, places, self._numbers(n), buffer, picture
            )
        while len(self._pictures) > _PICTURES:
            self._pictures.pop(next(iter(self._pictures)))
        return found

    def render(self, view: View) -> Frame:
        """The pictures at t1."""
        counts: list[Mapping[str, Any]] = []
        wrong: list[Any] = []
        primary = 0
        pictures: dict[str, Any] = {}
        cameras: dict[str, Any] = {}
        eyes = eyes_of(view, self.size_px)
        samples = light_samples(self.params, pose_delta(view, self.engine.space.radius))
        with self._watch.frame():
            with self._watch.stage("state"):
                state, *rest = (engine.state(view, self.size_px) for engine in self._engines)
                room = rest[0] if rest else None
                counts += [e.indirect.rays for e in self._engines if e.indirect is not None]
            captured = None if self._catcher is None else self._catcher.captured
            for eye in eyes:
                with self._watch.stage("plan"):
                    plan = self._plan(view, eye)
                with self._watch.stage("trace"):
                    lanes = len(plan.texels)
                    buffer = _zeros(plan.size[0] * plan.size[1] * 4)
                    buffer, rays, clamped = self._trace_kernel(
                        lanes, samples, state, room, captured, plan.polar, plan.panels[0], plan.eye, plan.texels, buffer
                    )
                    counts.append(rays)
                    primary += lanes
                    wrong.append(clamped)  # summed after the frame: the device need not wait for the host in between
                with self._watch.stage("resolve"):
                    pictures |= self._resolved(plan, eye, buffer)
                if room is not None:
                    with self._watch.stage("capture"):
                        for panel, where in zip(eye.panels, plan.panels, strict=True):
                            n = _pixels(panel)
                            cameras[panel.name] = self._capture_kernel(
                                n, room, where, plan.eye, self._numbers(n), _zeros(n * 4)
                            )
        panels = [panel for eye in eyes for panel in eye.panels]
        over = {p.name: _picture(pictures[p.name], p) for p in panels}
        color, channels, alpha = {name: a[..., :3] for name, a in over.items()}, {}, None
        if self._catcher is not None:
            color = {p.name: composited(over[p.name], _picture(cameras[p.name], p)[..., :3]) for p in panels}
            channels = {f"{name}.alpha": a[..., 3] for name, a in over.items() if name != MAIN}
            alpha = over[panels[0].name][..., 3]
        return Frame(
            color=color[panels[0].name],
            rays=_counts(primary, counts),
            seconds=dict(self._watch.seconds),
            time_s=float(view.index * (view.t1 - view.t0)),
            clamped=sum(int(dr.sum(clamped)[0]) for clamped in wrong),
            alpha=alpha,
            channels=channels,
            viewports={name: a for name, a in color.items() if name != MAIN},
        )

    def show(self, view: View) -> dict[str, np.ndarray]:
        """Debug pictures of ``view`` for each panel: NAME (H, W, 3): 15 degree tiles of the buffer as they come out
        (HERR, Fig. 6), NAME.eccentricity (H, W): degrees, resolved from the buffer."""
        found = {}
        for eye in eyes_of(view, self.size_px):
            plan = self._plan(view, eye)
            empty = _zeros(plan.size[0] * plan.size[1] * 4)
            buffer = self._tile_kernel(len(plan.texels), plan.polar, plan.texels, empty)
            pictures = self._resolved(plan, eye, buffer)
            for panel in eye.panels:
                picture = _picture(pictures[panel.name], panel)
                found[panel.name], found[f"{panel.name}.eccentricity"] = picture[..., :3], picture[..., 3]
        return found


def _pixels(panel: Panel) -> int:
    return panel.size_px[0] * panel.size_px[1]


def _zeros(size: int) -> Any:
    zeros = dr.zeros(mi.Float, size)
    dr.make_opaque(zeros)
    return zeros


def _picture(values: Any, panel: Panel) -> np.ndarray:
    """(H, W, 4) of a panel's flat picture."""
    return values.numpy().reshape(panel.size_px[1], panel.size_px[0], 4)


def _least_angle(eye: Eye) -> float:
    """The smallest angle of a pixel of the eye's panels, radians."""
    return min(math.radians(1) / panel.ppd for panel in eye.panels)


def _ray(state: EngineState, panel: PanelState, eye: Any, d: Any, solid_angle: Any) -> Ray:
    """The camera ray of an eye direction at t1; its cone is as wide as the texel, but not narrower than a pixel."""
    sx, sy, ox, oy = (dr.gather(mi.Float, panel.lens, mi.UInt32(k)) for k in range(4))
    seen = mi.Vector3f(sx * d.x - ox * d.z, sy * d.y - oy * d.z, d.z)
    length = dr.norm(seen)
    pose = pose_at(state.camera.poses, mi.UInt32(0), 0.0)
    offset = dr.gather(mi.Float, eye, mi.UInt32(0)) * dr.rcp(state.to_world)
    pixel = dr.gather(mi.Float, eye, mi.UInt32(1))
    origin = mi.Point3f(*(dr.fma(row.x, offset, row.w) for row in pose.rows))
    cosine = dr.maximum(-seen.z / length, 0.05)
    spread = dr.sqrt(solid_angle * sx * sy * dr.rcp(length * length * length))
    spread = dr.maximum(spread, pixel * dr.sqrt(sx * sy) * cosine * cosine)
    return Ray(origin, dr.normalize(pose.vector(seen)), mi.Float(0), spread)


def _counts(primary: int, counts: list[Mapping[str, Any]]) -> LazyCounts:
    """Rays of all eyes and of the probes by kind, summed when they are read."""
    kinds = ("shadow", "ambient_occlusion", "reflection", "transmission", "probe")

    def number(value: Any) -> int:
        return int(value) if isinstance(value, int) else int(np.asarray(value.numpy(), np.int64).sum())

    def total(kind: str) -> Any:
        return lambda: sum(number(rays[kind]) for rays in counts if rays.get(kind) is not None)

    return LazyCounts({"primary": primary, **{kind: total(kind) for kind in kinds}})
