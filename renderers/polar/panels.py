"""The pictures that one polar buffer serves, as the eye sees them: the view itself, or a headset's viewports."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from renderers.eccentricity import EyePlane, eye_plane
from renderers.polar.polar_map import gaze_basis
from renderers.technique import View
from stimuli.errors import InputError, problem

MAIN = "main"


@dataclass(frozen=True)
class Panel:
    """One picture: its plane in eye space (its ``gaze`` is everyone's), and how camera rays follow from eye directions.

    A screen's picture point is reached by the camera ray ``(lens[0] d.x - lens[2] d.z, lens[1] d.y - lens[3] d.z,
    d.z)`` of the eye direction d; a headset's is d itself: lens = (1, 1, 0, 0).
    """

    name: str
    size_px: tuple[int, int]
    plane: EyePlane
    lens: tuple[float, float, float, float] = (1.0, 1.0, 0.0, 0.0)

    @property
    def ppd(self) -> float:
        """Pixels per degree where the plane is met at a right angle."""
        distance = abs(float(self._normal @ np.asarray(self.plane.corner)))
        return math.radians(1) * distance / float(np.linalg.norm(self.plane.step_x))

    @property
    def _normal(self) -> np.ndarray:
        across = np.cross(self.plane.step_x, self.plane.step_y)
        return across / np.linalg.norm(across)


@dataclass(frozen=True)
class Eye:
    """The panels of one eye, ``offset_m`` to the right of the camera."""

    offset_m: float
    panels: tuple[Panel, ...]


def _turned(plane: EyePlane) -> EyePlane:
    """``plane``, which looks ahead, turned so that its middle lies at the gaze."""
    right, up, gaze = gaze_basis(plane.gaze)

    def turn(v: tuple[float, float, float]) -> tuple[float, float, float]:
        found = v[0] * right + v[1] * up - v[2] * gaze
        return float(found[0]), float(found[1]), float(found[2])

    return replace(plane, corner=turn(plane.corner), step_x=turn(plane.step_x), step_y=turn(plane.step_y))


def eyes_of(view: View, size_px: tuple[int, int]) -> tuple[Eye, ...]:
    """One `Eye` for each eye offset among the view's viewports, in their order; one of one panel where it has none.

    Raises InputError for viewports on a screen of given geometry, of equal names, or of an impossible size or field.
    """
    if not view.viewports:
        plane = eye_plane(size_px, view.camera.yfov_rad, view.geometry, view.gaze)
        lens = (1.0, 1.0, 0.0, 0.0)
        if view.geometry is not None:
            half_y = math.tan(view.camera.yfov_rad / 2)
            half_x = half_y * size_px[0] / size_px[1]
            g = view.geometry
            lens = (
                2 * g.distance_m / g.width_m * half_x, 2 * g.distance_m / g.height_m * half_y,
                -2 * g.offset_m[0] / g.width_m * half_x, -2 * g.offset_m[1] / g.height_m * half_y,
            )  # fmt: skip
        return (Eye(0.0, (Panel(MAIN, size_px, plane, lens),)),)
    if view.geometry is not None:
        raise InputError(problem("viewports", "view geometry", "a flat screen", "None: viewports are a headset's"))
    if len({v.name for v in view.viewports}) < len(view.viewports):
        raise InputError(problem("viewports", "names", [v.name for v in view.viewports], "a different one each"))
    eyes: dict[float, list[Panel]] = {}
    for v in view.viewports:
        if min(v.size_px) < 1 or not 0 < v.yfov_rad < math.pi:
            got = f"{v.size_px[0]}x{v.size_px[1]} px, {v.yfov_rad} rad"
            raise InputError(problem(f"viewport {v.name}", "size and field", got, "at least 1x1, 0 to pi rad"))
        plane = eye_plane(v.size_px, v.yfov_rad, None, view.gaze)
        plane = _turned(plane) if v.centred_on_gaze else plane
        eyes.setdefault(v.eye_offset_m, []).append(Panel(v.name, v.size_px, plane))
    return tuple(Eye(offset, tuple(panels)) for offset, panels in eyes.items())
