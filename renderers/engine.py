"""The ray engine: one scene, ready to be traced and shaded, for every technique.

A technique makes a state on the host (`Engine.state`), hands it to its frozen kernel, and in the kernel asks for camera
rays and samples. Everything inside kernels is in tracer space (`Engine.space`), times are float32 seconds relative to
the view's t1 (0.0, a Python number, means t1 itself and makes a leaner kernel); ``Sample.z`` is in world units.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from renderers.backend import dr, mi
from renderers.camera import CameraState, Ray, camera_poses, camera_state, forward_axis, primary_ray, project
from renderers.frozen import opaque_float, opaque_uint
from renderers.lights import LightArrays, light_arrays, sorted_lights
from renderers.materials import MaterialArrays, material_arrays
from renderers.motion import Place, background_motion, reflected_motion, surface_motion
from renderers.parameters import Probes
from renderers.polar.probes import ProbeGrid
from renderers.poses import Poses, knot_times, pose_at
from renderers.requirements import Requirements, requirements_of
from renderers.samples import FirstHit, Sample
from renderers.surface import met_from_behind
from renderers.technique import View
from renderers.tracer import SceneArrays, Tracer
from renderers.trap import STAGES
from renderers.whitted import follow, shade, visible_hit
from stimuli.errors import InputError, problem
from stimuli.scene import Scene

Lighting = Literal["direct", "ambient_occlusion", "probes"]
LARGEST = 65504.0
"""The largest half-float: shading ends with a clamp to it."""
_FILE_AO_RADIUS = 0.05  # of the bounding radius


@dataclass
class EngineState:
    """A PyTree: everything on the device that one view's kernels read."""

    arrays: SceneArrays
    materials: MaterialArrays
    poses: Poses
    camera: CameraState
    lights: LightArrays
    ambient: Any
    background: Any
    ao_radius: Any
    to_world: Any
    indirect: Any = None
    trapped: Any = None


