"""How far from where the eye looks: the angle at the eye between a point of the picture and the gaze (decisions.md).

Shared by every gaze-contingent technique and by `protocols`: numpy only, float64. Kernels: `renderers.eye_angles`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from renderers.technique import Gaze, ViewGeometry
from stimuli.errors import InputError, problem


@dataclass(frozen=True)
class EyePlane:
    """The picture as the eye sees it, metres or any other unit; the eye is the origin, x right, y up, -z forward.

    The picture point (x, y) in pixels is at ``corner + x * step_x + y * step_y``; ``gaze`` is a unit vector.
    """

    corner: tuple[float, float, float]
    step_x: tuple[float, float, float]
    step_y: tuple[float, float, float]
    gaze: tuple[float, float, float]


def direction_of(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """(3,) unit vector: ``azimuth_deg`` to the right, then ``elevation_deg`` up from the horizontal plane."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    flat = math.cos(elevation)
    return np.array([math.sin(azimuth) * flat, math.sin(elevation), -math.cos(azimuth) * flat])


def angles_of(direction: np.ndarray) -> Gaze:
    """(azimuth to the right, elevation up) in degrees of a (3,) vector that is not 0; inverse of `direction_of`."""
    x, y, z = (float(v) for v in direction)
    return math.degrees(math.atan2(x, -z)), math.degrees(math.atan2(y, math.hypot(x, z)))


def checked_geometry(geometry: ViewGeometry) -> ViewGeometry:
    """``geometry``; InputError where a size or the distance is not a finite number above 0, or an offset not finite."""
    for name in ("width_m", "height_m", "distance_m"):
        value = getattr(geometry, name)
        if not (math.isfinite(value) and value > 0):
            raise InputError(problem("view_geometry", name, value, "a finite number of metres above 0"))
    if not all(math.isfinite(v) for v in geometry.offset_m):
        raise InputError(problem("view_geometry", "offset_m", geometry.offset_m, "finite numbers of metres"))
    return geometry


def eye_plane(
    size_px: tuple[int, int], yfov_rad: float, geometry: ViewGeometry | None = None, gaze: Gaze | None = None
) -> EyePlane:
    """The plane of a picture of ``size_px``: a screen of ``geometry``, or (None) the camera's own field.

    ``gaze``: degrees right and up from the panel's centre (None: its centre); it may lie outside the picture.
    Raises InputError for a gaze or geometry that is not finite.
    """
    width, height = size_px
    if geometry is None:
        half_y = math.tan(yfov_rad / 2)
        half_x, distance, right, up = half_y * width / height, 1.0, 0.0, 0.0
    else:
        checked_geometry(geometry)
        half_x, half_y, distance = geometry.width_m / 2, geometry.height_m / 2, geometry.distance_m
        right, up = geometry.offset_m
    centre = np.array([right, up, -distance])
    towards = centre / np.linalg.norm(centre)
    if gaze is not None:
        if not all(math.isfinite(v) for v in gaze):
            raise InputError(problem("gaze", "direction", gaze, "two finite numbers of degrees, or None"))
        azimuth, elevation = angles_of(centre)
        towards = direction_of(azimuth + gaze[0], elevation + gaze[1])
    return EyePlane(
        corner=(right - half_x, up + half_y, -distance),
        step_x=(2 * half_x / width, 0.0, 0.0),
        step_y=(0.0, -2 * half_y / height, 0.0),
        gaze=(float(towards[0]), float(towards[1]), float(towards[2])),
    )


def eccentricity_deg(plane: EyePlane, x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
    """Degrees between the gaze and the picture points (x, y); arrays that broadcast. atan2: exact at 0 and 180."""
    x_px, y_px = np.broadcast_arrays(np.asarray(x_px, np.float64), np.asarray(y_px, np.float64))
    points = np.asarray(plane.corner) + x_px[..., None] * np.asarray(plane.step_x) + y_px[..., None] * plane.step_y
    gaze = np.asarray(plane.gaze)
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(points, gaze), axis=-1), points @ gaze))


def picture_eccentricity_deg(plane: EyePlane, size_px: tuple[int, int]) -> np.ndarray:
    """(H, W) degrees of every pixel's centre."""
    return eccentricity_deg(plane, np.arange(size_px[0]) + 0.5, np.arange(size_px[1])[:, None] + 0.5)


def gaze_point_px(plane: EyePlane) -> tuple[float, float]:
    """The picture point (x, y) in pixels that the gaze meets; it may lie outside. Raises InputError where the gaze
    never meets the picture's plane."""
    gaze, corner = np.asarray(plane.gaze), np.asarray(plane.corner)
    if gaze[2] >= 0:
        raise InputError(problem("gaze", "direction", tuple(gaze.round(3)), "one that meets the picture's plane"))
    point = gaze * (corner[2] / gaze[2]) - corner
    return float(point[0] / plane.step_x[0]), float(point[1] / plane.step_y[1])


def gaze_at(plane_point: tuple[float, float], geometry: ViewGeometry | None) -> Gaze:
    """The gaze (degrees from the panel's centre) that looks at a point of the picture's plane.

    ``plane_point``: right and up of the eye's foot point on the screen, metres; without geometry, on the plane one unit
    in front of the camera.
    """
    right, up, distance = (0.0, 0.0, 1.0) if geometry is None else (*geometry.offset_m, geometry.distance_m)
    centre = angles_of(np.array([right, up, -distance]))
    towards = angles_of(np.array([*plane_point, -distance]))
    return towards[0] - centre[0], towards[1] - centre[1]
