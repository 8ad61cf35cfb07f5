"""Rays into scenes with rigid movers, each ray at its own time.

`Tracer` owns the Mitsuba scenes (one for what stands still, one a moving body, one of boxes) in tracer space. Its
``nearest`` and ``occluded`` are called inside kernels; ``trace`` is the plain numpy call for everyone else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from renderers.backend import activate, dr, mi
from renderers.frozen import frozen, opaque_float, opaque_uint
from renderers.geometry import Body, pack
from renderers.poses import Poses, exists_at, pose_at, pose_matrices, poses_of
from renderers.proxy import ASK_ALL, STEP, box_faces, box_vertices, must_ask, swept_boxes
from renderers.requirements import Requirements, requirements_of
from renderers.space import tracer_space
from renderers.surface import surface_at
from stimuli.errors import InputError, problem
from stimuli.scene import Scene

_MOMENTS = 32  # distinct ray times that `Tracer.trace` takes in one launch


@dataclass
class SceneArrays:
    """A PyTree of everything on the device that outlives a frame; handed into every kernel as part of the state."""

    opaque: Any
    hidden: Any
    bodies: list[Any]
    proxy: Any
    boxes: Any
    body_mover: Any
    body_face_base: Any
    vertices: Any
    faces: Any
    colors: Any


@dataclass
class RawHit:
    """A PyTree: tracer-space ``t`` (inf: none), global ``face``, barycentrics ``u``, ``v`` of its 2nd and 3rd vertex,
    ``mover`` (0: static)."""

    t: Any
    face: Any
    u: Any
    v: Any
    mover: Any

    @property
    def valid(self) -> Any:
        """Whether anything was hit."""
        return self.t < dr.inf


@dataclass(frozen=True)
class Hits:
    """What N rays hit. ``t`` (N,) world units (inf: a miss), ``point``, ``normal`` (shading), ``geometric_normal``
    (N, 3) world (normals face the ray's origin; nan for a miss), ``uv`` (N, 2), ``material`` (N,) int32 index into
    `Tracer.materials` (-1: a miss), ``mover`` (N,) int32 index into the scene's movers (-1: static or a miss).
    """

    t: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    geometric_normal: np.ndarray
    uv: np.ndarray
    material: np.ndarray
    mover: np.ndarray


def _lanes(value: Any, count: int) -> np.ndarray:
    """A kernel's result as numpy with ``count`` lanes (constants come back with one)."""
    array = value.numpy()
    return np.broadcast_to(array, (*array.shape[:-1], count))


def _mesh_scene(positions: np.ndarray, faces: np.ndarray) -> Any:
    """A Mitsuba scene of one triangle mesh (vertex normals and BSDFs are ours to do)."""
    mesh = mi.Mesh("mesh", len(positions), len(faces))
    values = mi.traverse(mesh)
    values["vertex_positions"] = opaque_float(positions)
    values["faces"] = opaque_uint(faces)
    values.update()
    return mi.load_dict({"type": "scene", "embree_use_robust_intersections": True, "mesh": mesh})


class Tracer:
    """A scene that rays can be sent into. Raises InputError for meshes with positions that are not finite.

    ``device``: 'auto' (CUDA where there is a GPU), 'cuda', 'llvm'. ``requirements``: default those of the scene.
    """

    def __init__(self, scene: Scene, device: str = "auto", requirements: Requirements | None = None) -> None:
        activate(device)
        self.scene = scene
        self.needs = requirements_of(scene) if requirements is None else requirements
        self.space = tracer_space(scene)
        self.geometry = pack(scene, self.space, self.needs)
        self.materials = self.geometry.materials
        self.bodies: list[Body] = [body for body in self.geometry.bodies if body.mover]
        self.uses_proxy = len(self.bodies) > ASK_ALL
        still = {body.hidden: body for body in self.geometry.bodies if not body.mover}
        self._face_base = {hidden: body.face_base for hidden, body in still.items()}
        scenes = {hidden: _mesh_scene(body.positions, body.faces) for hidden, body in still.items()}
        self._own_bounds = np.array(
            [[b.positions.min(axis=0), b.positions.max(axis=0)] for b in self.bodies], np.float64
        )
        proxy = None
        if self.uses_proxy:
            proxy = _mesh_scene(np.zeros((8 * len(self.bodies), 3)), box_faces(len(self.bodies)))
            self._proxy_values = mi.traverse(proxy)
        colors = self.geometry.colors
        self.arrays = SceneArrays(
            opaque=scenes.get(False),
            hidden=scenes.get(True),
            bodies=[_mesh_scene(body.positions, body.faces) for body in self.bodies],
            proxy=proxy,
            boxes=opaque_float(np.zeros(8 * max(1, len(self.bodies)))),
            body_mover=opaque_uint([body.mover for body in self.bodies] or [0]),
            body_face_base=opaque_uint([body.face_base for body in self.bodies] or [0]),
            vertices=opaque_float(self.geometry.vertices),
            faces=opaque_uint(self.geometry.faces),
            colors=None if colors is None else opaque_float(colors),
        )
        self._interval: tuple[float, ...] | None = None
        self._poses: Poses | None = None
        self._hits_kernel = frozen(self._hits, max_recordings=64)

    def poses(self, times_s: np.ndarray, hide: bool = False) -> Poses:
        """The movers' poses at the knots ``times_s`` (K,) and, with many movers, the boxes that hold them in between.

        The boxes belong to the latest interval: rays of an earlier one must have been traced before. ``hide``: a mover
        is out of sight at the knots at which it does not exist (for rays that fall on knots only).
        """
        key = (*np.asarray(times_s, np.float64).tolist(), float(hide))
        if self._poses is None or (key != self._interval and self.scene.movers):
            movers = self.scene.movers
            matrices = pose_matrices(movers, self.geometry.spaces, self.space, np.asarray(times_s, np.float64), hide)
            self._poses = poses_of(matrices, movers, np.asarray(times_s, np.float64))
            if self.uses_proxy:
                boxes = swept_boxes(self._own_bounds, matrices[[body.mover for body in self.bodies]])
                padded = np.zeros((len(boxes), 2, 4), np.float32)
                padded[..., :3] = boxes
                self._proxy_values["mesh.vertex_positions"] = opaque_float(box_vertices(boxes))
                self._proxy_values.update()
                self.arrays.boxes = opaque_float(padded)
        elif key != self._interval:
            self._poses = poses_of(np.tile(np.eye(3, 4), (1, len(times_s), 1, 1)), (), np.asarray(times_s, np.float64))
        self._interval = key
        return self._poses

    # Called inside kernels ------------------------------------------------------------------------------------------

    def nearest(
        self,
        arrays: SceneArrays,
        poses: Poses,
        o: Any,
        d: Any,
        time_s: Any,
        active: Any,
        coherent: bool,
        tmax: Any = dr.inf,
    ) -> RawHit:
        """The nearest hit of rays ``o + t d`` (tracer space; ``d`` of any length) at ``time_s`` relative to t1."""
        active = mi.Bool(active)
        best = RawHit(mi.Float(dr.inf), mi.UInt32(0), mi.Float(0), mi.Float(0), mi.UInt32(0))
        if arrays.opaque is None and arrays.hidden is None and not self.bodies:
            # An empty scene's misses have the lanes of their rays: recordings keep the width of a bare constant.
            best.t = dr.select(d.x == d.x, best.t, 0.0)
        limit = mi.Float(tmax)
        for hidden, scene in ((False, arrays.opaque), (True, arrays.hidden)):
            if scene is None:
                continue
            found = scene.ray_intersect_preliminary(mi.Ray3f(o, d, limit, 0.0, []), coherent=coherent, active=active)
            hit = active & found.is_valid() & (found.t < limit)
            limit = dr.select(hit, found.t, limit)
            best = dr.select(
                hit,
                RawHit(
                    found.t, found.prim_index + self._face_base[hidden], found.prim_uv.x, found.prim_uv.y, mi.UInt32(0)
                ),
                best,
            )
        if not self.bodies:
            return best
        if self.uses_proxy:
            return self._nearest_by_proxy(arrays, poses, o, d, time_s, active, limit, best, coherent)
        for b, body in enumerate(self.bodies):
            t, face, u, v = self._ask(arrays, poses, b, body.mover, o, d, time_s, limit, active, coherent)
            hit = active & (t < limit)
            limit = dr.select(hit, t, limit)
            best = dr.select(hit, RawHit(t, face + body.face_base, u, v, mi.UInt32(body.mover)), best)
        return best

    def occluded(
        self,
        arrays: SceneArrays,
        poses: Poses,
        o: Any,
        d: Any,
        time_s: Any,
        active: Any,
        tmax: Any,
        coherent: bool = False,
    ) -> Any:
        """Whether anything that casts shadows lies on ``o + t d``, 0 < t < tmax. ``coherent``: lanes go one way."""
        active = mi.Bool(active)
        blocked = mi.Bool(False)
        if arrays.opaque is not None:
            blocked = arrays.opaque.ray_test(mi.Ray3f(o, d, tmax, 0.0, []), coherent=coherent, active=active)
        if all(body.hidden for body in self.bodies):
            return blocked
        if self.uses_proxy:
            return self._occluded_by_proxy(arrays, poses, o, d, time_s, active & ~blocked, tmax, blocked, coherent)
        for b, body in enumerate(self.bodies):
            if not body.hidden:
                blocked |= self._ask_any(arrays, poses, b, body.mover, o, d, time_s, tmax, active & ~blocked)
        return blocked

    def _to_own(self, poses: Poses, mover: Any, o: Any, d: Any, time_s: Any, active: Any) -> tuple[Any, Any, Any]:
        """The ray in the mover's own space, and whether the mover exists at the ray's time."""
        inverse = pose_at(poses, mi.UInt32(mover), time_s, active).inverse()
        if self.needs.appearing:
            active = active & exists_at(poses, mi.UInt32(mover), time_s, active)  # not in place: it is the caller's
        return inverse.point(o), inverse.vector(d), active

    def _ask(
        self,
        arrays: SceneArrays,
        poses: Poses,
        b: int,
        mover: Any,
        o: Any,
        d: Any,
        time_s: Any,
        tmax: Any,
        active: Any,
        coherent: bool,
    ) -> tuple[Any, ...]:
        own_o, own_d, active = self._to_own(poses, mover, o, d, time_s, active)
        found = arrays.bodies[b].ray_intersect_preliminary(
            mi.Ray3f(own_o, own_d, tmax, 0.0, []), coherent=coherent, active=active
        )
        return dr.select(active & found.is_valid(), found.t, dr.inf), found.prim_index, found.prim_uv.x, found.prim_uv.y

    def _ask_any(
        self, arrays: SceneArrays, poses: Poses, b: int, mover: Any, o: Any, d: Any, time_s: Any, tmax: Any, active: Any
    ) -> Any:
        own_o, own_d, active = self._to_own(poses, mover, o, d, time_s, active)
        return active & arrays.bodies[b].ray_test(mi.Ray3f(own_o, own_d, tmax, 0.0, []), coherent=False, active=active)

    def _next_box(
        self, arrays: SceneArrays, o: Any, d: Any, walked: Any, limit: Any, asked: Any, active: Any, coherent: bool
    ) -> tuple[Any, Any, Any, Any, Any]:
        """The next box face beyond ``walked``: is there one, how far, its body, must it be asked; bits of the asked."""
        ray = mi.Ray3f(dr.fma(d, walked, o), d, limit - walked, 0.0, [])
        found = arrays.proxy.ray_intersect_preliminary(ray, coherent=coherent, active=active)
        ok = active & found.is_valid()
        body = dr.select(ok, found.prim_index // 12, 0)
        bit = mi.UInt64(1) << mi.UInt64(body & 63)
        ask = ok & (must_ask(arrays.boxes, body, found.prim_index - body * 12, o, d, ok) | ((asked & bit) == 0))
        return ok, walked + found.t, body, ask, dr.select(ask, asked | bit, asked)

    def _nearest_by_proxy(
        self,
        arrays: SceneArrays,
        poses: Poses,
        o: Any,
        d: Any,
        time_s: Any,
        active: Any,
        limit: Any,
        best: RawHit,
        coherent: bool,
    ) -> RawHit:
        def asker(b: int) -> Any:
            scene = arrays.bodies[b]

            def ask(own_o: Any, own_d: Any, tmax: Any, active: Any) -> tuple[Any, ...]:
                ray = mi.Ray3f(own_o, own_d, tmax, 0.0, [])
                found = scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)
                t = dr.select(active & found.is_valid(), found.t, dr.inf)
                return t, found.prim_index, found.prim_uv.x, found.prim_uv.y

            return ask

        askers = [asker(b) for b in range(len(self.bodies))]

        def step(walked: Any, limit: Any, best: RawHit, asked: Any, on: Any) -> tuple[Any, ...]:
            ok, at, body, ask, asked = self._next_box(arrays, o, d, walked, limit, asked, on, coherent)
            mover = dr.gather(mi.UInt32, arrays.body_mover, body, ask)
            own_o, own_d, ask = self._to_own(poses, mover, o, d, time_s, ask)
            t, face, u, v = dr.switch(body, askers, own_o, own_d, limit, active=ask)
            hit = ask & (t < limit)
            base = dr.gather(mi.UInt32, arrays.body_face_base, body, hit)
            best = dr.select(hit, RawHit(t, face + base, u, v, mover), best)
            limit = dr.select(hit, t, limit)
            walked = at + STEP * (1 + at)
            return walked, limit, best, asked, ok & (walked < limit)

        start = (mi.Float(0), limit, best, mi.UInt64(0), active)
        return dr.while_loop(start, lambda walked, limit, best, asked, on: on, step, label="movers")[2]

    def _occluded_by_proxy(
        self,
        arrays: SceneArrays,
        poses: Poses,
        o: Any,
        d: Any,
        time_s: Any,
        active: Any,
        tmax: Any,
        blocked: Any,
        coherent: bool,
    ) -> Any:
        def asker(b: int) -> Any:
            if self.bodies[b].hidden:
                return lambda own_o, own_d, tmax, active: mi.Bool(False)
            scene = arrays.bodies[b]
            return lambda own_o, own_d, tmax, active: (
                active & scene.ray_test(mi.Ray3f(own_o, own_d, tmax, 0.0, []), coherent=coherent, active=active)
            )

        askers = [asker(b) for b in range(len(self.bodies))]
        limit = mi.Float(tmax)

        def step(walked: Any, blocked: Any, asked: Any, on: Any) -> tuple[Any, ...]:
            ok, at, body, ask, asked = self._next_box(arrays, o, d, walked, limit, asked, on, coherent)
            mover = dr.gather(mi.UInt32, arrays.body_mover, body, ask)
            own_o, own_d, ask = self._to_own(poses, mover, o, d, time_s, ask)
            hit = dr.switch(body, askers, own_o, own_d, limit, active=ask)
            blocked = blocked | (ask & hit)
            walked = at + STEP * (1 + at)
            return walked, blocked, asked, ok & ~blocked & (walked < limit)

        start = (mi.Float(0), blocked, mi.UInt64(0), active)
        return dr.while_loop(start, lambda walked, blocked, asked, on: on, step, label="shadow movers")[1]

    # The plain call -------------------------------------------------------------------------------------------------

    def trace(self, origin: np.ndarray, direction: np.ndarray, time_s: float | np.ndarray = 0.0) -> Hits:
        """Nearest hits of N rays: ``origin``, ``direction`` (N, 3) world (directions of any length but 0), ``time_s``
        absolute scene seconds, one or (N,). N = 0 is allowed. Raises InputError for wrong shapes and non-finite values.
        """
        origin = (
            np.asarray(origin, np.float64).reshape(-1, 3) if np.size(origin) == 0 else np.asarray(origin, np.float64)
        )
        direction = (
            np.asarray(direction, np.float64).reshape(origin.shape)
            if np.size(direction) == 0
            else np.asarray(direction, np.float64)
        )
        if origin.ndim != 2 or origin.shape[1] != 3 or direction.shape != origin.shape:
            raise InputError(problem("trace", "shapes", f"{origin.shape} and {direction.shape}", "(N, 3) and (N, 3)"))
        times_s = (
            np.broadcast_to(np.asarray(time_s, np.float64), len(origin)) if np.ndim(time_s) <= 1 else np.asarray(time_s)
        )
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        if not (
            np.isfinite(origin).all()
            and np.isfinite(length).all()
            and (length > 0).all()
            and np.isfinite(times_s).all()
        ):
            raise InputError(
                problem("trace", "rays", "values that are not finite or a direction of length 0", "finite")
            )
        count = len(origin)
        out = {
            name: np.full((count, width), np.nan)
            for name, width in (("point", 3), ("normal", 3), ("geometric", 3), ("uv", 2))
        }
        t, material, mover = np.full(count, np.inf), np.full(count, -1, np.int32), np.full(count, -1, np.int32)
        moments, which = (
            np.unique(times_s, return_inverse=True) if self.scene.movers else (np.zeros(1), np.zeros(count, int))
        )
        for first in range(0, len(moments) if count else 0, _MOMENTS):
            rows = np.flatnonzero((which >= first) & (which < first + _MOMENTS))
            poses, now_s = self._moment_poses(moments[first : first + _MOMENTS], which[rows] - first)
            o = self.space.points(origin[rows]).astype(np.float32)
            d = (direction[rows] / length[rows]).astype(np.float32)
            found = self._hits_kernel(
                len(rows),
                self.arrays,
                poses,
                mi.Point3f(*(opaque_float(column) for column in o.T)),
                mi.Vector3f(*(opaque_float(column) for column in d.T)),
                opaque_float(now_s),
            )
            hit_t, p, n, g, uv, m, body = (_lanes(value, len(rows)) for value in found)
            seen = np.isfinite(hit_t)
            here = rows[seen]
            t[here] = hit_t[seen].astype(np.float64) / self.space.scale
            out["point"][here] = self.space.world_points(p.T[seen])
            out["normal"][here], out["geometric"][here], out["uv"][here] = n.T[seen], g.T[seen], uv.T[seen]
            material[here] = m[seen]
            mover[here] = body[seen].astype(np.int32) - 1
        return Hits(t, out["point"], out["normal"], out["geometric"], out["uv"], material, mover)

    def _moment_poses(self, moments: np.ndarray, which: np.ndarray) -> tuple[Poses, np.ndarray]:
        """Poses whose knots are these moments themselves, and each ray's kernel time that falls on its knot."""
        knots = 2 if len(moments) <= 2 else _MOMENTS
        padded = np.append(moments, np.repeat(moments[-1], knots - len(moments)))
        poses = self.poses(padded, hide=True)
        even = Poses(
            opaque_float(1.0 - knots),
            poses.forward,
            opaque_float(np.tile([-np.inf, np.inf], len(self.scene.movers) + 1)),
            knots,
        )
        return even, (which - (knots - 1.0)).astype(np.float32)

    def _hits(self, arrays: SceneArrays, poses: Poses, o: Any, d: Any, time_s: Any) -> tuple[Any, ...]:
        hit = self.nearest(arrays, poses, o, d, time_s, True, coherent=False)
        s = surface_at(self, arrays, poses, hit, d, time_s, hit.valid)
        return hit.t, s.point, s.normal, s.geometric, s.uv, s.material, hit.mover
