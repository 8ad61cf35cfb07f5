"""Nine objects of 290,000 triangles in a captured room, one area light on a circle (after HERR, section 4.1).

Bunny, teapot and Spot may be given as files; procedural stand-ins of about as many triangles take their places. The
room's floor and walls are `captured`: their textures are the synthetic capture over which the objects are composited.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stimuli.camera_path import KeyedCamera
from stimuli.errors import InputError, problem
from stimuli.load import load_scene
from stimuli.procedural.shapes import (
    Mesh,
    checkerboard,
    generator,
    grid,
    join,
    lathe,
    matte,
    noise,
    part,
    pose,
    recipe_sha256,
    rectangle,
    rotation,
    sphere,
    torus,
)
from stimuli.procedural.tracks import round_trip
from stimuli.scene import Light, Material, Part, Scene

VERSION = 1
DURATION_S = 12.0
PLACES = {
    "bunny": (-1.1, 0.0, -0.3),
    "teapot": (0.1, 0.0, 0.5),
    "spot": (1.2, 0.0, 0.0),
    "statue": (-0.4, 0.0, -1.3),
    "knot": (0.9, 0.0, -1.2),
    "shell": (-1.5, 0.0, 0.9),
    "boulder": (1.9, 0.0, -0.9),
    "vase": (-2.0, 0.0, -1.2),
    "mirror ball": (0.35, 0.0, -0.45),
}
"""Where each of the nine objects stands."""


@dataclass(frozen=True)
class CircleTrack:
    """A point on a horizontal circle about ``centre``; it does not turn."""

    centre: tuple[float, float, float]
    radius_m: float
    period_s: float

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) -> (T, 4, 4)."""
        angle = 2 * np.pi * np.atleast_1d(np.asarray(time_s, np.float64)) / self.period_s
        result = np.tile(np.eye(4), (angle.size, 1, 1))
        result[:, :3, 3] = self.centre
        result[:, 0, 3] += self.radius_m * np.cos(angle)
        result[:, 2, 3] += self.radius_m * np.sin(angle)
        return result


def build(files: Mapping[str, Path] | None = None) -> Scene:
    """The scene. ``files``: 'bunny', 'teapot', 'spot' -> a mesh file that takes the stand-in's place, 0.6 m high."""
    files = dict(files or {})
    unknown = sorted(set(files) - {"bunny", "teapot", "spot"})
    if unknown:
        raise InputError(problem("mixed_reality_room", "object", ", ".join(unknown), "bunny, teapot or spot"))
    parts: list[Part] = _room()
    digest = hashlib.sha256(recipe_sha256("mixed_reality_room", VERSION).encode())
    for name, (mesh, material) in _objects().items():
        place = PLACES[name]
        if name in files:
            source = load_scene(files[name])
            parts += _standing(name, source, place)
            digest.update(f"{name} {source.sha256}".encode())
        else:
            parts.append(part(name, mesh, material, pose(place)))
    return Scene(
        name="mixed_reality_room",
        static=tuple(parts),
        movers=(),
        lights=(
            Light(
                "area",
                (14.0, 13.6, 13.0),
                direction=(0.0, -1.0, 0.0),
                corner=(-0.3, 0.0, -0.3),
                edge_u=(0.6, 0.0, 0.0),
                edge_v=(0.0, 0.0, 0.6),
                track=CircleTrack((0.0, 2.5, -0.3), 1.0, DURATION_S),
                name="moving panel",
            ),
        ),
        camera=_camera(),
        sha256=digest.hexdigest() if files else recipe_sha256("mixed_reality_room", VERSION),
        ambient=(0.06, 0.06, 0.065),
        duration_s=DURATION_S,
        notes=tuple(
            f"mixed_reality_room: a stand-in for {name}" for name in ("bunny", "teapot", "spot") if name not in files
        ),
    )


def _standing(name: str, source: Scene, place: tuple[float, float, float]) -> list[Part]:
    """The parts of ``source`` scaled to a height of 0.6 m, standing at ``place``."""
    world = np.concatenate([p.positions @ p.matrix[:3, :3].T + p.matrix[:3, 3] for p in source.static])
    low, high = world.min(axis=0), world.max(axis=0)
    scale = 0.6 / max(float(high[1] - low[1]), 1e-9)
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = np.asarray(place) - scale * np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    return [replace(p, name=f"{name} {p.name}", matrix=matrix @ p.matrix) for p in source.static]


