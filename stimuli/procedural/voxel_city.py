"""A city of voxels, a stand-in for Rungholt: streets, blocks of houses, towers, trees; only outer faces are kept."""

from __future__ import annotations

import numpy as np

from stimuli.camera_path import KeyedCamera
from stimuli.gltf_materials import REPEAT, texture_of
from stimuli.procedural.shapes import Mesh, generator, part, recipe_sha256
from stimuli.procedural.tracks import round_trip
from stimuli.scene import RGB, Light, Material, Scene, pyrender

VERSION = 1
DURATION_S = 8.0
SIDE, HEIGHT = 144, 56
"""Voxels of one metre along x and z, and upwards."""
_AIR, _GRASS, _STREET, _STONE, _BRICK, _WINDOW, _WOOD, _LEAVES = range(8)
_COLORS: dict[int, tuple[str, RGB]] = {
    _GRASS: ("grass", (0.3, 0.5, 0.18)),
    _STREET: ("street", (0.3, 0.3, 0.32)),
    _STONE: ("stone", (0.62, 0.6, 0.56)),
    _BRICK: ("brick", (0.58, 0.3, 0.22)),
    _WINDOW: ("window", (0.35, 0.5, 0.62)),
    _WOOD: ("wood", (0.4, 0.27, 0.14)),
    _LEAVES: ("leaves", (0.16, 0.38, 0.12)),
}


def build() -> Scene:
    """The scene: a directional sun, a pale sky, a closed flight over the roofs."""
    rng = generator("voxel_city")
    voxels = city(rng)
    parts = tuple(
        part(name, _surface(voxels, kind), _material(rng, name, color)) for kind, (name, color) in _COLORS.items()
    )
    return Scene(
        name="voxel_city",
        static=parts,
        movers=(),
        lights=(Light("directional", (2.6, 2.4, 2.1), direction=(-0.48, -0.72, -0.5), name="sun"),),
        camera=_flight(),
        sha256=recipe_sha256("voxel_city", VERSION),
        ambient=(0.3, 0.34, 0.4),
        background=(0.45, 0.6, 0.85),
        duration_s=DURATION_S,
    )


def city(rng: np.random.Generator) -> np.ndarray:
    """(SIDE, HEIGHT, SIDE) uint8 kinds of voxels along x, y, z."""
    voxels = np.zeros((SIDE, HEIGHT, SIDE), np.uint8)
    voxels[:, 0] = _STREET
    for x in range(4, SIDE - 14, 18):
        for z in range(4, SIDE - 14, 18):
            voxels[x : x + 13, 0, z : z + 13] = _GRASS
            if rng.random() < 0.15:
                _park(rng, voxels, x, z)
            else:
                _house(rng, voxels, x, z)
    return voxels


