"""Camera paths: the file's own, still, sway, toycar, interactive, and keyed splines read from a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from stimuli.clip_request import PATH_NAMES
from stimuli.errors import InputError, problem
from stimuli.gltf_animation import compose, slerp, unit
from stimuli.interactive_path import interactive_keys
from stimuli.light_files import look_at
from stimuli.scene import CameraPath, Mover, Scene, StillCamera

PATH_VERSION = 2
"""Raised by hand whenever a named path would move the camera in another way."""
SWAY_PERIOD_S = 4.0
_SWAY_SHARE = 0.02
_SWAY_TURN_RAD = float(np.radians(10.0))
Interpolation = Literal["spline", "linear"]


@dataclass(frozen=True)
class KeyedCamera:
    """A camera through keys: ``times_s`` (K,) increasing, ``positions`` (K, 3), ``quaternions`` (K, 4) xyzw.

    spline: cubic splines (twice continuously differentiable) of position and of the quaternion, made unit afterwards;
    linear: straight lines and slerp. ``closed``: the last key stands where the first does and the path repeats; else
    the end values hold.
    """

    times_s: np.ndarray
    positions: np.ndarray
    quaternions: np.ndarray
    yfov_rad: float
    name: str = "keyed"
    closed: bool = False
    interpolation: Interpolation = "spline"

    @classmethod
    def looking(
        cls,
        times_s: np.ndarray,
        eyes: np.ndarray,
        aims: np.ndarray,
        yfov_rad: float,
        name: str = "keyed",
        closed: bool = False,
    ) -> KeyedCamera:
        """Keys from where the camera stands (K, 3) and what it looks at (K, 3), +y up."""
        up = np.array([0.0, 1.0, 0.0])
        turns = np.stack([look_at(eye, aim, up)[:3, :3] for eye, aim in zip(eyes, aims, strict=True)])
        return cls(times_s, eyes, Rotation.from_matrix(turns).as_quat(), yfov_rad, name, closed)

    @cached_property
    def _aligned(self) -> np.ndarray:
        """Quaternions with signs such that neighbours lie on the same side."""
        q = unit(np.asarray(self.quaternions, np.float64))
        flip = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
        return np.concatenate([q[:1], q[1:] * flip[:, None]])

    @cached_property
    def _splines(self) -> tuple[CubicSpline, CubicSpline]:
        times, q = np.asarray(self.times_s, np.float64), self._aligned
        p = np.asarray(self.positions, np.float64)
        if not self.closed:
            ends: Any = "natural" if len(times) > 2 else "clamped"
            return CubicSpline(times, p, bc_type=ends), CubicSpline(times, q, bc_type=ends)
        p = np.concatenate([p[:-1], p[:1]])
        # After a full turn the same orientation may come back with the other sign: then two rounds make the period.
        sign = -1.0 if np.dot(q[0], q[-1]) < 0.0 else 1.0
        rounds = np.concatenate([q[:-1], sign * q[:-1], q[:1]])
        twice = np.concatenate([times[:-1], times + (times[-1] - times[0])])
        return CubicSpline(times, p, bc_type="periodic"), CubicSpline(twice, rounds, bc_type="periodic")

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) scene seconds -> (T, 4, 4) rigid camera-to-world matrices."""
        time_s = np.atleast_1d(np.asarray(time_s, np.float64))
        first, last = float(self.times_s[0]), float(self.times_s[-1])
        if len(self.times_s) == 1:
            return np.repeat(
                compose(np.asarray(self.positions, np.float64), self._aligned, np.ones((1, 3))), time_s.size, 0
            )
        at = first + np.mod(time_s - first, last - first) if self.closed else np.clip(time_s, first, last)
        if self.interpolation == "linear":
            low = np.clip(np.searchsorted(self.times_s, at, side="right") - 1, 0, len(self.times_s) - 2)
            share = (at - self.times_s[low]) / (self.times_s[low + 1] - self.times_s[low])
            place = self.positions[low] + (self.positions[low + 1] - self.positions[low]) * share[:, None]
            turn = slerp(self._aligned[low], self._aligned[low + 1], share)
        else:
            along, around = self._splines
            place, turn = along(at), unit(around(at))
        return compose(place, turn, np.ones((time_s.size, 3)))


