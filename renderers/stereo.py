"""Headsets: cameras of a field of their own beside the middle, and the viewports that techniques show to both eyes.

Both eyes share the pose, the gaze and the engine; each has its own history.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from renderers.catalogue import CATALOGUE
from renderers.technique import Viewport
from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath


def xfov_rad(yfov_rad: float, size_px: tuple[int, int]) -> float:
    """Horizontal field of a picture of square pixels with the vertical field ``yfov_rad``."""
    return 2 * math.atan(math.tan(yfov_rad / 2) * size_px[0] / size_px[1])


def field_words(yfov_rad: float, size_px: tuple[int, int]) -> str:
    """The field of a picture in whole degrees, across by up and down."""
    return f"{math.degrees(xfov_rad(yfov_rad, size_px)):.0f} x {math.degrees(yfov_rad):.0f} degrees"


@dataclass(frozen=True)
class EyeCamera:
    """``path`` with another vertical field, moved ``right_m`` along its own x axis (world units)."""

    path: CameraPath
    yfov_rad: float
    right_m: float = 0.0
    name: str = "eye"

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T, 4, 4) camera-to-world."""
        poses = np.array(self.path.pose(time_s), np.float64)
        poses[:, :3, 3] += self.right_m * poses[:, :3, 0]
        return poses


@dataclass(frozen=True)
class Headset:
    """What a headset shows to each eye: pixels, vertical field (square pixels), distance between the eyes."""

    name: str
    size_px: tuple[int, int]
    yfov_rad: float
    eyes_apart_m: float

    @property
    def xfov_rad(self) -> float:
        """Horizontal field."""
        return xfov_rad(self.yfov_rad, self.size_px)

    def eyes(self, path: CameraPath) -> tuple[EyeCamera, EyeCamera]:
        """The left and the right eye's camera on ``path``."""
        half = self.eyes_apart_m / 2
        return tuple(  # type: ignore[return-value]
            EyeCamera(path, self.yfov_rad, offset, f"{self.name} {side}")
            for side, offset in (("left", -half), ("right", half))
        )

    def viewports(self, scale: float = 1.0) -> tuple[Viewport, Viewport]:
        """Both eyes as viewports, each side of ``scale`` times as many pixels."""
        size = (max(1, round(self.size_px[0] * scale)), max(1, round(self.size_px[1] * scale)))
        half = self.eyes_apart_m / 2
        return Viewport("left", size, self.yfov_rad, -half), Viewport("right", size, self.yfov_rad, half)


OCULUS_DK2 = Headset("oculus_dk2", (1182, 1464), math.radians(106), 0.064)
"""As in Weier et al. 2016: 1182x1464 px an eye, a field of 94 x 106 degrees."""
HERR_PANELS = (("inset", 40.0, 60.0), ("surround", 90.0, 22.0))
"""As in Peuhkurinen and Mikkonen 2021: name, field (degrees) and pixels per degree of what each eye sees."""


def herr_viewports(scale: float = 1.0, eyes_apart_m: float = OCULUS_DK2.eyes_apart_m) -> tuple[Viewport, ...]:
    """`HERR_PANELS` of both eyes, about the camera's axis, with ``scale`` times the pixels per degree."""

    def pixels(field_deg: float, ppd: float) -> int:
        return max(1, round(2 * math.tan(math.radians(field_deg / 2)) * math.degrees(ppd * scale)))

    return tuple(
        Viewport(f"{side} {name}", (pixels(field, ppd),) * 2, math.radians(field), offset)
        for side, offset in (("left", -eyes_apart_m / 2), ("right", eyes_apart_m / 2))
        for name, field, ppd in HERR_PANELS
    )


DEFAULT_SCALE = {"foveated": 1.0, "polar": 0.25}
"""Of the headset's pixels along each side, where nothing else is asked for: HERR's are 25 million."""


def headset_viewports(technique: str, scale: float = 1.0) -> tuple[Viewport, ...]:
    """What ``technique`` shows in the headset of its paper; ``scale``, of the pixels along each side.

    Raises InputError for a technique without a headset view, and for a scale that is not in (0, 1].
    """
    able = [name for name, known in CATALOGUE.items() if known.headset]
    if technique not in able:
        raise InputError(problem("view", "technique", f"headset of {technique}", f"headset of {' | '.join(able)}"))
    if not 0 < scale <= 1:
        raise InputError(problem("view", "scale of the headset's pixels", scale, "above 0, at most 1"))
    return herr_viewports(scale) if technique == "polar" else OCULUS_DK2.viewports(scale)


def with_field(path: CameraPath, yfov_rad: float) -> EyeCamera:
    """``path`` seen with another vertical field. Raises InputError for one not in (0, pi)."""
    if not 0 < yfov_rad < math.pi:
        raise InputError(problem("camera", "vertical field of view", yfov_rad, "0 to pi rad, both excluded"))
    return EyeCamera(path, yfov_rad, 0.0, path.name)
