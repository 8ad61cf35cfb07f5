"""A grid of light probes: diffuse light that bounces, one bounce an update (Majercik et al., JCGT 8(2), 2019).

HERR (2.3, 4.1) has 16 x 8 x 16 of them, even distances apart over the whole scene. Each probe holds irradiance and
distance as octahedral maps; `ProbeGrid.light` is what `Engine` adds to every surface under lighting 'probes'. Probes
stand half a spacing inside the scene's box, so none lies on the walls of a room. Rays of probes end at mirrors and
take no highlights along. Departures from the GPU's version: float32 maps, so no least step while darkening; distances
of back faces count (a probe inside a wall then sees nothing), and such probes give no light.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from renderers.backend import dr, mi
from renderers.camera import Ray
from renderers.frozen import frozen, opaque_float, opaque_uint
from renderers.parameters import Probes
from renderers.polar.octahedral import border_sources
from renderers.polar.probe_maps import (
    DISTANCE,
    IRRADIANCE,
    ProbeArrays,
    blend_distance,
    blend_irradiance,
    copy_borders,
    irradiance_at,
    probe_position,
)
from renderers.rng import combined
from renderers.shading import ambient_occlusion
from renderers.space import TracerSpace, corners, mover_bounds, part_points
from renderers.surface import Surface
from renderers.technique import View
from stimuli.errors import InputError, problem
from stimuli.scene import Scene

if TYPE_CHECKING:
    from renderers.engine import Engine, EngineState

_LEAST_EXTENT = 0.1  # of the scene's radius: a flat scene still gets a grid


def scene_box(scene: Scene, space: TracerSpace) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corner (3,) of the scene over its animation, tracer space; no side below a tenth of the radius."""
    points = [part_points(part, scene.name) for part in scene.static if len(part.positions)]
    times_s = np.linspace(0.0, max(scene.duration_s, 0.0), 9)
    for mover in scene.movers:
        box = mover_bounds(mover, scene.name)
        if box is not None:
            poses = mover.track.pose(times_s)
            points.append((corners(*box) @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]).reshape(-1, 3))
    if not points:
        return -np.ones(3), np.ones(3)
    world = np.concatenate(points)
    low, high = space.points(world.min(axis=0)), space.points(world.max(axis=0))
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, _LEAST_EXTENT * space.radius * space.scale / 2)
    return middle - half, middle + half


def fibonacci(count: int) -> np.ndarray:
    """(N, 3) unit vectors spread evenly: the spherical Fibonacci set."""
    i = np.arange(count)
    z = 1 - (2 * i + 1) / count
    phi = 2 * np.pi * np.mod(i * (math.sqrt(5) - 1) / 2, 1)
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(phi), across * np.sin(phi), z], axis=1)


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """(3, 3) rotation, uniform (a unit quaternion of four normals)."""
    w, x, y, z = (lambda q: q / np.linalg.norm(q))(rng.normal(size=4))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