def _objects() -> dict[str, tuple[Mesh, Material]]:
    """Nine meshes standing on y = 0; 290,000 triangles together."""
    return {
        "bunny": (_animal(92, 182), matte("fur", (0.75, 0.7, 0.62))),
        "teapot": (_teapot(), matte("china", (0.85, 0.86, 0.9), roughness=0.08)),
        "spot": (_animal(28, 52), matte("hide", (0.85, 0.78, 0.72))),
        "statue": (_statue(), matte("marble", (0.85, 0.84, 0.8), roughness=0.35)),
        "knot": (_knot(), matte("copper", (0.9, 0.5, 0.3), roughness=0.15, metallic=1.0)),
        "shell": (_shell(), matte("shell", (0.9, 0.7, 0.55), roughness=0.3)),
        "boulder": (_boulder(), matte("rock", (0.4, 0.38, 0.35))),
        "vase": (_vase(), matte("glaze", (0.1, 0.25, 0.5), roughness=0.1)),
        "mirror ball": (
            sphere(0.2, 64, 128).moved((0.0, 0.2, 0.0)),
            matte("mirror", (0.95,) * 3, roughness=0.0, metallic=1.0),
        ),
    }


def _animal(rings: int, segments: int) -> Mesh:
    """A body, a head and two ears: bumpy ellipsoids."""
    body = _bumpy((0.24, 0.2, 0.3), rings, segments, 0.02).moved((0.0, 0.2, 0.0))
    head = _bumpy((0.14, 0.14, 0.15), rings, segments, 0.015).moved((0.0, 0.42, 0.26))
    ears = [_bumpy((0.035, 0.14, 0.03), rings // 4, segments // 4, 0.02).moved((x, 0.62, 0.22)) for x in (-0.06, 0.06)]
    return join([body, head, *ears])


def _bumpy(half: tuple[float, float, float], rings: int, segments: int, depth: float) -> Mesh:
    up, around = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, rings + 1), np.linspace(0, 2 * np.pi, segments + 1), indexing="ij"
    )
    ripple = 1.0 + depth * np.cos(up) ** 2 * (np.sin(9 * around + 4 * up) + np.sin(5 * around - 11 * up))
    radius = np.cos(up)
    radius[[0, -1]] = 0.0
    unit = np.stack([radius * np.sin(around), np.sin(up), radius * np.cos(around)], axis=2)
    return _closed(unit * ripple[..., None] * half, up, around)


def _closed(points: np.ndarray, up: np.ndarray, around: np.ndarray) -> Mesh:
    """A closed surface from a grid whose first and last columns coincide and whose end rows may be poles."""
    mesh = grid(points, np.stack([around / (2 * np.pi), 0.5 - up / np.pi], axis=2))
    corner = mesh.positions[mesh.indices]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    keep = np.linalg.norm(across, axis=1) > 1e-14
    # Vertices in one place share the sum of their faces' normals, so seam and poles are smooth.
    _, same = np.unique(np.round(mesh.positions, 9), axis=0, return_inverse=True)
    same = same.reshape(-1)
    faces = same[mesh.indices[keep]].reshape(-1)
    total = np.stack([np.bincount(faces, np.repeat(across[keep, k], 3), same.max() + 1) for k in range(3)], axis=1)
    normals = total[same] / np.linalg.norm(total[same], axis=1, keepdims=True)
    return Mesh(mesh.positions, normals, mesh.uv, mesh.indices[keep])


def _teapot() -> Mesh:
    t = np.linspace(0.0, 1.0, 49)
    body = lathe(0.26 * np.sin(np.pi * (0.13 + 0.75 * t)) ** 0.8, 0.36 * t, 96)
    lid = lathe(
        np.array([0.105, 0.1, 0.07, 0.02, 0.03, 0.025, 0.0]), np.array([0.36, 0.375, 0.39, 0.4, 0.425, 0.44, 0.445]), 64
    )
    handle = torus(0.12, 0.02, 64, 24).turned(rotation(0, np.pi / 2)).moved((-0.27, 0.2, 0.0))
    s = np.linspace(0.0, 1.0, 40)
    path = np.stack([0.2 + 0.26 * s, 0.12 + 0.26 * s**1.6, np.zeros(40)], axis=1)
    ring = np.linspace(0, 2 * np.pi, 33)
    side, third = np.array([0.0, 0.0, 1.0]), np.array([-0.6, 0.8, 0.0])
    wide = (0.055 - 0.03 * s)[:, None, None]
    spout = grid(
        path[:, None] + wide * (np.cos(ring)[:, None] * side + np.sin(ring)[:, None] * third), np.zeros((40, 33, 2))
    )
    return join([body, lid, handle, _facing_out(spout, path)])


