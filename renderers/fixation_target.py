"""The moving fixation target of Weier et al. 2016 (section 4.2.1): a green sphere at scene depth on linear paths.

The paper gives neither paths, speed nor size. Ours: straight legs between random points within `REACH` of half the
field, from the middle and back to it, at no more than `SPEED_DEG_S` (as seen in the picture's middle; what an eye
pursues without lagging), which the camera carries along. ``seed`` is of the scene and the condition, so that paths
differ in all trials but repetitions, as the paper's. The sphere subtends `SIZE_DEG` and stands at `NEARNESS` of the
least depth that the scene has along the path, so that nothing hides it. A scene that brings a mover called target keeps
its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pyrender
import trimesh

from renderers.tracer import Tracer
from stimuli.scene import CameraPath, Material, Mover, Part, Primitive, Scene

REACH = 0.6
SPEED_DEG_S = 12.0
SIZE_DEG = 0.6
NEARNESS = 0.8
_LEAST_LEG = 0.5
"""Of the reach: shorter legs would be no path across the picture."""
_TRIES, _LOOKS = 256, 512


@dataclass(frozen=True)
class TargetPath:
    """Straight legs in the camera's own space at depth 1: ``corners`` (N, 2), reached at ``times_s`` (N,) after the
    start; at rest before and after."""

    corners: np.ndarray
    times_s: np.ndarray

    def directions(self, since_start_s: np.ndarray) -> np.ndarray:
        """(T,) seconds -> (T, 3) where the target is at depth 1."""
        x, y = (np.interp(since_start_s, self.times_s, self.corners[:, k]) for k in (0, 1))
        return np.stack([x, y, -np.ones_like(x)], axis=-1)


def target_path(yfov_rad: float, duration_s: float, seed: int) -> TargetPath:
    """A path from the middle of a picture that is ``yfov_rad`` high and back, which takes ``duration_s``."""
    rng = np.random.default_rng(seed)
    reach, room = REACH * math.tan(yfov_rad / 2), math.tan(math.radians(SPEED_DEG_S)) * max(duration_s, 0.0)
    corners, length = [np.zeros(2)], 0.0
    for _ in range(_TRIES):
        corner = rng.uniform(-reach, reach, 2)
        leg, back = float(np.linalg.norm(corner - corners[-1])), float(np.linalg.norm(corner))
        if leg >= _LEAST_LEG * reach and length + leg + back <= room:
            corners.append(corner)
            length += leg
    if len(corners) == 1:  # a short clip: as far as there is time to come back from
        corners.append(corner * min(1.0, room / 2 / back))
    corners.append(np.zeros(2))
    legs = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    times = np.concatenate([[0.0], np.cumsum(legs)])
    return TargetPath(np.array(corners), times * (duration_s / times[-1] if times[-1] > 0 else 0.0))


@dataclass(frozen=True)
class CarriedTarget:
    """A point that moves along a path in front of a camera at a constant depth (world units)."""

    camera: CameraPath
    path: TargetPath
    depth: float
    start_s: float

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) scene seconds -> (T, 4, 4) target-to-world."""
        times = np.atleast_1d(np.asarray(time_s, np.float64))
        own = np.tile(np.eye(4), (len(times), 1, 1))
        own[:, :3, 3] = self.depth * self.path.directions(times - self.start_s)
        return np.asarray(self.camera.pose(times), np.float64) @ own


def with_fixation_target(scene: Scene, camera: CameraPath, start_s: float, duration_s: float, seed: int = 0) -> Scene:
    """``scene`` with a target to follow from ``start_s`` on; the scene itself where it has one."""
    if scene.fixation_target is not None:
        return scene
    path = target_path(camera.yfov_rad, duration_s, seed)
    depth = NEARNESS * least_depth(scene, camera, path, start_s, duration_s)
    radius = depth * math.tan(math.radians(SIZE_DEG / 2))
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    primitive = Primitive(positions=np.asarray(ball.vertices, np.float32), indices=np.asarray(ball.faces))
    green = pyrender.MetallicRoughnessMaterial(baseColorFactor=[0.05, 0.8, 0.1, 1.0])
    part = Part("fixation target", primitive, Material("fixation target", green, unlit=True))
    mover = Mover("fixation target", (part,), CarriedTarget(camera, path, depth, start_s))
    return replace(scene, movers=(*scene.movers, mover))


def least_depth(scene: Scene, camera: CameraPath, path: TargetPath, start_s: float, duration_s: float) -> float:
    """The least depth (along the camera's axis, world units) of the scene on the target's path; for an empty view 1."""
    times = start_s + np.linspace(0.0, max(duration_s, 0.0), _LOOKS)
    poses = np.asarray(camera.pose(times), np.float64)
    own = path.directions(times - start_s)
    away = np.einsum("tij,tj->ti", poses[:, :3, :3], own)
    length = np.linalg.norm(away, axis=1)
    found = Tracer(scene).trace(poses[:, :3, 3], away / length[:, None], time_s=times)
    depths = np.asarray(found.t, np.float64) / length
    seen = depths[np.isfinite(depths) & (depths > 0)]
    return float(seen.min()) if seen.size else 1.0
