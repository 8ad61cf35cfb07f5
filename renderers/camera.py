"""Primary rays and projection. Pixel (0, 0) is top left, its centre at (0.5, 0.5), y down; a camera looks down -z."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.frozen import opaque_float
from renderers.poses import Pose, Poses, pose_at, pose_at_start
from renderers.space import TracerSpace
from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath


@dataclass
class CameraState:
    """A PyTree. ``poses``: camera-to-tracer at the knots (one body). ``center_x_px``, ``center_y_px``: the picture's
    middle. ``pixel``: size of a pixel on the plane one unit in front of the eye."""

    poses: Poses
    center_x_px: Any
    center_y_px: Any
    pixel: Any


@dataclass
class Ray:
    """A PyTree, tracer space: origin, unit direction, the cone's width at the origin and its growth per unit length."""

    o: Any
    d: Any
    width: Any
    spread: Any


def camera_poses(camera: CameraPath, times_s: np.ndarray) -> np.ndarray:
    """(K, 4, 4) float64 camera-to-world at these scene seconds. Raises InputError where one is not finite."""
    poses = np.asarray(camera.pose(np.asarray(times_s, np.float64)), np.float64)
    if not np.isfinite(poses).all():
        raise InputError(problem("camera", "pose", "values that are not finite", "finite numbers"))
    return poses


def camera_state(
    camera: CameraPath, poses: np.ndarray, space: TracerSpace, times_s: np.ndarray, size_px: tuple[int, int]
) -> CameraState:
    """The device's camera with ``poses`` (K, 4, 4; world) at these knots.

    Raises InputError for a size below 1 px and for a field of view not in (0, pi) rad.
    """
    width, height = size_px
    if width < 1 or height < 1:
        raise InputError(problem("size_px", "picture size", f"{width}x{height}", "at least 1x1"))
    if not 0 < camera.yfov_rad < np.pi:
        raise InputError(problem("camera", "vertical field of view", camera.yfov_rad, "0 to pi rad, both excluded"))
    matrices = np.zeros((1, len(times_s), 3, 4))
    matrices[0, :, :, :3] = poses[:, :3, :3] / np.linalg.norm(poses[:, :3, :3], axis=1, keepdims=True)
    matrices[0, :, :, 3] = space.points(poses[:, :3, 3])
    return CameraState(
        poses=Poses(
            span_s=opaque_float(float(times_s[0] - times_s[-1])),
            forward=opaque_float(matrices),
            window=opaque_float([-np.inf, np.inf]),
            knots=len(times_s),
        ),
        center_x_px=opaque_float(width / 2),
        center_y_px=opaque_float(height / 2),
        pixel=opaque_float(2 * np.tan(camera.yfov_rad / 2) / height),
    )


def primary_ray(camera: CameraState, x_px: Any, y_px: Any, time_s: Any) -> Ray:
    """The ray through the picture point (x, y) at ``time_s`` relative to t1 (0.0, a number: at t1)."""
    pose = pose_at(camera.poses, mi.UInt32(0), time_s)
    x = (x_px - camera.center_x_px) * camera.pixel
    y = (camera.center_y_px - y_px) * camera.pixel
    d = dr.normalize(pose.vector(mi.Vector3f(x, y, -1)))
    origin = mi.Point3f(*(row.w for row in pose.rows))
    # A pixel away from the middle is seen under a smaller angle.
    spread = camera.pixel * dr.rcp(1 + dr.square(x) + dr.square(y))
    return Ray(origin, d, mi.Float(0), spread)


def _project(camera: CameraState, pose: Pose, point: Any) -> tuple[Any, Any, Any]:
    away = mi.Vector3f(*(point[k] - row.w for k, row in enumerate(pose.rows)))
    # The rotation's inverse is its transpose; blended rotations are close enough to one.
    own = [sum(pose.rows[k][axis] * away[k] for k in range(3)) for axis in range(3)]
    depth = -own[2]
    scale = dr.rcp(depth * camera.pixel)
    return camera.center_x_px + own[0] * scale, camera.center_y_px - own[1] * scale, depth


def project(camera: CameraState, point: Any, time_s: Any) -> tuple[Any, Any, Any]:
    """Tracer point -> (x_px, y_px, depth along the axis in tracer units; not positive: behind the eye)."""
    return _project(camera, pose_at(camera.poses, mi.UInt32(0), time_s), point)


def project_at_start(camera: CameraState, point: Any) -> tuple[Any, Any, Any]:
    """The same at t0."""
    return _project(camera, pose_at_start(camera.poses, mi.UInt32(0)), point)


def forward_axis(camera: CameraState, time_s: Any) -> Any:
    """The camera's viewing direction (unit vector) at ``time_s``."""
    pose = pose_at(camera.poses, mi.UInt32(0), time_s)
    return mi.Vector3f(*(-row.z for row in pose.rows))
