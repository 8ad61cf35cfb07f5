"""Tracer space: where rays are traced, so that neither the scale nor the place of a scene matters to float32.

world -> tracer is a translation by the scene's centre, in float64 and before vertices become float32, and a scale by a
power of two that brings the bounding radius into [1, 2) (decisions.md, Space).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stimuli.errors import InputError, problem
from stimuli.scene import Mover, Part, Scene

_BOUND_TIMES = 9  # poses looked at to bound a mover's way; only a power of two depends on it


@dataclass(frozen=True)
class TracerSpace:
    """``tracer = (world - center) * scale``. ``center`` is (3,) float64 world units; ``scale`` is a power of two."""

    center: tuple[float, float, float]
    scale: float
    radius: float

    def points(self, world: np.ndarray) -> np.ndarray:
        """(..., 3) world points -> (..., 3) float64 tracer points."""
        return (np.asarray(world, np.float64) - self.center) * self.scale

    def world_points(self, tracer: np.ndarray) -> np.ndarray:
        """(..., 3) tracer points -> (..., 3) float64 world points."""
        return np.asarray(tracer, np.float64) / self.scale + self.center


@dataclass(frozen=True)
class BodySpace:
    """The same for one rigid body: ``own = (body - center) * scale``, in the body's untransformed coordinates."""

    center: np.ndarray
    scale: float

    def points(self, body: np.ndarray) -> np.ndarray:
        """(..., 3) body points -> (..., 3) float64 points in the body's own traced space."""
        return (np.asarray(body, np.float64) - self.center) * self.scale

    def pose(self, matrices: np.ndarray, space: TracerSpace) -> np.ndarray:
        """(..., 4, 4) body-to-world matrices -> (..., 3, 4) float64 own-space-to-tracer-space matrices."""
        matrices = np.asarray(matrices, np.float64)
        out = np.empty((*matrices.shape[:-2], 3, 4))
        out[..., :3] = matrices[..., :3, :3] * (space.scale / self.scale)
        out[..., 3] = space.points(matrices[..., :3, :3] @ self.center + matrices[..., :3, 3])
        return out


def part_points(part: Part, where: str) -> np.ndarray:
    """(N, 3) float64 positions after the part's matrix. Raises InputError where one is not finite."""
    positions = part.positions
    points = positions @ part.matrix[:3, :3].T + part.matrix[:3, 3]
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(
            problem(f"{where}: mesh {part.name}", "vertex position", f"{positions[row]} at {row}", "finite numbers")
        )
    return points


def _bounds(points: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
    points = [p for p in points if len(p)]
    if not points:
        return None
    return np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)


def corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(8, 3) corners of a box."""
    picks = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)])
    return np.where(picks, high, low)


def mover_bounds(mover: Mover, where: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Low and high corner (3,) of a mover's parts in its body space; None where it has no vertices."""
    return _bounds([part_points(part, where) for part in mover.parts])


def tracer_space(scene: Scene) -> TracerSpace:
    """The tracer space of ``scene``: its bounding box over its whole animation. An empty scene gets the unit one."""
    points = [part_points(part, scene.name) for part in scene.static]
    times_s = np.linspace(0.0, max(scene.duration_s, 0.0), _BOUND_TIMES)
    points += [skin.track.vertices(float(time_s))[0] for skin in scene.skins for time_s in times_s]
    for mover in scene.movers:
        box = mover_bounds(mover, scene.name)
        if box is not None:
            poses = mover.track.pose(times_s)
            points.append((corners(*box) @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]).reshape(-1, 3))
    box = _bounds(points)
    if box is None:
        return TracerSpace((0.0, 0.0, 0.0), 1.0, 1.0)
    center = (box[0] + box[1]) / 2
    radius = float(np.linalg.norm(box[1] - box[0]) / 2)
    if not radius > 0:
        return TracerSpace(tuple(center.tolist()), 1.0, 1.0)
    return TracerSpace(tuple(center.tolist()), 2.0 ** -math.floor(math.log2(radius)), radius)


def body_space(mover: Mover, space: TracerSpace, where: str) -> BodySpace:
    """The own space of ``mover``: centred on its box, scaled so that its pose is close to a rotation."""
    box = mover_bounds(mover, where)
    center = np.zeros(3) if box is None else (box[0] + box[1]) / 2
    times_s = np.linspace(0.0, 1.0, 3)
    size = np.max(np.cbrt(np.abs(np.linalg.det(mover.track.pose(times_s)[:, :3, :3]))))
    return BodySpace(center, float(space.scale * size) if size > 0 else space.scale)
