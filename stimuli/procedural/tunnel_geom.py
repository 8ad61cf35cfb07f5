"""A displaced tunnel of about 156,000 triangles in one constant colour, one point light, a flight along its axis."""

from __future__ import annotations

import numpy as np

from stimuli.camera_path import KeyedCamera
from stimuli.procedural.shapes import Mesh, grid, matte, part, recipe_sha256
from stimuli.scene import Light, Scene

VERSION = 2
RINGS, SEGMENTS = 390, 200
RADIUS_M, LENGTH_M = 2.0, 40.0
DURATION_S = 8.0


def tunnel(rings: int = RINGS, segments: int = SEGMENTS) -> Mesh:
    """The tunnel along -z from z = +4 m, bumpy on three scales, seen from inside; 2 * rings * segments triangles."""
    along = np.linspace(0.0, 1.0, rings + 1)[:, None]
    around = np.linspace(0.0, 2.0 * np.pi, segments + 1)[None, :]
    z = 4.0 - LENGTH_M * along
    # Whole numbers of waves round the tunnel close it without a seam.
    bump = 0.22 * np.sin(5 * around + 1.1 * z) * np.sin(1.7 * z)
    bump = bump + 0.09 * np.sin(11 * around - 3.0 * z) + 0.035 * np.sin(29 * around) * np.cos(7.0 * z)
    radius = RADIUS_M + bump
    points = np.stack([radius * np.cos(around), radius * np.sin(around), np.broadcast_to(z, radius.shape)], axis=2)
    uv = np.stack(np.broadcast_arrays(around * (4.0 / np.pi), along * 40.0), axis=2)
    mesh = grid(points, uv)
    middle = mesh.positions * np.array([1.0, 1.0, 0.0])
    inward = bool(np.mean(np.sum(mesh.normals * middle, axis=1)) < 0.0)
    return mesh if inward else grid(points, uv, outward=False)


def flight(name: str) -> KeyedCamera:
    """8 s through the first 16 m, weaving and rolling a little."""
    times = np.linspace(0.0, DURATION_S, 9)
    z = np.linspace(2.0, -14.0, 9)
    sway = 0.35 * np.sin(2 * np.pi * times / DURATION_S)
    positions = np.stack([sway, 0.2 * np.sin(4 * np.pi * times / DURATION_S), z], axis=1)
    yaw = 0.12 * np.sin(4 * np.pi * times / DURATION_S)
    roll = 0.10 * np.sin(2 * np.pi * times / DURATION_S)
    quaternions = np.stack(
        [np.zeros(9), np.sin(yaw / 2), np.sin(roll / 2), np.sqrt(1 - np.sin(yaw / 2) ** 2 - np.sin(roll / 2) ** 2)], 1
    )
    return KeyedCamera(times, positions, quaternions, float(np.radians(60.0)), name)


def build() -> Scene:
    """The scene; its light hangs still, off the axis, 6 m into the tunnel, and does not fall off with distance: the
    flight passes it, and inverse square left the last five seconds nearly black."""
    return Scene(
        name="tunnel_geom",
        static=(part("tunnel", tunnel(), matte("clay", (0.7, 0.65, 0.6))),),
        movers=(),
        lights=(Light("point", (1.05, 1.0, 0.9), (0.4, 0.9, -4.0), falloff="none", name="lamp"),),
        camera=flight("flight"),
        sha256=recipe_sha256("tunnel_geom", VERSION),
        ambient=(0.02, 0.02, 0.02),
        duration_s=DURATION_S,
    )
