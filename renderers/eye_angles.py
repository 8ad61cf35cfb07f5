"""`renderers.eccentricity` inside kernels: the angle at the eye of a picture point, one a lane."""

from __future__ import annotations

from typing import Any

from renderers.backend import dr, mi
from renderers.eccentricity import EyePlane
from renderers.frozen import opaque_float


def plane_values(plane: EyePlane) -> Any:
    """``plane`` on the device (Float, width 12): an argument of kernels, so that a gaze that moves records nothing."""
    return opaque_float([*plane.corner, *plane.step_x, *plane.step_y, *plane.gaze])


def pixel_eccentricity_deg(values: Any, x_px: Any, y_px: Any) -> Any:
    """Degrees (Float) between the gaze and the picture point (x, y); ``values`` from `plane_values`."""
    corner, step_x, step_y, gaze = (
        mi.Vector3f(*(dr.gather(mi.Float, values, 3 * k + i) for i in range(3))) for k in range(4)
    )
    point = dr.fma(step_y, y_px, dr.fma(step_x, x_px, corner))
    return dr.rad2deg(dr.atan2(dr.norm(dr.cross(point, gaze)), dr.dot(point, gaze)))
