"""The moving fixation target of Weier et al. 2016 (section 4): a green sphere at scene depth on a smooth path.

The paper gives neither path nor size. Ours: a Lissajous figure (3 : 2) of +-`REACH` half fields in `PERIOD_S`, which
the camera carries along; the sphere subtends `SIZE_DEG` and stands at `NEARNESS` of the least depth that the scene has
along the path, so that nothing hides it. A scene that brings a mover called target keeps its own.
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
PERIOD_S = 8.0
SIZE_DEG = 0.6
NEARNESS = 0.8
_LOOKS = 64


@dataclass(frozen=True)
class CarriedTarget:
    """A point that swings in front of a camera at a constant depth (world units)."""

    camera: CameraPath
    depth: float
    start_s: float

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) scene seconds -> (T, 4, 4) target-to-world."""
        times = np.atleast_1d(np.asarray(time_s, np.float64))
        own = np.tile(np.eye(4), (len(times), 1, 1))
        own[:, :3, 3] = self.depth * directions(self.camera.yfov_rad, times - self.start_s)
        return np.asarray(self.camera.pose(times), np.float64) @ own


def directions(yfov_rad: float, since_start_s: np.ndarray) -> np.ndarray:
    """(T, 3) where the target is at depth 1 in the camera's own space."""
    phase = 2 * math.pi * np.asarray(since_start_s, np.float64) / PERIOD_S
    reach = REACH * math.tan(yfov_rad / 2)
    return np.stack([reach * np.sin(3 * phase), reach * np.sin(2 * phase), -np.ones_like(phase)], axis=-1)


def with_fixation_target(scene: Scene, camera: CameraPath, start_s: float, duration_s: float) -> Scene:
    """``scene`` with a target to follow from ``start_s`` on; the scene itself where it has one."""
    if scene.fixation_target is not None:
        return scene
    depth = NEARNESS * least_depth(scene, camera, start_s, duration_s)
    radius = depth * math.tan(math.radians(SIZE_DEG / 2))
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    primitive = Primitive(positions=np.asarray(ball.vertices, np.float32), indices=np.asarray(ball.faces))
    green = pyrender.MetallicRoughnessMaterial(baseColorFactor=[0.05, 0.8, 0.1, 1.0])
    part = Part("fixation target", primitive, Material("fixation target", green, unlit=True))
    mover = Mover("fixation target", (part,), CarriedTarget(camera, depth, start_s))
    return replace(scene, movers=(*scene.movers, mover))


def least_depth(scene: Scene, camera: CameraPath, start_s: float, duration_s: float) -> float:
    """The least depth (along the camera's axis, world units) of the scene on the target's path; for an empty view 1."""
    times = start_s + np.linspace(0.0, max(duration_s, 0.0), _LOOKS)
    poses = np.asarray(camera.pose(times), np.float64)
    own = directions(camera.yfov_rad, times - start_s)
    away = np.einsum("tij,tj->ti", poses[:, :3, :3], own)
    length = np.linalg.norm(away, axis=1)
    found = Tracer(scene).trace(poses[:, :3, 3], away / length[:, None], time_s=start_s)
    depths = np.asarray(found.t, np.float64) / length
    seen = depths[np.isfinite(depths) & (depths > 0)]
    return float(seen.min()) if seen.size else 1.0