def _facing_out(mesh: Mesh, path: np.ndarray) -> Mesh:
    middle = mesh.positions - np.repeat(path, len(mesh.positions) // len(path), axis=0)
    if np.mean(np.sum(mesh.normals * middle, axis=1)) > 0:
        return mesh
    return Mesh(mesh.positions, -mesh.normals, mesh.uv, mesh.indices[:, ::-1])


def _statue() -> Mesh:
    """A twisted fluted column with a head, 0.9 m."""
    t, around = np.meshgrid(np.linspace(0.0, 1.0, 151), np.linspace(0.0, 2 * np.pi, 145), indexing="ij")
    radius = (0.13 + 0.05 * np.cos(2 * np.pi * t)) * (1.0 + 0.1 * np.cos(8 * around + 9 * t))
    points = np.stack([radius * np.sin(around), 0.7 * t, radius * np.cos(around)], axis=2)
    return join(
        [_closed(points, (t - 0.5) * np.pi, around), _bumpy((0.12, 0.15, 0.13), 44, 72, 0.02).moved((0.0, 0.82, 0.0))]
    )


def _knot() -> Mesh:
    """A trefoil tube."""
    t = np.linspace(0.0, 2 * np.pi, 241)
    path = np.stack([np.sin(t) + 2 * np.sin(2 * t), np.sin(3 * t), np.cos(t) - 2 * np.cos(2 * t)], axis=1) * 0.11
    tangent = np.stack([np.cos(t) + 4 * np.cos(2 * t), 3 * np.cos(3 * t), -np.sin(t) + 4 * np.sin(2 * t)], axis=1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    inward = np.cross(tangent, (0.0, 1.0, 0.0))
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    third = np.cross(tangent, inward)
    ring = np.linspace(0, 2 * np.pi, 65)[None, :, None]
    points = path[:, None] + 0.06 * (np.cos(ring) * inward[:, None] + np.sin(ring) * third[:, None])
    mesh = grid(points, np.zeros((241, 65, 2)))
    normals = ((points - path[:, None]) / 0.06).reshape(-1, 3)
    outward = _facing_out(mesh, path)
    return Mesh(mesh.positions, normals, mesh.uv, outward.indices).turned(rotation(0, 0.5)).moved((0.0, 0.265, 0.0))


def _shell() -> Mesh:
    """A sea shell: a growing tube on a logarithmic spiral."""
    t, around = np.meshgrid(np.linspace(0.0, 1.0, 221), np.linspace(0.0, 2 * np.pi, 81), indexing="ij")
    turn, size = 7 * np.pi * t, np.exp(2.6 * (t - 1.0))
    out = 0.2 * size + 0.13 * size * np.cos(around) * (1 + 0.05 * np.cos(40 * turn))
    points = np.stack(
        [out * np.cos(turn), 0.14 + 0.4 * (1 - size) + 0.13 * size * np.sin(around), out * np.sin(turn)], axis=2
    )
    path = np.stack([0.2 * size * np.cos(turn), 0.14 + 0.4 * (1 - size), 0.2 * size * np.sin(turn)], axis=2)[:, 0]
    return _facing_out(grid(points, np.zeros((221, 81, 2))), path)


def _boulder() -> Mesh:
    up, around = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, 121), np.linspace(0, 2 * np.pi, 181), indexing="ij")
    rng = generator("mixed_reality_room")
    lump = np.zeros_like(up)
    for wave in range(1, 13):
        lump += (
            rng.normal(0.0, 0.09 / wave)
            * np.cos(up) ** 2
            * np.sin(wave * around + rng.uniform(0, 6.3))
            * np.cos(wave * up + rng.uniform(0, 6.3))
        )
    radius = np.cos(up)
    radius[[0, -1]] = 0.0
    unit = np.stack([radius * np.sin(around), np.sin(up), radius * np.cos(around)], axis=2)
    return _closed(unit * (1 + lump)[..., None] * (0.3, 0.25, 0.28), up, around).moved((0.0, 0.24, 0.0))


def _vase() -> Mesh:
    t = np.linspace(0.0, 1.0, 91)
    return lathe(0.12 + 0.07 * np.sin(2 * np.pi * t + 0.6) + 0.004 * np.sin(60 * t), 0.8 * t, 140)


def _room() -> list[Part]:
    """Floor and two walls as a depth camera would have caught them: textured, no other properties known."""
    rng = generator("mixed_reality_room capture")
    carpet = noise(rng, 512, (0.28, 0.3, 0.34), (0.5, 0.5, 0.52), slope=0.9)
    wall = noise(rng, 512, (0.62, 0.6, 0.55), (0.72, 0.7, 0.66), slope=1.2)
    poster = checkerboard(512, 3, (0.2, 0.35, 0.6), (0.85, 0.8, 0.7))
    wall[150:330, 60:180] = poster[150:330, 60:180]
    wall[150:154, 60:180, :3] = wall[326:330, 60:180, :3] = 20
    surfaces = {
        "captured floor": (rectangle((-3, 0, 3), (6, 0, 0), (0, 0, -6), (3, 3)), carpet),
        "captured back wall": (rectangle((-3, 0, -3), (6, 0, 0), (0, 2.6, 0)), wall),
        "captured side wall": (rectangle((-3, 0, 3), (0, 0, -6), (0, 2.6, 0)), wall),
    }
    return [
        part(name, mesh, replace(matte(name, (1.0, 1.0, 1.0), pixels), captured=True))
        for name, (mesh, pixels) in surfaces.items()
    ]


def _camera() -> KeyedCamera:
    return round_trip(
        "head",
        DURATION_S,
        52.0,
        lambda a: (1.2 * np.sin(a), 1.5 + 0.1 * np.cos(a), 2.9 + 0.2 * np.cos(a)),
        lambda a: (0.3 * np.sin(a + 1), 0.35, -0.5),
    )
