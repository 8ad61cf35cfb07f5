"""Rays into scenes with rigid movers, each ray at its own time.

`Tracer` owns the Mitsuba scenes (one for what stands still, one a moving body, one of boxes) in tracer space. Its
``nearest`` and ``occluded`` are called inside kernels; ``trace`` is the plain numpy call for everyone else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from renderers.backend import activate, dr, mi
from renderers.frozen import opaque_float, opaque_uint
from renderers.geometry import Body, pack
from renderers.hits import Hits, PlainRays
from renderers.mover_walk import Question, RawHit, past_movers
from renderers.poses import Poses, pose_matrices, poses_of
from renderers.proxy import ASK_ALL, box_faces, box_vertices, swept_boxes
from renderers.requirements import Requirements, requirements_of
from renderers.skins import Skins
from renderers.space import tracer_space
from stimuli.scene import Scene

__all__ = ["Hits", "RawHit", "SceneArrays", "Tracer"]


@dataclass
class SceneArrays:
    """A PyTree of everything on the device that outlives a frame; handed into every kernel as part of the state.

    ``still`` and ``bodies``: a Mitsuba scene for each of `Tracer.still` and `Tracer.bodies`. ``casting``: one more, of
    the faces that cast shadows, for those of them with faces of both kinds. ``before``: (V, 4) float32 flat, where the
    vertices of skinned meshes were at t0; None without them.
    """

    still: list[Any]
    bodies: list[Any]
    casting: list[Any]
    proxy: Any
    boxes: Any
    body_mover: Any
    body_face_base: Any
    vertices: Any
    faces: Any
    colors: Any
    before: Any = None


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
        self.still: list[Body] = [body for body in self.geometry.bodies if not body.mover]
        self.bodies: list[Body] = [body for body in self.geometry.bodies if body.mover]
        self.uses_proxy = len(self.bodies) > ASK_ALL
        self._own_bounds = np.array(
            [[b.positions.min(axis=0), b.positions.max(axis=0)] for b in self.bodies], np.float64
        )
        proxy = None
        if self.uses_proxy:
            proxy = _mesh_scene(np.zeros((8 * len(self.bodies), 3)), box_faces(len(self.bodies)))
            self._proxy_values = mi.traverse(proxy)
        colors = self.geometry.colors
        mixed = [body for body in (*self.still, *self.bodies) if 0 < body.casting < len(body.faces)]
        self.arrays = SceneArrays(
            still=[_mesh_scene(body.positions, body.faces) for body in self.still],
            bodies=[_mesh_scene(body.positions, body.faces) for body in self.bodies],
            casting=[_mesh_scene(body.positions, body.faces[: body.casting]) for body in mixed],
            proxy=proxy,
            boxes=opaque_float(np.zeros(8 * max(1, len(self.bodies)))),
            body_mover=opaque_uint([body.mover for body in self.bodies] or [0]),
            body_face_base=opaque_uint([body.face_base for body in self.bodies] or [0]),
            vertices=opaque_float(self.geometry.vertices),
            faces=opaque_uint(self.geometry.faces),
            colors=None if colors is None else opaque_float(colors),
        )
        deforming = [made for body, made in zip(self.still, self.arrays.still, strict=True) if body.deforms]
        deforming += [made for body, made in zip(mixed, self.arrays.casting, strict=True) if body.deforms]
        self._skins = Skins(scene, self.space, self.geometry, deforming) if self.needs.deforming else None
        self._interval: tuple[float, ...] | None = None
        self._poses: Poses | None = None
        self._plain = PlainRays(self)

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

    def deform(self, t0_s: float, t1_s: float) -> None:
        """Give skinned meshes their shape of ``t1_s`` (absolute seconds), and remember the one of ``t0_s``.

        The shape belongs to the latest call: rays of an earlier one must have been traced before. Nothing is done in a
        scene without skinned meshes. Raises InputError for vertices that are not finite.
        """
        if self._skins is not None:
            self._skins.pose(self.arrays, t0_s, t1_s)

    # Called inside kernels ------------------------------------------------------------------------------------------

    def casting(self, arrays: SceneArrays) -> tuple[list[Any], list[Any]]:
        """What shadow rays ask for each of ``still`` and of ``bodies``; None where nothing casts shadows."""
        extra = iter(arrays.casting)

        def caster(body: Body, scene: Any) -> Any:
            if body.casting < len(body.faces):
                return next(extra) if body.casting else None
            return scene

        return (
            [caster(body, scene) for body, scene in zip(self.still, arrays.still, strict=True)],
            [caster(body, scene) for body, scene in zip(self.bodies, arrays.bodies, strict=True)],
        )

    def nearest(
        self, arrays: SceneArrays, poses: Poses, o: Any, d: Any, time_s: Any, active: Any, coherent: bool,
        tmax: Any = dr.inf,
    ) -> RawHit:  # fmt: skip
        """The nearest hit of rays ``o + t d`` (tracer space; ``d`` of any length) at ``time_s`` relative to t1."""
        active = mi.Bool(active)
        best = RawHit(mi.Float(dr.inf), mi.UInt32(0), mi.Float(0), mi.Float(0), mi.UInt32(0))
        if not self.still and not self.bodies:
            # An empty scene's misses have the lanes of their rays: recordings keep the width of a bare constant.
            best.t = dr.select(d.x == d.x, best.t, 0.0)
        limit = mi.Float(tmax)
        for body, scene in zip(self.still, arrays.still, strict=True):
            found = scene.ray_intersect_preliminary(mi.Ray3f(o, d, limit, 0.0, []), coherent=coherent, active=active)
            hit = active & found.is_valid() & (found.t < limit)
            limit = dr.select(hit, found.t, limit)
            face = found.prim_index + body.face_base
            best = dr.select(hit, RawHit(found.t, face, found.prim_uv.x, found.prim_uv.y, mi.UInt32(0)), best)
        if not self.bodies:
            return best
        question = Question(o, d, time_s, shadow=False, coherent=coherent)
        return past_movers(self, arrays, poses, question, active, limit, (best,))[1][0]

    def occluded(
        self, arrays: SceneArrays, poses: Poses, o: Any, d: Any, time_s: Any, active: Any, tmax: Any,
        coherent: bool = False,
    ) -> Any:  # fmt: skip
        """Whether anything that casts shadows lies on ``o + t d``, 0 < t < tmax. ``coherent``: lanes go one way."""
        active = mi.Bool(active)
        blocked = mi.Bool(False)
        for scene in self.casting(arrays)[0]:
            if scene is not None:
                ray = mi.Ray3f(o, d, tmax, 0.0, [])
                blocked |= scene.ray_test(ray, coherent=coherent, active=active & ~blocked)
        if not any(body.casting for body in self.bodies):
            return blocked
        question = Question(o, d, time_s, shadow=True, coherent=coherent)
        nearest, _ = past_movers(self, arrays, poses, question, active & ~blocked, mi.Float(tmax), ())
        return blocked | (nearest < 0)

    # The plain call -------------------------------------------------------------------------------------------------

    def trace(self, origin: np.ndarray, direction: np.ndarray, time_s: float | np.ndarray = 0.0) -> Hits:
        """Nearest hits of N rays: ``origin``, ``direction`` (N, 3) world (directions of any length but 0), ``time_s``
        absolute scene seconds, one or (N,). N = 0 is allowed. Raises InputError for wrong shapes and non-finite values.
        """
        return self._plain.trace(origin, direction, time_s)
