"""Node animation: key tracks sampled in float64, and the poses of many animated nodes at once.

Source: glTF 2.0 specification, 3.11 (animations) and Appendix C (interpolation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

Interpolation = Literal["LINEAR", "STEP", "CUBICSPLINE"]
TargetPath = Literal["translation", "rotation", "scale"]


def slerp(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Shortest-way spherical interpolation of unit quaternions (..., 4) xyzw at ``share`` (...) in [0, 1]."""
    cosine = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(cosine < 0.0, -b, b)
    # atan2 keeps full precision for angles near 0, where acos loses half the digits.
    angle = 2.0 * np.arctan2(
        np.linalg.norm(b - a, axis=-1, keepdims=True), np.linalg.norm(b + a, axis=-1, keepdims=True)
    )
    share = share[..., None]
    sine = np.sin(angle)
    near = sine < 1e-12
    safe = np.where(near, 1.0, sine)
    mixed = np.where(
        near,
        (1.0 - share) * a + share * b,
        (np.sin((1.0 - share) * angle) * a + np.sin(share * angle) * b) / safe,
    )
    return unit(mixed)


def unit(quaternion: np.ndarray) -> np.ndarray:
    """``quaternion`` (..., 4) scaled to length 1; a zero one becomes the identity."""
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    return np.where(length > 0.0, quaternion / np.where(length > 0.0, length, 1.0), identity)


def sample_keys(
    times_s: np.ndarray, values: np.ndarray, kind: Interpolation, at_s: np.ndarray, rotation: bool
) -> np.ndarray:
    """Values of C tracks that share their key times, at T moments.

    ``times_s`` (K,) increasing; ``values`` (C, K, D), for CUBICSPLINE (C, K, 3, D) as in-tangent, value, out-tangent;
    ``at_s`` (T,). Returns (C, T, D) float64; outside the keys the end value holds. ``rotation``: unit quaternions.
    """
    at_s = np.asarray(at_s, np.float64)
    points = values[:, :, 1] if kind == "CUBICSPLINE" else values
    if len(times_s) == 1:
        held = np.repeat(points[:, :1], at_s.size, axis=1)
        return unit(held) if rotation else held
    low = np.clip(np.searchsorted(times_s, at_s, side="right") - 1, 0, len(times_s) - 2)
    step = times_s[low + 1] - times_s[low]
    share = np.clip((at_s - times_s[low]) / np.where(step > 0.0, step, 1.0), 0.0, 1.0)
    a, b = points[:, low], points[:, low + 1]
    if kind == "STEP":
        result = np.where((share >= 1.0)[None, :, None], b, a)
    elif kind == "LINEAR" and rotation:
        return slerp(unit(a), unit(b), np.broadcast_to(share, a.shape[:2]))
    elif kind == "LINEAR":
        result = a + (b - a) * share[None, :, None]
    else:
        u = share[None, :, None]
        out_tangent, in_tangent = values[:, low, 2] * step[None, :, None], values[:, low + 1, 0] * step[None, :, None]
        result = (
            (2 * u**3 - 3 * u**2 + 1) * a
            + (u**3 - 2 * u**2 + u) * out_tangent
            + (-2 * u**3 + 3 * u**2) * b
            + (u**3 - u**2) * in_tangent
        )
    return unit(result) if rotation else result


def compose(translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(..., 4, 4) matrices T R S from (..., 3) translation, (..., 4) unit quaternion xyzw and (..., 3) scale."""
    x, y, z, w = np.moveaxis(rotation, -1, 0)
    turn = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], -1),
            np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], -1),
            np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )
    matrix = np.zeros((*turn.shape[:-2], 4, 4))
    matrix[..., :3, :3] = turn * scale[..., None, :]
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1.0
    return matrix


@dataclass(frozen=True)
class Channel:
    """One animated property of one node. ``values`` (K, D), or (K, 3, D) for CUBICSPLINE."""

    node: int
    path: TargetPath
    times_s: np.ndarray
    values: np.ndarray
    interpolation: Interpolation
    times_key: int = -1


@dataclass(frozen=True)
class RigNode:
    """An animated node: the static matrix between it and its nearest animated ancestor (-1: none), its own rest TRS."""

    node: int
    parent: int
    above: np.ndarray
    translation: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray


class Rig:
    """All animated nodes of a file; evaluates every pose at once (a numpy step per depth and per set of key times)."""

    def __init__(self, nodes: Sequence[RigNode], channels: Sequence[Channel]) -> None:
        """``nodes`` may come in any order; ``parent`` refers to other entries' ``node``."""
        self.row = {entry.node: i for i, entry in enumerate(nodes)}
        self._above = np.array([entry.above for entry in nodes], np.float64).reshape(-1, 4, 4)
        self._rest = {
            "translation": np.array([entry.translation for entry in nodes], np.float64).reshape(-1, 3),
            "rotation": unit(np.array([entry.rotation for entry in nodes], np.float64).reshape(-1, 4)),
            "scale": np.array([entry.scale for entry in nodes], np.float64).reshape(-1, 3),
        }
        parent = np.array([self.row.get(entry.parent, -1) for entry in nodes], np.intp)
        depth = np.zeros(len(nodes), np.intp)
        for i in range(len(nodes)):
            above = parent[i]
            while above >= 0:
                depth[i], above = depth[i] + 1, parent[above]
        self._levels = [np.flatnonzero(depth == level) for level in range(int(depth.max(initial=-1)) + 1)]
        self._parent = parent
        groups: dict[tuple[object, ...], list[Channel]] = {}
        for channel in channels:
            shared = channel.times_key if channel.times_key >= 0 else -1 - id(channel.times_s)
            groups.setdefault((shared, channel.path, channel.interpolation, channel.values.shape), []).append(channel)
        self._groups = [
            (
                members[0].path,
                members[0].interpolation,
                members[0].times_s,
                np.stack([member.values for member in members]),
                np.array([self.row[member.node] for member in members], np.intp),
            )
            for members in groups.values()
        ]

    def poses(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) scene seconds -> (nodes, T, 4, 4) float64 node-to-world matrices, in the order given at construction."""
        time_s = np.atleast_1d(np.asarray(time_s, np.float64))
        local = {path: np.repeat(rest[:, None, :], time_s.size, axis=1) for path, rest in self._rest.items()}
        for path, kind, times_s, values, rows in self._groups:
            local[path][rows] = sample_keys(times_s, values, kind, time_s, path == "rotation")
        world = self._above[:, None] @ compose(local["translation"], local["rotation"], local["scale"])
        for level in self._levels[1:]:
            world[level] = world[self._parent[level]] @ world[level]
        return world


@dataclass(frozen=True)
class NodeTrack:
    """The pose of one animated node of a `Rig`, times a fixed matrix ``below`` it (identity: the node itself)."""

    rig: Rig
    node: int
    below: np.ndarray | None = None

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) -> (T, 4, 4) local-to-world."""
        world = self.rig.poses(time_s)[self.rig.row[self.node]]
        return world if self.below is None else world @ self.below
