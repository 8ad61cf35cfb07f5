"""Small scenes with known answers for the engine's tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyrender

from stimuli.scene import RGB, Light, Material, Mover, Part, Phong, PoseTrack, Scene, StillCamera

BOX_FACES = np.array(
    [[0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]]
)  # fmt: skip


def pbr(color: RGB = (1.0, 1.0, 1.0), alpha: float = 1.0, **values: object) -> pyrender.MetallicRoughnessMaterial:
    return pyrender.MetallicRoughnessMaterial(
        baseColorFactor=np.array([*color, alpha]), **{"metallicFactor": 0.0, "roughnessFactor": 1.0, **values}
    )


def diffuse(
    color: RGB = (1.0, 1.0, 1.0), ambient: RGB | None = None, specular: RGB = (0.0, 0.0, 0.0), **values: object
) -> Material:
    shine = values.pop("shine", 10.0)
    transmission = values.pop("transmission", 0.0)
    phong = Phong(color if ambient is None else ambient, color, specular, shine, transmission)
    return Material("diffuse", pbr(**values), phong=phong)


def primitive(points: object, faces: object, **values: object) -> pyrender.Primitive:
    return pyrender.Primitive(
        positions=np.asarray(points, np.float32), indices=np.asarray(faces, np.uint32), mode=4, **values
    )


def quad(corner: object, u: object, v: object, material: Material, name: str = "quad") -> Part:
    corner, u, v = (np.asarray(value, float) for value in (corner, u, v))
    points = np.array([corner, corner + u, corner + u + v, corner + v])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return Part(name, primitive(points, [[0, 1, 2], [0, 2, 3]], texcoord_0=uv), material)


def box(center: object, half: object, material: Material) -> Part:
    corners = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)]) * 2 - 1
    return Part("box", primitive(np.asarray(center) + corners * np.asarray(half, float), BOX_FACES), material)


def look_at(eye: object, target: object, yfov_deg: float = 40.0, up: object = (0, 1, 0)) -> StillCamera:
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(np.asarray(up, float), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = right, np.cross(back, right), back, eye
    return StillCamera(matrix, np.radians(yfov_deg))


@dataclass(frozen=True)
class Drift:
    """Moves at ``velocity`` (units/s) and turns about y at ``turn_rad_s``."""

    start: tuple[float, float, float]
    velocity: tuple[float, float, float]
    turn_rad_s: float = 0.0

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        time_s = np.atleast_1d(np.asarray(time_s, float))
        matrix = np.tile(np.eye(4), (time_s.size, 1, 1))
        angle = time_s * self.turn_rad_s
        matrix[:, 0, 0] = matrix[:, 2, 2] = np.cos(angle)
        matrix[:, 0, 2], matrix[:, 2, 0] = np.sin(angle), -np.sin(angle)
        matrix[:, :3, 3] = np.asarray(self.start) + time_s[:, None] * np.asarray(self.velocity)
        return matrix


@dataclass(frozen=True)
class Scaled:
    """A track in a world that is ``scale`` times as large and shifted by ``offset``."""

    inner: PoseTrack
    matrix: np.ndarray

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        return self.matrix @ self.inner.pose(time_s)


def scene(
    static: tuple[Part, ...] = (), movers: tuple[Mover, ...] = (), lights: tuple[Light, ...] = (),
    camera: StillCamera | None = None, ambient: RGB = (0.0, 0.0, 0.0), background: RGB = (0.0, 0.0, 0.0),
) -> Scene:  # fmt: skip
    camera = look_at((0, 0, 5), (0, 0, 0)) if camera is None else camera
    return Scene("by hand", static, movers, lights, camera, "0" * 64, ambient, background)


def crowd(count: int, seed: int = 0) -> tuple[Mover, ...]:
    """Boxes that drift and turn before the camera of `scene`."""
    rng = np.random.default_rng(seed)
    movers = []
    for k in range(count):
        color = tuple(float(v) for v in rng.uniform(0.2, 1, 3))
        track = Drift(tuple(rng.uniform(-1.2, 1.2, 3)), tuple(rng.uniform(-2, 2, 3)), float(rng.uniform(-9, 9)))
        movers.append(Mover(f"box {k}", (box((0, 0, 0), rng.uniform(0.05, 0.3, 3), diffuse(color)),), track))
    return tuple(movers)