def _house(rng: np.random.Generator, voxels: np.ndarray, x: int, z: int) -> None:
    centre = np.hypot(x - SIDE / 2, z - SIDE / 2) / SIDE
    width, depth = (int(n) for n in rng.integers(8, 13, 2))
    height = int(np.clip(rng.normal(34.0 - 50.0 * centre, 8.0), 5, HEIGHT - 6))
    wall = _BRICK if rng.random() < 0.55 else _STONE
    block = voxels[x : x + width, 1 : 1 + height, z : z + depth]
    block[...] = wall
    block[1:-1, :, 1:-1] = _AIR
    block[:, -1] = _STONE if wall == _BRICK else _WOOD
    # Windows: every other column, two of four storeys' rows, set into the wall.
    rows = np.arange(height) % 4
    for face in (block[0], block[-1], block[:, :, 0].T, block[:, :, -1].T):
        face = face if face.shape[0] == height else face.T
        inner = np.arange(face.shape[1])
        opening = np.isin(rows, (1, 2))[:, None] & ((inner % 3 != 0) & (inner > 0) & (inner < face.shape[1] - 1))
        opening[-2:] = False
        face[opening] = _WINDOW
    for _ in range(int(rng.integers(0, 4))):
        a, b = int(rng.integers(1, width - 2)), int(rng.integers(1, depth - 2))
        voxels[x + a : x + a + 2, 1 + height : 3 + height, z + b : z + b + 2] = _WOOD
    if rng.random() < 0.3:
        voxels[x + width // 2, 1 + height : min(1 + height + 5, HEIGHT), z + depth // 2] = _STONE


def _park(rng: np.random.Generator, voxels: np.ndarray, x: int, z: int) -> None:
    dx, dy, dz = np.mgrid[-2:3, -2:3, -2:3]
    crown = dx**2 + dy**2 + dz**2 <= 6
    for _ in range(5):
        a, b, tall = int(rng.integers(2, 11)), int(rng.integers(2, 11)), int(rng.integers(4, 8))
        voxels[x + a, 1:tall, z + b] = _WOOD
        around = voxels[x + a - 2 : x + a + 3, tall - 1 : tall + 4, z + b - 2 : z + b + 3]
        around[crown & (around == _AIR)] = _LEAVES


def _surface(voxels: np.ndarray, kind: int) -> Mesh:
    """The faces between voxels of ``kind`` and air, one quad each, centred on the origin in x and z."""
    padded = np.pad(voxels, 1)
    solid = voxels == kind
    positions, normals, quads = [], [], 0
    for axis in range(3):
        for sign in (1, -1):
            neighbour = np.roll(padded, -sign, axis)[1:-1, 1:-1, 1:-1]
            cell = np.argwhere(solid & (neighbour == _AIR)).astype(np.float64)
            if axis == 1 and sign == -1:
                cell = cell[cell[:, 1] > 0]  # nobody sees the ground from below
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            if sign < 0:
                u, v = v, u
            corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ np.stack([u, v]) + sign * np.eye(3)[axis]
            positions.append((cell[:, None] + 0.5 + corners / 2.0).reshape(-1, 3))
            normals.append(np.tile(sign * np.eye(3)[axis], (4 * len(cell), 1)))
            quads += len(cell)
    place = np.concatenate(positions) - (SIDE / 2, 0.0, SIDE / 2)
    normal = np.concatenate(normals)
    # Side faces have u along the ground and v downwards; faces that look up or down are mapped by x and z.
    flat = np.abs(normal[:, 1]) > 0.5
    across = np.where(np.abs(normal[:, 0]) > 0.5, place[:, 2], place[:, 0])
    uv = np.stack([np.where(flat, place[:, 0], across), np.where(flat, place[:, 2], -place[:, 1])], axis=1)
    indices = (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(quads)[:, None, None]).reshape(-1, 3)
    return Mesh(place, normal, uv, indices)


def _material(rng: np.random.Generator, name: str, color: RGB) -> Material:
    """16 x 16 texels a voxel, as such worlds have."""
    tone = rng.uniform(0.72, 1.1, (16, 16, 1))
    if name in ("brick", "stone"):
        tone[::4] *= 0.7
        tone[0:4, 0] *= 0.7
        tone[8:12, 0] *= 0.7
        tone[4:8, 8] *= 0.7
    if name == "window":
        tone[[0, 15]] = 0.4
        tone[:, [0, 15]] = 0.4
    pixels = np.full((16, 16, 4), 255, np.uint8)
    pixels[..., :3] = np.round(np.clip(np.asarray(color) * tone, 0.0, 1.0) * 255.0)
    pbr = pyrender.MetallicRoughnessMaterial(
        name=name,
        baseColorTexture=texture_of(pixels, name, (REPEAT, REPEAT), mag=9728, mip=9987),
        metallicFactor=0.0,
        roughnessFactor=0.1 if name == "window" else 1.0,
        doubleSided=True,
    )
    return Material(name=name, pbr=pbr)


def _flight() -> KeyedCamera:
    return round_trip(
        "flight",
        DURATION_S,
        55.0,
        lambda a: (58 * np.sin(a), 46 + 8 * np.cos(2 * a), 58 * np.cos(a)),
        lambda a: (14 * np.sin(a + 1.9), 14.0, 14 * np.cos(a + 1.9)),
    )