class ProbeGrid:
    """The probes of one engine. ``advance`` once a view; the newest `ProbeArrays` go into the engine's state.

    Raises InputError for a grid with a side below 1 or above 64.
    """

    def __init__(self, engine: Engine, settings: Probes | None = None, seed: int = 0) -> None:
        settings = Probes() if settings is None else settings  # type: ignore[call-arg]
        if min(settings.grid) < 1 or max(settings.grid) > 64:
            raise InputError(problem("probes: grid", "probes along an axis", settings.grid, "1 to 64"))
        self.engine, self.settings, self.seed = engine, settings, seed
        self.count = math.prod(settings.grid)
        low, high = scene_box(engine.scene, engine.space)
        self._spacing = (high - low) / settings.grid
        self._low = low + self._spacing / 2
        sided = [bool(material.pbr.doubleSided) for material in engine.tracer.materials] or [False]
        self._two_sided = opaque_uint(sided)
        self._borders = [tuple(opaque_uint(v) for v in border_sources(n)) for n in (IRRADIANCE, DISTANCE)]
        self._trace_kernel = frozen(self._trace)
        self._irradiance_kernel, self._distance_kernel = frozen(self._blend_irradiance), frozen(self._blend_distance)
        self._border_kernel = frozen(copy_borders)
        self.reset()

    @property
    def positions(self) -> np.ndarray:
        """(P, 3) world positions, x fastest, then y, then z."""
        nx, ny, nz = self.settings.grid
        z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
        index = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        return self.engine.space.world_points(self._low + index * self._spacing)

    def reset(self) -> None:
        """All probes dark, as if nothing had been seen."""
        settings, space = self.settings, self.engine.space
        self.arrays = ProbeArrays(
            irradiance=dr.zeros(mi.Float, self.count * (IRRADIANCE + 2) ** 2 * 4),
            distance=dr.zeros(mi.Float, self.count * (DISTANCE + 2) ** 2 * 2),
            valid=dr.zeros(mi.Float, self.count),
            low=opaque_float(self._low),
            spacing=opaque_float(self._spacing),
            reach=opaque_float(1.5 * float(np.linalg.norm(self._spacing))),
            radius=opaque_float(settings.occlusion_radius * space.scale),
        )
        dr.make_opaque(self.arrays.irradiance, self.arrays.distance, self.arrays.valid)
        self._updates = 0
        self._shown: object = None
        self._settled = False
        self.rays: dict[str, Any] = {"probe": 0, "shadow": None}

    # On the host ----------------------------------------------------------------------------------------------------

    def advance(self, state: EngineState, view: View) -> ProbeArrays:
        """Update for ``view``: a share of the probes; all of them several times at the start and after a cut.

        A view of the same t1 as the one before changes nothing (``rays`` then says 0).
        """
        begins = self._shown is None or (view.cut and not (self._settled and self._shown == view.t1))
        self.rays = {"probe": 0, "shadow": None}
        if begins:
            self.reset()
            passes = self.settings.settle_passes
            for k in range(passes):  # bounces first, then the mean of several passes
                self.update(state, 0, 1, hysteresis=0.0 if 2 * k < passes else 0.5)
            if not passes:
                self.update(state, 0, 1)
        elif self._shown != view.t1:
            every = min(self.settings.every_frames, self.count)
            self.update(state, self._updates % every, every)
        self._settled = begins or (self._settled and self._shown == view.t1)
        self._shown = view.t1
        return self.arrays

    def update(self, state: EngineState, first: int, every: int, hysteresis: float | None = None) -> None:
        """One bounce more for the probes ``first``, ``first + every``, ..."""
        n, arrays = self.settings.rays, self.arrays
        chosen = len(range(first, self.count, every))
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, self._updates]))
        directions = np.zeros((n, 4))
        directions[:, :3] = fibonacci(n) @ random_rotation(rng).T
        rays, seed = opaque_float(directions), opaque_uint(int(rng.integers(1 << 32)))
        kept = opaque_float(self.settings.hysteresis if hysteresis is None else hysteresis)
        start, step = opaque_uint(first), opaque_uint(every)
        state.indirect = arrays
        found = dr.zeros(mi.Float, chosen * n * 4)
        dr.make_opaque(found)
        slots = opaque_uint(np.arange(chosen * n))
        found, shadow = self._trace_kernel(chosen * n, state, self._two_sided, slots, start, step, rays, seed, found)
        slots = opaque_uint(np.arange(chosen * IRRADIANCE**2))
        arrays.irradiance, arrays.valid = self._irradiance_kernel(
            chosen * IRRADIANCE**2, slots, start, step, rays, kept, found, arrays.irradiance, arrays.valid
        )
        slots = opaque_uint(np.arange(chosen * DISTANCE**2))
        arrays.distance = self._distance_kernel(
            chosen * DISTANCE**2, slots, start, step, rays, kept, found, arrays.reach, arrays.distance
        )
        for (border, source), size, kind in zip(self._borders, (IRRADIANCE, DISTANCE), (4, 2), strict=True):
            lanes = chosen * (4 * size + 4)
            maps = arrays.irradiance if kind == 4 else arrays.distance
            maps = self._border_kernel(
                lanes, kind, size, opaque_uint(np.arange(lanes)), start, step, border, source, maps
            )
            if kind == 4:
                arrays.irradiance = maps
            else:
                arrays.distance = maps
        self._updates += 1
        self.rays["probe"] += chosen * n
        traced = dr.sum(shadow)
        self.rays["shadow"] = traced if self.rays["shadow"] is None else self.rays["shadow"] + traced

    # Kernels --------------------------------------------------------------------------------------------------------

    def _trace(
        self, state: EngineState, two_sided: Any, slot: Any, start: Any, step: Any, rays: Any, seed: Any, found: Any
    ) -> tuple[Any, Any]:  # fmt: skip
        """Radiance and distance (negative: a back face) along every ray of the chosen probes."""
        n = self.settings.rays
        probe = slot // n
        d4 = dr.gather(mi.Vector4f, rays, slot - probe * n)
        number = start + probe * step
        nx, ny, _ = self.settings.grid
        z = number // (nx * ny)
        y = (number - z * (nx * ny)) // nx
        origin = probe_position(state.indirect, number - z * (nx * ny) - y * nx, y, z)
        d = mi.Vector3f(d4.x, d4.y, d4.z)
        # A ray's cone covers its share of the sphere.
        ray = Ray(origin, d, mi.Float(0), mi.Float(math.sqrt(4 * math.pi / n)))
        seen = self.engine.first_hit(state, ray, rng=combined(seed, slot))
        back = seen.back & (dr.gather(mi.UInt32, two_sided, seen.surface.material, seen.back) == 0)
        color = dr.select(seen.hit, seen.color, state.background)
        color = dr.select(back | dr.any(dr.isnan(color)), 0, dr.clip(color, 0, 65504.0))
        distance = dr.minimum(dr.select(seen.hit, seen.t, dr.inf), state.indirect.reach)
        dr.scatter(found, mi.Vector4f(color.x, color.y, color.z, dr.select(back, -distance, distance)), slot)
        return found, seen.shadow

    def _blend_irradiance(self, *of: Any) -> tuple[Any, Any]:
        return blend_irradiance(self.settings, *of)

    def _blend_distance(self, *of: Any) -> Any:
        return blend_distance(self.settings, *of)

    def light(
        self, state: EngineState, surface: Surface, to_eye: Any, time_s: Any, active: Any, rng: Any, short_rays: bool
    ) -> tuple[Any, Any]:  # fmt: skip
        """(what multiplies a diffuse colour, short rays: UInt32): bounced light, darkened in corners by short rays."""
        found = irradiance_at(self.settings, state.indirect, surface.point, mi.Vector3f(surface.normal), to_eye, active)
        none = dr.select(active, mi.UInt32(0), mi.UInt32(0))
        count = self.settings.occlusion_rays
        if not short_rays or count == 0:
            return dr.select(active, found, 0), none
        tracer = self.engine.tracer
        share = ambient_occlusion(
            tracer, state.arrays, state.poses, surface, state.indirect.radius, time_s, active, rng, count
        )
        return dr.select(active, found * share, 0), dr.select(active, mi.UInt32(count), none)
