"""Motion vectors: how far what a pixel shows moved over the view's interval, in pixels (now - before, y down).

From the hit's own local point through both poses, so that a resting mover under a resting camera has exactly none.
Mirrors: the reflected point, mirrored at the plane of the first hit (temporally dense paper, 3.1.2; Householder).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from renderers.backend import dr, mi
from renderers.camera import CameraState, project, project_at_start
from renderers.poses import Pose, Poses, pose_at, pose_at_start


@dataclass
class Place:
    """A PyTree: a point of ``mover``'s own space, at t1 and, another one only on a mesh that deforms, at t0."""

    mover: Any
    now: Any
    before: Any


def _ends(poses: Poses, mover: Any, active: Any) -> tuple[Pose, Pose]:
    return pose_at(poses, mover, 0.0, active), pose_at_start(poses, mover, active)


def surface_motion(camera: CameraState, poses: Poses, place: Place, active: Any) -> Any:
    """Motion (Vector2f) of ``place`` between t0 and t1."""
    now, before = _ends(poses, place.mover, active)
    return _difference(camera, now.point(place.now), before.point(place.before), active)


def _difference(camera: CameraState, now: Any, before: Any, active: Any) -> Any:
    x1, y1, z1 = project(camera, now, 0.0)
    x0, y0, z0 = project_at_start(camera, before)
    seen = active & (z1 > 0) & (z0 > 0)
    return mi.Vector2f(dr.select(seen, x1 - x0, 0), dr.select(seen, y1 - y0, 0))


def background_motion(camera: CameraState, direction: Any) -> Any:
    """Motion of what is infinitely far in ``direction`` (unit, tracer space)."""
    far = 1e4
    x1, y1, z1 = project(camera, _eye(camera, True) + direction * far, 0.0)
    x0, y0, z0 = project_at_start(camera, _eye(camera, False) + direction * far)
    seen = (z1 > 0) & (z0 > 0)
    return mi.Vector2f(dr.select(seen, x1 - x0, 0), dr.select(seen, y1 - y0, 0))


def _eye(camera: CameraState, now: bool) -> Any:
    pose = pose_at(camera.poses, mi.UInt32(0), 0.0) if now else pose_at_start(camera.poses, mi.UInt32(0))
    return mi.Point3f(*(row.w for row in pose.rows))


def reflected_motion(
    camera: CameraState, poses: Poses, mirror: Place, mirror_normal_local: Any, shown: Place, active: Any
) -> Any:
    """Motion of the image of ``shown`` in the plane through ``mirror``.

    R(Y) = Y - 2 ((Y - q) . n) n, with q and n of t1 for the picture now, of t0 for the one before (the paper assumes a
    mirror that rests; one that moves rigidly costs nothing more). A mirror that deforms keeps its normal of t1.
    """
    images = []
    own, plane_of = _ends(poses, shown.mover, active), _ends(poses, mirror.mover, active)
    points, planes = (shown.now, shown.before), (mirror.now, mirror.before)
    for pose, plane, local, mirror_local in zip(own, plane_of, points, planes, strict=True):
        point, q = pose.point(local), plane.point(mirror_local)
        n = dr.normalize(mi.Vector3f(plane.normal(mirror_normal_local)))
        images.append(point - n * (2 * dr.dot(point - q, n)))
    return _difference(camera, images[0], images[1], active)
