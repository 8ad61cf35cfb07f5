"""Where a point of the screen lies for the eye: normalised screen coordinates <-> degrees of visual angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class ScreenGeometry:
    """A flat screen seen from its middle axis. Normalised coordinates: (0, 0) top left, (1, 1) bottom right."""

    width_m: float
    height_m: float
    distance_m: float
    size_px: tuple[int, int] = (1920, 1080)

    def to_dva(self, x: ArrayLike, y: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Azimuth to the right and elevation up (degrees) of the eye direction to normalised (x, y)."""
        right_m = (np.asarray(x, float) - 0.5) * self.width_m
        up_m = (0.5 - np.asarray(y, float)) * self.height_m
        azimuth = np.arctan2(right_m, self.distance_m)
        elevation = np.arctan2(up_m, np.hypot(right_m, self.distance_m))
        return np.degrees(azimuth), np.degrees(elevation)

    def from_dva(self, x_dva: ArrayLike, y_dva: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """The inverse of `to_dva`, for directions within 90 degrees of the screen."""
        right_m = np.tan(np.radians(x_dva)) * self.distance_m
        up_m = np.tan(np.radians(y_dva)) * np.hypot(right_m, self.distance_m)
        return right_m / self.width_m + 0.5, 0.5 - up_m / self.height_m


def separation_dva(ax: ArrayLike, ay: ArrayLike, bx: ArrayLike, by: ArrayLike) -> np.ndarray:
    """Angle (degrees) between two eye directions given as azimuth and elevation, by the haversine formula."""
    x1, y1, x2, y2 = (np.radians(np.asarray(angle, float)) for angle in (ax, ay, bx, by))
    half = np.sin((y2 - y1) / 2) ** 2 + np.cos(y1) * np.cos(y2) * np.sin((x2 - x1) / 2) ** 2
    return np.degrees(2 * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0))))
