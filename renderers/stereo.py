"""Cameras for headsets: a field of its own, and an eye beside the middle. An eye is one technique and one `View`.

Both eyes share the pose, the gaze and the engine; each has its own technique instance, hence its own history.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath


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
        return 2 * math.atan(math.tan(self.yfov_rad / 2) * self.size_px[0] / self.size_px[1])

    def eyes(self, path: CameraPath) -> tuple[EyeCamera, EyeCamera]:
        """The left and the right eye's camera on ``path``."""
        half = self.eyes_apart_m / 2
        return tuple(  # type: ignore[return-value]
            EyeCamera(path, self.yfov_rad, offset, f"{self.name} {side}")
            for side, offset in (("left", -half), ("right", half))
        )


OCULUS_DK2 = Headset("oculus_dk2", (1182, 1464), math.radians(106), 0.064)
"""As in Weier et al. 2016: 1182x1464 px an eye, a field of 94 x 106 degrees."""


def with_field(path: CameraPath, yfov_rad: float) -> EyeCamera:
    """``path`` seen with another vertical field. Raises InputError for one not in (0, pi)."""
    if not 0 < yfov_rad < math.pi:
        raise InputError(problem("camera", "vertical field of view", yfov_rad, "0 to pi rad, both excluded"))
    return EyeCamera(path, yfov_rad, 0.0, path.name)