@dataclass(frozen=True)
class SwayCamera:
    """``base``'s pose at time 0 on a horizontal ellipse (half axes ``reach_m`` and half), turning by 10 degrees."""

    base: np.ndarray
    yfov_rad: float
    reach_m: float
    name: str = "sway"
    period_s: float = SWAY_PERIOD_S

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) -> (T, 4, 4); at time 0 it stands at the ellipse's right end and looks straight ahead."""
        phase = 2.0 * np.pi * np.atleast_1d(np.asarray(time_s, np.float64)) / self.period_s
        forward = -self.base[:3, 2] * np.array([1.0, 0.0, 1.0])
        if np.linalg.norm(forward) < 1e-6:
            forward = self.base[:3, 1] * np.array([1.0, 0.0, 1.0])
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 1.0, 0.0))
        turn = Rotation.from_rotvec(np.outer(_SWAY_TURN_RAD * np.sin(phase), (0.0, 1.0, 0.0))).as_matrix()
        result = np.tile(np.eye(4), (phase.size, 1, 1))
        result[:, :3, :3] = turn @ self.base[:3, :3]
        shift = np.outer(np.cos(phase), right) + 0.5 * np.outer(np.sin(phase), forward)
        result[:, :3, 3] = self.base[:3, 3] + self.reach_m * shift
        return result


def camera_path(scene: Scene, name_or_file: str | Path) -> CameraPath:
    """The camera called ``name_or_file``: one of `PATH_NAMES`, or a YAML or JSON file of keys (`read_camera_path`).

    file: the scene's own. still: its pose at time 0. sway: see `SwayCamera`. toycar: the side file's view position (the
    file's camera where there is none) aimed at the mean position of the mover called like a car, else of all movers.
    interactive: a synthetic visitor who looks round and steps about, with pauses, clear of all surfaces (stands in for
    a recorded hand; see `stimuli.interactive_path`).
    """
    name = str(name_or_file)
    if name not in PATH_NAMES:
        return read_camera_path(Path(name_or_file), scene.camera.yfov_rad)
    if name == "file":
        return scene.camera
    start = scene.camera.pose(np.zeros(1))[0]
    if name == "still":
        return StillCamera(start, scene.camera.yfov_rad)
    if name == "sway":
        return SwayCamera(start, scene.camera.yfov_rad, _SWAY_SHARE * scene_radius(scene))
    if name == "toycar":
        return _toycar(scene)
    times_s, places, turns = interactive_keys(scene, start, _SWAY_SHARE * scene_radius(scene))
    return KeyedCamera(times_s, places, turns, scene.camera.yfov_rad, "interactive", interpolation="linear")


def chosen_path(scene: Scene, name_or_file: str | Path | None) -> CameraPath:
    """`camera_path`; where nothing was chosen, the file's own for a scene that moves, else one that sways, so that a
    technique with a memory is seen in motion."""
    return camera_path(scene, name_or_file or ("file" if scene.duration_s > 0 else "sway"))


def camera_path_sha256(name_or_file: str | Path) -> str:
    """The identity of a path: a file's bytes, or a name with `PATH_VERSION` (the scene's own identity stands apart)."""
    name = str(name_or_file)
    if name in PATH_NAMES:
        return hashlib.sha256(f"camera path {name} {PATH_VERSION}".encode()).hexdigest()
    return hashlib.sha256(_read_bytes(Path(name_or_file))).hexdigest()


def scene_radius(scene: Scene) -> float:
    """Half the diagonal of the box round everything at time 0."""
    from stimuli.load import bounding_sphere

    return bounding_sphere(scene.static, scene.movers)[1]


def read_camera_path(file: Path, yfov_rad: float) -> KeyedCamera:
    """Keys from YAML or JSON: ``keys``, a list of {time_s, position, and rotation (xyzw) or look_at [and up]}.

    Optional: ``yfov_deg`` (default: ``yfov_rad``), ``closed`` (the first key comes back after the last; give
    ``period_s``), ``interpolation`` (spline or linear). InputError, every problem at once.
    """
    data = _read_bytes(file)
    try:
        tree = YAML(typ="safe", pure=True).load(data.decode())
    except (YAMLError, UnicodeDecodeError) as error:
        raise InputError(problem(file, "camera path", " ".join(str(error).split())[:160], "YAML or JSON")) from error
    if not isinstance(tree, dict):
        raise InputError(problem(file, "camera path", type(tree).__name__, "a mapping with keys"))
    problems: list[str] = []
    known = {"keys", "yfov_deg", "closed", "interpolation", "period_s", "name"}
    problems += [
        problem(file, "entry", repr(key), f"one of {', '.join(sorted(known))}") for key in tree if key not in known
    ]
    entries = tree.get("keys")
    if not isinstance(entries, list) or not entries:
        raise InputError(*problems, problem(file, "keys", entries, "a list of at least one key"))
    times: list[float] = []
    places: list[np.ndarray] = []
    turns: list[np.ndarray] = []
    for number, entry in enumerate(entries):
        where = f"{file}: key {number}"
        before = len(problems)
        time = entry.get("time_s") if isinstance(entry, dict) else None
        if not isinstance(time, (int, float)) or not np.isfinite(time):
            problems.append(problem(where, "time_s", time, "finite seconds"))
        elif times and time <= times[-1]:
            problems.append(problem(where, "time_s", time, f"later than {times[-1]}"))
        place = _vector(entry, "position", 3, where, problems)
        turn = _orientation(entry, place, where, problems)
        if time is not None and place is not None and turn is not None and len(problems) == before:
            times.append(float(time))
            places.append(place)
            turns.append(turn)
    yfov: Any = tree.get("yfov_deg", np.degrees(yfov_rad))
    if not isinstance(yfov, (int, float)) or not 0.0 < yfov < 180.0:
        problems.append(problem(file, "yfov_deg", yfov, "degrees between 0 and 180"))
    interpolation = tree.get("interpolation", "spline")
    if interpolation not in ("spline", "linear"):
        problems.append(problem(file, "interpolation", interpolation, "spline | linear"))
    closed = tree.get("closed", False)
    if closed is True:
        period = tree.get("period_s")
        if not isinstance(period, (int, float)) or (times and not times[0] + period > times[-1]):
            problems.append(
                problem(file, "period_s", period, "seconds from the first key to its return, after the last key")
            )
        elif times:
            times, places, turns = [*times, times[0] + float(period)], [*places, places[0]], [*turns, turns[0]]
    if problems:
        raise InputError(*problems)
    return KeyedCamera(
        np.array(times),
        np.array(places),
        np.array(turns),
        float(np.radians(yfov)),
        file.stem,
        bool(closed),
        interpolation,
    )


