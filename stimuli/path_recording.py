"""A camera steered by hand, and its path as keyframes at a fixed rate. Pure: a window (or a test) gives the steering.

The steered camera never rolls, so a key is a place and a point looked at, which can be edited in the file by hand.
Steering is smoothed (first-order lags, integrated exactly a fixed number of steps a key), so that a spline through a
few keys a second follows what was flown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from stimuli.camera_path import scene_radius
from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath, Scene

STEPS_A_KEY = 16
MOST_KEYS = 700
"""As many as a protocol's reader takes in one file of keys."""
MOVE_LAG_S, LOOK_LAG_S = 0.15, 0.08
RADII_A_SECOND = 0.25
FAST = 4.0
_STEEPEST_RAD = math.radians(85.0)


@dataclass(frozen=True)
class Steering:
    """What the hand does now. ``move``: right, up, forward, each -1 to 1; ``turn_rad``: right, up, since the last time;
    ``fast``: as if with seven-league boots; ``record``: begin recording (it goes on until the window ends)."""

    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_rad: tuple[float, float] = (0.0, 0.0)
    fast: bool = False
    record: bool = False


class FlightWindow(Protocol):
    """Where somebody flies: `studyapp.flight_window`, or a test's script."""

    def now_s(self) -> float:
        """A clock that only goes forward."""
        ...

    def steering(self) -> Steering | None:
        """The hand's doing since the last call; None: Escape was pressed, or the window was closed."""
        ...

    def show(self, pose: np.ndarray, time_s: float, recorded_s: float | None) -> None:
        """Draw the scene at ``time_s`` from ``pose`` (4, 4); ``recorded_s``: seconds recorded so far, None: not yet."""
        ...


@dataclass
class FlyCamera:
    """A camera with a heading and a pitch over +y, that follows the steering with a lag.

    ``heading_rad`` turns left about +y from -z, ``pitch_rad`` up; ``speed`` in world units a second.
    """

    position: np.ndarray
    heading_rad: float
    pitch_rad: float
    speed: float
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    wanted_rad: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def beginning_at(cls, pose: np.ndarray, speed: float) -> FlyCamera:
        """At the place of ``pose`` (4, 4), looking its way (its roll is dropped)."""
        forward = -np.asarray(pose, np.float64)[:3, 2]
        level = math.hypot(forward[0], forward[2])
        along = forward if level > 1e-6 else -math.copysign(1.0, forward[1]) * np.asarray(pose, np.float64)[:3, 1]
        heading = math.atan2(-along[0], -along[2])
        pitch = float(np.clip(math.atan2(forward[1], level), -_STEEPEST_RAD, _STEEPEST_RAD))
        return cls(np.array(pose[:3, 3], np.float64), heading, pitch, speed, wanted_rad=(heading, pitch))

    def turn(self, right_rad: float, up_rad: float) -> None:
        """Ask for another direction; `step` follows."""
        heading, pitch = self.wanted_rad
        self.wanted_rad = heading - right_rad, float(np.clip(pitch + up_rad, -_STEEPEST_RAD, _STEEPEST_RAD))

    def step(self, seconds: float, steering: Steering) -> None:
        """Move on by ``seconds`` under a steering that stays."""
        look = 1.0 - math.exp(-seconds / LOOK_LAG_S)
        self.heading_rad += look * (self.wanted_rad[0] - self.heading_rad)
        self.pitch_rad += look * (self.wanted_rad[1] - self.pitch_rad)
        right, up, ahead = (float(np.clip(part, -1.0, 1.0)) for part in steering.move)
        sine, cosine = math.sin(self.heading_rad), math.cos(self.heading_rad)
        wanted = np.array([right * cosine, 0.0, -right * sine]) + ahead * self.forward + np.array([0.0, up, 0.0])
        wanted *= self.speed * (FAST if steering.fast else 1.0) / max(1.0, float(np.linalg.norm(wanted)))
        fade = math.exp(-seconds / MOVE_LAG_S)
        self.position = self.position + wanted * seconds + (self.velocity - wanted) * MOVE_LAG_S * (1.0 - fade)
        self.velocity = wanted + (self.velocity - wanted) * fade

    @property
    def forward(self) -> np.ndarray:
        """(3,) unit vector of the viewing direction."""
        level = math.cos(self.pitch_rad)
        return np.array(
            [-math.sin(self.heading_rad) * level, math.sin(self.pitch_rad), -math.cos(self.heading_rad) * level]
        )

    def pose(self) -> np.ndarray:
        """(4, 4) camera-to-world."""
        back = -self.forward
        right = np.array([math.cos(self.heading_rad), 0.0, -math.sin(self.heading_rad)])
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, self.position
        return pose


