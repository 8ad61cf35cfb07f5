"""Small scenes with known answers."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import pyrender

from stimuli.scene import Light, Material, Mover, Part, Phong, Scene, StillCamera


def texture(pixels: np.ndarray) -> pyrender.Texture:
    """(H, W, 3) uint8 as a texture that repeats."""
    sampler = pyrender.Sampler(magFilter=9729, minFilter=9987, wrapS=10497, wrapT=10497)
    return pyrender.Texture(source=np.ascontiguousarray(pixels), source_channels="RGB", sampler=sampler)


def unlit(pixels: np.ndarray | None = None, color: tuple[float, float, float] = (1, 1, 1)) -> Material:
    """A surface that shows its base colour whatever the light."""
    pbr = pyrender.MetallicRoughnessMaterial(
        baseColorFactor=[*color, 1.0], baseColorTexture=None if pixels is None else texture(pixels), doubleSided=True
    )
    return Material("unlit", pbr, unlit=True)


def mirror(weight: float = 0.95) -> Material:
    """A Phong surface that only reflects."""
    pbr = pyrender.MetallicRoughnessMaterial(baseColorFactor=[0.0, 0.0, 0.0, 1.0], doubleSided=True)
    return Material("mirror", pbr, Phong((0, 0, 0), (0, 0, 0), (weight,) * 3, 0.0))


def quad(
    corner: tuple, edge_u: tuple, edge_v: tuple, material: Material, name: str = "quad", repeats: float = 1.0
) -> Part:
    """A rectangle of two triangles with texture coordinates 0..repeats."""
    corner, edge_u, edge_v = (np.asarray(v, float) for v in (corner, edge_u, edge_v))
    positions = np.array([corner, corner + edge_u, corner + edge_u + edge_v, corner + edge_v])
    primitive = pyrender.Primitive(
        positions=positions.astype(np.float32),
        indices=np.array([[0, 1, 2], [0, 2, 3]]),
        texcoord_0=np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) * repeats,
    )
    return Part(name, primitive, material)


def noise_pixels(seed: int, size: int = 256, block: int = 1) -> np.ndarray:
    """Random colours in blocks."""
    cells = np.random.default_rng(seed).integers(0, 256, (size // block, size // block, 3), np.uint8)
    return np.kron(cells, np.ones((block, block, 1), np.uint8))


def scene_of(
    *parts: Part, movers: tuple[Mover, ...] = (), lights: tuple[Light, ...] = (), camera=None, **more
) -> Scene:
    """A scene of these parts with a still camera at the origin that looks down -z."""
    told = repr([(p.name, p.positions.tobytes(), p.material.name) for p in parts])
    return Scene(
        "test",
        parts,
        movers,
        lights,
        camera or StillCamera(np.eye(4), np.pi / 3),
        hashlib.sha256(told.encode()).hexdigest(),
        **more,
    )


@dataclass(frozen=True)
class SlidingCamera:
    """Moves by ``velocity`` (world units a second) without turning, and is at the origin at second 1 (or ``from_s``);
    it rests before ``from_s`` and after ``to_s``."""

    velocity: tuple[float, float, float]
    yfov_rad: float = np.pi / 3
    from_s: float = -np.inf
    to_s: float = np.inf
    name: str = "sliding"

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T, 4, 4) camera-to-world."""
        time_s = np.atleast_1d(np.asarray(time_s, float))
        start = 1.0 if np.isinf(self.from_s) else self.from_s
        moved = np.clip(time_s, self.from_s, self.to_s) - start
        poses = np.tile(np.eye(4), (len(time_s), 1, 1))
        poses[:, :3, 3] = moved[:, None] * np.asarray(self.velocity)
        return poses


def velocity_for(
    motion_px: tuple[float, float], distance: float, height_px: int, rate_hz: float, yfov_rad: float = np.pi / 3
) -> tuple:
    """The camera's velocity that moves the picture of a wall at ``distance`` by ``motion_px`` (y down) a frame."""
    pixel = 2 * np.tan(yfov_rad / 2) / height_px * distance * rate_hz
    return (-motion_px[0] * pixel, motion_px[1] * pixel, 0.0)