def write_camera_path(file: Path, camera: CameraPath, times_s: Sequence[float] | np.ndarray) -> None:
    """Record ``camera`` at ``times_s`` as a file for `read_camera_path` (straight lines between the keys)."""
    matrices = camera.pose(np.asarray(times_s, np.float64))
    turns = Rotation.from_matrix(matrices[:, :3, :3]).as_quat()
    keys = [
        {"time_s": float(t), "position": [float(x) for x in m[:3, 3]], "rotation": [float(x) for x in q]}
        for t, m, q in zip(times_s, matrices, turns, strict=True)
    ]
    tree = {"yfov_deg": float(np.degrees(camera.yfov_rad)), "interpolation": "linear", "keys": keys}
    file.write_text(json.dumps(tree, indent=1) + "\n")


def _toycar(scene: Scene) -> StillCamera:
    cars = [mover for mover in scene.movers if "car" in mover.name.lower()] or list(scene.movers)
    if not cars:
        raise InputError(
            problem(scene.name, "path 'toycar'", "a scene where nothing moves", "a scene with a moving car")
        )
    source = scene.view or scene.camera
    eye = source.pose(np.zeros(1))[0][:3, 3]
    times = np.linspace(0.0, scene.duration_s, 241)
    target = np.mean([np.mean(_centre_over_time(car, times), axis=0) for car in cars], axis=0)
    return StillCamera(look_at(eye, target, np.array([0.0, 1.0, 0.0])), source.yfov_rad, "toycar")


def _centre_over_time(mover: Mover, times_s: np.ndarray) -> np.ndarray:
    """(T, 3) world positions of the middle of the mover's vertices."""
    local = np.concatenate([p.positions @ p.matrix[:3, :3].T + p.matrix[:3, 3] for p in mover.parts])
    centre = np.append((local.min(axis=0) + local.max(axis=0)) / 2.0, 1.0)
    centres: np.ndarray = (mover.track.pose(times_s) @ centre)[:, :3]
    return centres


def _orientation(entry: Any, place: np.ndarray | None, where: str, problems: list[str]) -> np.ndarray | None:
    if isinstance(entry, dict) and "look_at" in entry:
        target = _vector(entry, "look_at", 3, where, problems)
        up = _vector({"up": entry.get("up", [0.0, 1.0, 0.0])}, "up", 3, where, problems)
        if target is None or up is None or place is None:
            return None
        if np.allclose(target, place):
            problems.append(problem(where, "look_at", entry["look_at"], "another point than position"))
            return None
        turn: np.ndarray = Rotation.from_matrix(look_at(place, target, up)[:3, :3]).as_quat()
        return turn
    quaternion = _vector(entry, "rotation", 4, where, problems)
    if quaternion is not None and np.linalg.norm(quaternion) < 1e-6:
        problems.append(problem(where, "rotation", entry["rotation"], "a quaternion x, y, z, w that is not zero"))
    return quaternion


def _vector(entry: Any, key: str, count: int, where: str, problems: list[str]) -> np.ndarray | None:
    value = entry.get(key) if isinstance(entry, dict) else None
    good = isinstance(value, list) and len(value) == count
    if not good or not all(isinstance(x, (int, float)) and np.isfinite(x) for x in value or []):
        problems.append(problem(where, key, value, f"{count} finite numbers"))
        return None
    return np.array(value, np.float64)


def _read_bytes(file: Path) -> bytes:
    try:
        there = file.is_file()
    except OSError:  # a name that the file system does not take
        there = False
    if not there:
        raise InputError(problem(file, "camera path", "no such file or name", f"a file, or {' | '.join(PATH_NAMES)}"))
    return file.read_bytes()