@dataclass(frozen=True)
class PathKey:
    """One key: where the camera is at ``time_s`` (scene seconds), and a point that it looks at."""

    time_s: float
    position: np.ndarray
    look_at: np.ndarray


def fly(
    scene: Scene, start: CameraPath, window: FlightWindow, rate_hz: float = 20.0, start_s: float = 0.0,
    most_keys: int = MOST_KEYS,
) -> list[PathKey]:  # fmt: skip
    """Let somebody fly through ``scene`` from where ``start`` is at ``start_s``; the keys of what was recorded.

    Key k stands for ``start_s + k / rate_hz``, however unevenly the window asks. Recording begins when the steering
    says so (the scene rests until then) and ends with the window's end or after ``most_keys``. InputError for a rate
    that is not above 0.
    """
    if not (math.isfinite(rate_hz) and 0.0 < rate_hz <= 240.0):
        raise InputError(problem("recording", "keys a second", rate_hz, "above 0, at most 240"))
    radius = scene_radius(scene)
    camera = FlyCamera.beginning_at(start.pose(np.array([start_s]))[0], RADII_A_SECOND * radius)
    step_s = 1.0 / (rate_hz * STEPS_A_KEY)
    keys: list[PathKey] = []
    began, done, recording = window.now_s(), 0, False
    while (steering := window.steering()) is not None:
        if steering.record and not recording:
            recording, began, done = True, window.now_s(), 0
            keys.append(_key(camera, start_s, radius))
        camera.turn(*steering.turn_rad)
        while done < math.floor((window.now_s() - began) / step_s) and len(keys) < most_keys:
            camera.step(step_s, steering)
            done += 1
            if recording and done % STEPS_A_KEY == 0:
                keys.append(_key(camera, start_s + len(keys) / rate_hz, radius))
        if len(keys) >= most_keys:
            break
        at_s = start_s + (done * step_s if recording else 0.0)
        window.show(camera.pose(), at_s, done * step_s if recording else None)
    return keys


def _key(camera: FlyCamera, time_s: float, radius: float) -> PathKey:
    return PathKey(time_s, camera.position.copy(), camera.position + camera.forward * radius)


def write_path_keys(file: Path, keys: Sequence[PathKey], yfov_rad: float, about: str) -> None:
    """Keys as YAML for `read_camera_path` and for a protocol's ``paths``, a line each; ``about`` is its first comment.

    Numbers have nine significant digits. InputError where there is no key.
    """
    if not keys:
        raise InputError(problem(file, "camera path", "nothing recorded", "at least one key (Space begins)"))

    def numbers(values: np.ndarray) -> str:
        return "[" + ", ".join(f"{float(value):.9g}" for value in values) + "]"

    lines = [f"# {line}" for line in about.splitlines()]
    lines += [f"yfov_deg: {math.degrees(yfov_rad):.9g}", "interpolation: spline", "keys:"]
    lines += [
        f"  - {{time_s: {key.time_s:.9g}, position: {numbers(key.position)}, look_at: {numbers(key.look_at)}}}"
        for key in keys
    ]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
