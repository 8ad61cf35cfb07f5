"""What is given up while the head moves: buffer width (HERR, 3.2) and samples of the area light (3.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from renderers.parameters import Polar
from renderers.technique import View

SOFTEST, SOFT, HARD = 256, 64, 1
"""Samples of an area light in HERR's three settings (4.1)."""


@dataclass(frozen=True)
class PoseDelta:
    """How fast the camera moves over a refresh: turning, and its way relative to the scene's radius, degrees/s."""

    turning_deg_s: float
    moving_deg_s: float

    @property
    def speed_deg_s(self) -> float:
        """Both together."""
        return self.turning_deg_s + self.moving_deg_s


def pose_delta(view: View, scene_radius: float) -> PoseDelta:
    """The camera's speed over the view's interval; ``scene_radius`` in world units."""
    before, now = np.asarray(view.camera.pose(np.array([float(view.t0), float(view.t1)])), np.float64)
    seconds = float(view.t1 - view.t0)
    axes = [m[:3, :3] / np.linalg.norm(m[:3, :3], axis=0) for m in (before, now)]
    turn = axes[0].T @ axes[1]
    # atan2 of the rotation's antisymmetric part: exact for the small angles of one refresh, where acos is not.
    twist = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = math.atan2(float(np.linalg.norm(twist)), float(np.trace(turn)) - 1)
    way = float(np.linalg.norm(now[:3, 3] - before[:3, 3])) / max(scene_radius, 1e-12)
    return PoseDelta(math.degrees(angle) / seconds, math.degrees(way) / seconds)


def light_samples(params: Polar, delta: PoseDelta) -> int:
    """Shadow rays for each area light in this refresh."""
    if params.quality != "by_pose":
        return params.quality
    if delta.speed_deg_s < params.still_deg_s:
        return SOFTEST
    return SOFT if delta.speed_deg_s < params.fast_deg_s else HARD