class Engine:
    """A scene ready to be traced. Build it once for a clip or a session.

    ``lighting``: 'direct' (Whitted), 'ambient_occlusion' (base colour times open sky, no lights), 'probes' (direct plus
    ``indirect``, a `renderers.polar.probes.ProbeGrid` that `state` brings up to date for each new view).
    ``sphere_lights``: 'point' or 'sampled'. ``ao_radius``: world units; None: 0.05 of the bounding radius.
    ``requirements``: what kernels contain (default: what the scene requires; more
    changes no picture). ``debug``: count what is not finite at each stage, see `trapped`. Raises InputError for unknown
    settings and meshes that are not finite.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        device: str = "auto",
        lighting: Lighting = "direct",
        sphere_lights: Literal["point", "sampled"] = "point",
        ao_samples: int = 16,
        ao_radius: float | None = None,
        requirements: Requirements | None = None,
        debug: bool = False,
    ) -> None:
        if lighting not in ("direct", "ambient_occlusion", "probes"):
            raise InputError(
                problem("lighting", "unknown lighting", repr(lighting), "direct | ambient_occlusion | probes")
            )
        if sphere_lights not in ("point", "sampled"):
            raise InputError(problem("sphere_lights", "unknown setting", repr(sphere_lights), "point | sampled"))
        if ao_samples < 1:
            raise InputError(problem("ao_samples", "ambient occlusion rays", ao_samples, "at least 1"))
        if ao_radius is not None and not ao_radius > 0:
            raise InputError(problem("ao_radius", "ambient occlusion radius", ao_radius, "more than 0"))
        self.scene = scene
        self.lighting = lighting
        self.requirements = requirements_of(scene, sphere_lights == "sampled") if requirements is None else requirements
        self.tracer = Tracer(scene, device, self.requirements)
        self.space = self.tracer.space
        self.ao_samples = ao_samples
        self.ao_radius = _FILE_AO_RADIUS * self.space.radius if ao_radius is None else ao_radius
        self._lights, self.light_groups = sorted_lights(scene, sphere_lights == "sampled")
        self.lights_move = any(light.track is not None for light in scene.lights)
        self._materials = material_arrays(self.tracer.materials)
        self._constants: tuple[Any, ...] | None = None
        self._unmoved_lights: LightArrays | None = None
        self._posed: tuple[View, np.ndarray] | None = None
        self._trapped = opaque_uint(np.zeros(len(STAGES))) if debug else None
        self.indirect: ProbeGrid | None = ProbeGrid(self) if lighting == "probes" else None

    def with_probes(self, settings: Probes, seed: int = 0) -> Engine:
        """This engine with light probes of its own, sharing scene and tracer: for a technique that brings probes."""
        other = copy.copy(self)
        other.lighting = "probes"
        other.indirect = ProbeGrid(other, settings, seed)
        return other

    def trapped(self) -> dict[str, int]:
        """Active lanes whose values were not finite, by the stage that first showed it; counts from 0 again.

        Empty where nothing was trapped. Raises RuntimeError without ``debug``.
        """
        if self._trapped is None:
            raise RuntimeError("nothing is trapped: the engine was built without debug=True")
        counts = self._trapped.numpy().tolist()
        self._trapped = opaque_uint(np.zeros(len(STAGES)))
        return {stage: count for stage, count in zip(STAGES, counts, strict=True) if count}

    def trap(self, state: EngineState, stage: str, active: Any, *values: Any) -> None:
        """Count the active lanes in which some value is not finite (nothing is recorded without ``debug``)."""
        if state.trapped is None:
            return
        good = mi.Bool(True)
        for value in values:
            good &= dr.isfinite(value) if dr.depth_v(value) == 1 else dr.all(dr.isfinite(value))
        dr.scatter_add(state.trapped, mi.UInt32(1), mi.UInt32(STAGES.index(stage)), mi.Bool(active) & ~good)

    @property
    def follows_rays(self) -> bool:
        """Whether rays go on from some surface (mirrors, see-through)."""
        mirrors = self.requirements.mirrors and self.lighting != "ambient_occlusion"
        return mirrors or self.requirements.transparency

    def camera_poses(self, view: View) -> np.ndarray:
        """(K, 4, 4) float64: the camera in the world at the knots of ``view``, from t0 to t1."""
        if self._posed is None or self._posed[0] is not view:
            self._posed = view, camera_poses(view.camera, knot_times(view.t0, view.t1))
        return self._posed[1]

    def _light_arrays(self, view: View) -> LightArrays:
        """The lights' table at both ends of the interval, made once where no light moves."""
        if self._unmoved_lights is not None:
            return self._unmoved_lights
        made = light_arrays(self._lights, self.light_groups, self.space, float(view.t0), float(view.t1))
        if not self.lights_move:
            self._unmoved_lights = made
        return made

    def state(self, view: View, size_px: tuple[int, int] | None = None) -> EngineState:
        """The state of ``view`` for a picture of ``size_px`` (default: the view's), evaluated in float64 on the host.

        With more than 4 movers a state's boxes belong to the latest call, and so do the shapes of meshes that deform
        (those of t1, whatever the rays' own times): use a state before making the next.
        """
        times_s = knot_times(view.t0, view.t1)
        if self._constants is None:
            to_float = [
                mi.Color3f(*(opaque_float(v) for v in rgb)) for rgb in (self.scene.ambient, self.scene.background)
            ]
            self._constants = (
                *to_float,
                opaque_float(self.ao_radius * self.space.scale),
                opaque_float(1 / self.space.scale),
            )
        poses = self.tracer.poses(times_s)
        self.tracer.deform(float(view.t0), float(view.t1))
        state = EngineState(
            arrays=self.tracer.arrays,
            materials=self._materials,
            poses=poses,
            camera=camera_state(
                view.camera, self.camera_poses(view), self.space, times_s, view.size_px if size_px is None else size_px
            ),
            lights=self._light_arrays(view),
            ambient=self._constants[0],
            background=self._constants[1],
            ao_radius=self._constants[2],
            to_world=self._constants[3],
            trapped=self._trapped,
        )
        if self.indirect is not None:
            state.indirect = self.indirect.advance(state, view)
        return state

    # Called inside kernels ------------------------------------------------------------------------------------------

    def camera_ray(self, state: EngineState, x_px: Any, y_px: Any, time_s: Any = 0.0) -> Ray:
        """The ray through the picture point (x, y), pixel centres at .5, at ``time_s``; it carries its cone."""
        return primary_ray(state.camera, x_px, y_px, time_s)

    def visible(self, state: EngineState, point_a: Any, point_b: Any, time_s: Any, active: Any = True) -> Any:
        """Whether nothing that casts shadows lies between two tracer-space points (both ends kept clear by 3e-5)."""
        away = mi.Vector3f(point_b - point_a)
        length = dr.norm(away)
        gap = 3e-5 * dr.maximum(1, dr.maximum(dr.max(dr.abs(point_a)), dr.max(dr.abs(point_b))))
        d = away * dr.rcp(dr.maximum(length, 1e-20))
        far = length > 2 * gap
        blocked = self.tracer.occluded(
            state.arrays, state.poses, mi.Point3f(point_a + d * gap), d, time_s, mi.Bool(active) & far, length - 2 * gap
        )
        return ~blocked

    def to_world(self, state: EngineState, mover: Any, point_local: Any, time_s: Any) -> Any:
        """Where a point of a mover's own space is (tracer space) at ``time_s``."""
        if not self.tracer.bodies:
            return mi.Point3f(point_local)
        return pose_at(state.poses, mover, time_s).point(point_local)

    def project(self, state: EngineState, point: Any, time_s: Any = 0.0) -> tuple[Any, Any, Any]:
        """Tracer point -> (x_px, y_px, depth in world units; not positive: behind the eye)."""
        x, y, depth = project(state.camera, point, time_s)
        return x, y, depth * state.to_world

    def motion(self, state: EngineState, sample: Sample, reflected: bool = True) -> Any:
        """Motion (Vector2f, px over the interval t0 -> t1, now - before, y down) of what ``sample`` shows at t1.

        ``reflected``: where a mirror makes up most of the picture, the motion of what it shows (needs a sample made
        with ``want_motion``). The background moves with the camera's turning.
        """
        place = Place(sample.mover, sample.point_local, sample.point_before)
        found = surface_motion(state.camera, state.poses, place, sample.hit)
        found = dr.select(sample.hit, found, background_motion(state.camera, sample.direction))
        if not (reflected and self.requirements.mirrors and self.follows_rays):
            return found
        pose = pose_at(state.poses, sample.mover, 0.0)
        normal_local = mi.Vector3f(pose.inverse().normal(sample.normal_geometric))
        mirrored = reflected_motion(state.camera, state.poses, place, normal_local, sample.shown, sample.mirrored)
        return dr.select(sample.mirrored, mirrored, found)

    def sample(
        self, state: EngineState, ray: Ray, time_s: Any = 0.0, active: Any = True, rng: Any = None,
        light_samples: int = 1, want_motion: bool = False,
    ) -> Sample:  # fmt: skip
        """Trace and shade one ray a lane (Whitted: mirrors to depth 3, see-through surfaces straight on).

        ``rng``: UInt32 seed a lane for lights with an area and ambient occlusion; None: an even grid, the same in every
        lane. ``light_samples``: shadow rays for each such light, a square number. ``want_motion`` (rays at t1 only)
        fills ``motion`` and what `motion` needs of mirrors.
        """
        if math.isqrt(light_samples) ** 2 != light_samples or light_samples < 1:
            raise InputError(
                problem("light_samples", "samples of an area light", light_samples, "a square: 1, 4, 9, ... 64, 256")
            )
        active = mi.Bool(active)
        self.trap(state, "camera ray", active, ray.o, ray.d, ray.spread)
        # Primary hit.
        hit, surface = visible_hit(self, state, ray, time_s, active, coherent=True)
        seen = active & hit.valid
        shaded = shade(self, state, surface, hit, ray, time_s, seen, rng, light_samples, coherent=True)
        own = shaded.surface + shaded.albedo * shaded.light
        extra = dr.select(seen, 0, state.background)
        counts = {"shadow": shaded.shadow, "ambient_occlusion": shaded.ambient_occlusion}
        shown = Place(mi.UInt32(0), mi.Point3f(0), mi.Point3f(0))
        mirrored = mi.Bool(False)
        if self.follows_rays:
            # What mirrors and see-through surfaces add.
            followed = follow(self, state, ray, hit, surface, shaded, time_s, seen, rng, light_samples)
            extra = extra + followed["color"]
            counts["shadow"] += followed["shadow"]
            counts["ambient_occlusion"] += followed["ambient_occlusion"]
            counts["reflection"], counts["transmission"] = followed["reflection"], followed["transmission"]
            shown = followed["shown"]
            mirrored = seen & followed["found"] & (mi.luminance(shaded.mirror) > mi.luminance(shaded.albedo))
        zero = dr.select(active, mi.UInt32(0), mi.UInt32(0))
        for kind in ("reflection", "transmission", "probe"):
            counts.setdefault(kind, zero)
        color = own + extra
        # Shading ends in [0, 65504]; nan becomes 0; both are counted.
        wrong = active & dr.any((color > LARGEST) | (color < 0) | dr.isnan(color))
        color = dr.select(dr.isnan(color), 0, dr.clip(color, 0, LARGEST))
        z = hit.t * dr.dot(ray.d, forward_axis(state.camera, time_s)) * state.to_world
        result = Sample(
            color=dr.select(active, color, 0),
            hit=seen,
            t=hit.t,
            z=dr.select(seen, z, dr.inf),
            point=surface.point,
            point_local=surface.point_local,
            point_before=surface.point_before,
            mover=hit.mover,
            normal=surface.normal,
            normal_geometric=surface.geometric,
            albedo=shaded.albedo,
            light=shaded.light,
            surface=shaded.surface + extra,
            material=surface.material,
            motion=mi.Vector2f(0),
            clamped=dr.select(wrong, mi.UInt32(1), mi.UInt32(0)),
            mirrored=mirrored,
            shown=shown,
            direction=ray.d,
            rays=counts,
        )
        if want_motion:
            result.motion = self.motion(state, result)
            self.trap(state, "motion", active, result.motion)
        return result

    def first_hit(
        self, state: EngineState, ray: Ray, time_s: Any = 0.0, active: Any = True, rng: Any = None
    ) -> FirstHit:
        """The nearest surface and the light that leaves it, for rays that need no mirrors (probes)."""
        active = mi.Bool(active)
        hit, surface = visible_hit(self, state, ray, time_s, active, coherent=False)
        seen = active & hit.valid
        shaded = shade(self, state, surface, hit, ray, time_s, seen, rng, 1, coherent=False, short_rays=False)
        return FirstHit(
            color=shaded.surface + shaded.albedo * shaded.light,
            hit=seen,
            t=hit.t,
            surface=surface,
            back=seen & met_from_behind(self.tracer, state.arrays, state.poses, hit, ray.d, time_s, seen),
            shadow=shaded.shadow,
        )
