"""Pose tracks of the procedural movers: closed curves at constant speed, wheels that roll, joints that swing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from stimuli.camera_path import KeyedCamera
from stimuli.scene import PoseTrack

Curve = Callable[[np.ndarray], Sequence[np.ndarray | float]]


@dataclass(frozen=True)
class CurveTrack:
    """Round a smooth curve through ``points`` (P, 3) at constant speed, -z ahead, +y up; a round takes ``period_s``."""

    points: np.ndarray
    period_s: float

    @cached_property
    def _spline(self) -> CubicSpline:
        closed = np.concatenate([self.points, self.points[:1]])
        chord = np.linalg.norm(np.diff(closed, axis=0), axis=1)
        return CubicSpline(np.concatenate([[0.0], np.cumsum(chord)]), closed, bc_type="periodic")

    @cached_property
    def _arc(self) -> tuple[np.ndarray, np.ndarray]:
        """Parameter values and the arc length up to each of them."""
        at = np.linspace(0.0, float(self._spline.x[-1]), 4097)
        speed = np.linalg.norm(self._spline(at, 1), axis=1)
        return at, np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2.0 * np.diff(at))])

    @property
    def length_m(self) -> float:
        """Length of one round."""
        return float(self._arc[1][-1])

    def distance_m(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) metres driven since time 0."""
        return np.atleast_1d(np.asarray(time_s, np.float64)) / self.period_s * self.length_m

    def _parameter(self, time_s: np.ndarray) -> np.ndarray:
        at, arc = self._arc
        return np.interp(np.mod(self.distance_m(time_s), self.length_m), arc, at)

    def curvature_per_m(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) horizontal curvature, positive to the left."""
        u = self._parameter(time_s)
        first, second = self._spline(u, 1), self._spline(u, 2)
        turn = first[:, 2] * second[:, 0] - first[:, 0] * second[:, 2]
        return np.asarray(turn / np.hypot(first[:, 0], first[:, 2]) ** 3)

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) -> (T, 4, 4)."""
        u = self._parameter(time_s)
        ahead = self._spline(u, 1)
        back = -ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        # right = +y x back, up = back x right; written out, as np.cross took a third of the time
        level = np.hypot(back[:, 0], back[:, 2])
        right_x, right_z = back[:, 2] / level, -back[:, 0] / level
        result = np.tile(np.eye(4), (u.size, 1, 1))
        result[:, 0, 0], result[:, 2, 0], result[:, :3, 2] = right_x, right_z, back
        result[:, 0, 1], result[:, 2, 1] = back[:, 1] * right_z, -back[:, 1] * right_x
        result[:, 1, 1] = back[:, 2] * right_x - back[:, 0] * right_z
        result[:, :3, 3] = self._spline(u)
        return result


@dataclass(frozen=True)
class WheelTrack:
    """A wheel at ``offset`` on a car: rolls about its x axis as the car drives, steers where ``wheelbase_m`` > 0."""

    car: CurveTrack
    offset: tuple[float, float, float]
    radius_m: float
    wheelbase_m: float = 0.0

    @property
    def carrier(self) -> CurveTrack:
        """The car."""
        return self.car

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) -> (T, 4, 4)."""
        return self.pose_on(self.car.pose(time_s), time_s)

    def pose_on(self, carrier_pose: np.ndarray, time_s: np.ndarray) -> np.ndarray:
        """(T, 4, 4) of the car at (T,) times -> (T, 4, 4) of the wheel."""
        roll = -self.car.distance_m(time_s) / self.radius_m
        steer = np.zeros(roll.size)
        if self.wheelbase_m:
            steer = np.arctan(self.wheelbase_m * self.car.curvature_per_m(time_s))
        place = np.tile(np.eye(4), (roll.size, 1, 1))
        place[:, :3, 3] = self.offset
        return carrier_pose @ place @ turn_matrices(1, steer) @ turn_matrices(0, roll)


@dataclass(frozen=True)
class SwingTrack:
    """A joint at ``offset`` in its parent: about a main axis by bias + amplitude sin(2 pi t / period + phase)."""

    parent: PoseTrack
    offset: tuple[float, float, float]
    axis: int
    amplitude_rad: float
    period_s: float
    phase_rad: float = 0.0
    bias_rad: float = 0.0

    @property
    def carrier(self) -> PoseTrack:
        """What the joint is part of."""
        return self.parent

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) -> (T, 4, 4)."""
        return self.pose_on(self.parent.pose(time_s), time_s)

    def pose_on(self, carrier_pose: np.ndarray, time_s: np.ndarray) -> np.ndarray:
        """(T, 4, 4) of the parent at (T,) times -> (T, 4, 4) of the joint."""
        time_s = np.atleast_1d(np.asarray(time_s, np.float64))
        angle = self.bias_rad + self.amplitude_rad * np.sin(2.0 * np.pi * time_s / self.period_s + self.phase_rad)
        place = np.tile(np.eye(4), (time_s.size, 1, 1))
        place[:, :3, 3] = self.offset
        return carrier_pose @ place @ turn_matrices(self.axis, angle)


def turn_matrices(axis: int, angle_rad: np.ndarray) -> np.ndarray:
    """(T, 4, 4) rotations about a main axis."""
    result = np.tile(np.eye(4), (angle_rad.size, 1, 1))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    result[:, a, a], result[:, a, b], result[:, b, a], result[:, b, b] = cosine, -sine, sine, cosine
    return result


def round_trip(name: str, duration_s: float, yfov_deg: float, eyes: Curve, aims: Curve) -> KeyedCamera:
    """A camera that comes back after ``duration_s``: nine keys of where it stands and what it looks at, each x, y and z
    (or a number) of an angle that goes once round."""
    times = np.linspace(0.0, duration_s, 9)
    angle = 2 * np.pi * times / duration_s
    places, targets = (np.stack(np.broadcast_arrays(angle, *curve(angle))[1:], axis=1) for curve in (eyes, aims))
    return KeyedCamera.looking(times, places, targets, float(np.radians(yfov_deg)), name, closed=True)
