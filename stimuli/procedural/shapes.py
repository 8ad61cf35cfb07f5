"""Shapes and materials of the procedural scenes. Metres, +y up, right-handed, counter-clockwise fronts."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stimuli.gltf_materials import texture_of
from stimuli.scene import RGB, Material, Part, Primitive, pyrender


@dataclass(frozen=True)
class Mesh:
    """Triangles as arrays: ``positions``, ``normals`` (N, 3), ``uv`` (N, 2), ``indices`` (F, 3)."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    indices: np.ndarray

    def moved(self, offset: Sequence[float]) -> Mesh:
        """The same mesh, shifted."""
        return Mesh(self.positions + np.asarray(offset, np.float64), self.normals, self.uv, self.indices)

    def turned(self, rotation: np.ndarray) -> Mesh:
        """The same mesh, turned by a (3, 3) rotation about the origin."""
        return Mesh(self.positions @ rotation.T, self.normals @ rotation.T, self.uv, self.indices)

    def scaled_uv(self, factor: float) -> Mesh:
        """The same mesh with its texture repeated ``factor`` times as often."""
        return Mesh(self.positions, self.normals, self.uv * factor, self.indices)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh out of several."""
    start = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.uv for mesh in meshes]),
        np.concatenate([mesh.indices + start[i] for i, mesh in enumerate(meshes)]),
    )


def grid(points: np.ndarray, uv: np.ndarray, outward: bool = True) -> Mesh:
    """A surface from an (R, C, 3) grid of points with (R, C, 2) coordinates; smooth normals along d/dcolumn x d/drow.

    ``outward`` False turns normals and winding round.
    """
    rows, columns = points.shape[:2]
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (row * columns + column).reshape(-1)
    b, c, d = a + 1, a + columns, a + columns + 1
    indices = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    across = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    length = np.linalg.norm(across, axis=2, keepdims=True)
    normals = across / np.where(length > 0.0, length, 1.0)
    if not outward:
        indices, normals = indices[:, ::-1], -normals
    return Mesh(points.reshape(-1, 3), normals.reshape(-1, 3), uv.reshape(-1, 2), indices)


def rectangle(
    corner: Sequence[float], edge_u: Sequence[float], edge_v: Sequence[float], repeat: tuple[float, float] = (1, 1)
) -> Mesh:
    """A rectangle facing edge_u x edge_v; the texture repeats ``repeat`` times along its edges."""
    origin, u, v = (np.asarray(x, np.float64) for x in (corner, edge_u, edge_v))
    normal = np.cross(u, v)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float64) * np.asarray(repeat, np.float64)
    positions = np.stack([origin, origin + u, origin + u + v, origin + v])
    return Mesh(positions, np.tile(normal / np.linalg.norm(normal), (4, 1)), uv, np.array([[0, 1, 2], [0, 2, 3]]))


def box(centre: Sequence[float], size: Sequence[float], inward: bool = False) -> Mesh:
    """An axis-aligned box with flat faces, one texture tile a face."""
    return boxes(np.asarray(centre, np.float64)[None], np.asarray(size, np.float64)[None], inward)


def boxes(centres: np.ndarray, sizes: np.ndarray, inward: bool = False) -> Mesh:
    """Many boxes at once: (B, 3) centres and sizes."""
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            if sign < 0:
                u, v = v, u
            normal = sign * np.eye(3)[axis]
            corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64)
            faces.append((normal + corners[:, :1] * u + corners[:, 1:] * v, np.tile(normal, (4, 1))))
    unit_positions = np.concatenate([face[0] for face in faces]) / 2.0
    unit_normals = np.concatenate([face[1] for face in faces])
    unit_uv = np.tile(np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float64), (6, 1))
    unit_indices = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in range(6)])
    count = len(centres)
    positions = (centres[:, None] + unit_positions * sizes[:, None]).reshape(-1, 3)
    indices = (unit_indices + 24 * np.arange(count)[:, None, None]).reshape(-1, 3)
    normals = np.tile(unit_normals, (count, 1))
    if inward:
        indices, normals = indices[:, ::-1], -normals
    return Mesh(positions, normals, np.tile(unit_uv, (count, 1)), indices)


def lathe(radius_m: np.ndarray, height_m: np.ndarray, segments: int) -> Mesh:
    """A surface of revolution about +y through the profile (radius, height); normals point outwards if heights rise.

    Profile corners sharper than 50 degrees stay edges; the others are smooth.
    """
    profile = np.stack([radius_m, height_m], axis=1)
    along = np.diff(profile, axis=0)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    before, after = np.concatenate([along[:1], along]), np.concatenate([along, along[-1:]])
    sharp = np.sum(before * after, axis=1) < np.cos(np.radians(50.0))
    smooth = np.where(sharp[:, None], before, before + after)
    # A sharp corner is two rows in one place: the end of one strip and the start of the next.
    row = np.repeat(np.arange(len(profile)), 1 + sharp)
    second = np.concatenate([[False], row[1:] == row[:-1]])
    tangent = np.where(second[:, None], after[row], smooth[row])
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    angle = np.linspace(0.0, 2.0 * np.pi, segments + 1)
    around = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    up = np.array([0.0, 1.0, 0.0])
    points = profile[row, :1, None] * around + profile[row, 1:, None] * up
    normals = tangent[:, 1:, None] * around - tangent[:, :1, None] * up
    u = np.broadcast_to(angle / (2.0 * np.pi), points.shape[:2])
    v = np.broadcast_to(np.linspace(1.0, 0.0, len(profile))[row, None], points.shape[:2])
    mesh = grid(points, np.stack([u, v], axis=2))
    return Mesh(mesh.positions, normals.reshape(-1, 3), mesh.uv, _without_slivers(mesh))


def sphere(radius_m: float, rings: int = 24, segments: int = 48) -> Mesh:
    """A sphere about the origin, without triangles of no area at its poles."""
    angle = np.linspace(-np.pi / 2.0, np.pi / 2.0, rings + 1)
    radius = radius_m * np.cos(angle)
    radius[[0, -1]] = 0.0
    mesh = lathe(radius, radius_m * np.sin(angle), segments)
    return Mesh(mesh.positions, mesh.positions / radius_m, mesh.uv, mesh.indices)


def cushion(size: Sequence[float], softness: float = 0.35, rings: int = 24, segments: int = 48) -> Mesh:
    """A superellipsoid in a box of ``size``: softness 1 is an ellipsoid, towards 0 a box."""
    up, around = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, rings + 1), np.linspace(0.0, 2 * np.pi, segments + 1), indexing="ij"
    )

    def superellipse(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The point at ``angle`` of |x|^(2/softness) + |y|^(2/softness) = 1; even in angle, so no triangles crowd."""
        x, y = np.cos(angle), np.sin(angle)
        x = np.where(np.abs(x) < 1e-15, 0.0, x)
        reach = (np.abs(x) ** (2 / softness) + np.abs(y) ** (2 / softness)) ** (-softness / 2)
        return x * reach, y * reach

    (flat, rise), (front, side) = superellipse(up), superellipse(around)
    half = np.asarray(size, np.float64) / 2.0
    points = half * np.stack([flat * side, rise, flat * front], axis=2)
    steep = (2.0 - softness) / softness
    flat, rise, front, side = (np.sign(c) * np.abs(c) ** steep for c in (flat, rise, front, side))
    normals = np.stack([flat * side, rise, flat * front], axis=2) / half
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    uv = np.stack([around / (2 * np.pi), 0.5 - up / np.pi], axis=2)
    mesh = grid(points, uv)
    return Mesh(mesh.positions, normals.reshape(-1, 3), mesh.uv, _without_slivers(mesh))


def cylinder(radius_m: float, length_m: float, segments: int = 32) -> Mesh:
    """A closed cylinder along y about the origin, with sharp edges."""
    half = length_m / 2.0
    side = lathe(np.full(2, radius_m), np.array([-half, half]), segments)
    bottom = lathe(np.array([0.0, radius_m]), np.full(2, -half), segments)
    top = lathe(np.array([radius_m, 0.0]), np.full(2, half), segments)
    return join([bottom, side, top])


def torus(major_m: float, minor_m: float, rings: int = 48, segments: int = 16) -> Mesh:
    """A torus about the y axis."""
    around, tube = np.meshgrid(
        np.linspace(0, 2 * np.pi, rings + 1), np.linspace(0, 2 * np.pi, segments + 1), indexing="ij"
    )
    normals = np.stack([np.cos(tube) * np.sin(around), np.sin(tube), np.cos(tube) * np.cos(around)], axis=2)
    centre = np.stack([major_m * np.sin(around), np.zeros_like(around), major_m * np.cos(around)], axis=2)
    uv = np.stack([around, tube], axis=2) / (2 * np.pi)
    mesh = grid(centre + minor_m * normals, uv, outward=False)
    return Mesh(mesh.positions, normals.reshape(-1, 3), mesh.uv, mesh.indices)


def tube(points: np.ndarray, radius_m: float, segments: int = 6) -> Mesh:
    """A thin tube along (P, 3) points."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, np.eye(3)[int(np.argmin(np.abs(tangent).sum(axis=0)))])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    third = np.cross(tangent, side)
    angle = np.linspace(0, 2 * np.pi, segments + 1)[None, :, None]
    normals = np.cos(angle) * side[:, None] + np.sin(angle) * third[:, None]
    surface = points[:, None] + radius_m * normals
    u, v = np.meshgrid(np.linspace(0, 1, segments + 1), np.linspace(0, 1, len(points)))
    mesh = grid(surface, np.stack([u, v], axis=2))
    return Mesh(mesh.positions, normals.reshape(-1, 3), mesh.uv, mesh.indices)


def _without_slivers(mesh: Mesh) -> np.ndarray:
    corner = mesh.positions[mesh.indices]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    return mesh.indices[area > 1e-12 * max(float(area.max(initial=0.0)), 1e-30)]


def rotation(axis: int, angle_rad: float) -> np.ndarray:
    """(3, 3) rotation about a main axis, counter-clockwise seen from its tip."""
    result = np.eye(3)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    result[a, a] = result[b, b] = np.cos(angle_rad)
    result[a, b], result[b, a] = -np.sin(angle_rad), np.sin(angle_rad)
    return result


def pose(offset: Sequence[float], turn: np.ndarray | None = None) -> np.ndarray:
    """(4, 4) from an offset and a (3, 3) rotation."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    if turn is not None:
        matrix[:3, :3] = turn
    return matrix


def matte(
    name: str,
    color: RGB,
    texture: np.ndarray | None = None,
    roughness: float = 1.0,
    metallic: float = 0.0,
    emissive: RGB = (0.0, 0.0, 0.0),
    transmission: float = 0.0,
) -> Material:
    """A metallic-roughness material, matte unless told otherwise; ``texture`` (H, W, 4) uint8 display codes."""
    pbr = pyrender.MetallicRoughnessMaterial(
        name=name,
        baseColorFactor=np.array([*color, 1.0]),
        baseColorTexture=None if texture is None else texture_of(texture, name, mag=9729, mip=9987),
        metallicFactor=metallic,
        roughnessFactor=roughness,
        emissiveFactor=np.asarray(emissive, np.float64),
        doubleSided=True,
    )
    return Material(name=name, pbr=pbr, transmission=transmission)


def part(name: str, mesh: Mesh, material: Material, matrix: np.ndarray | None = None, flat: bool = False) -> Part:
    """A `Part` of ``mesh``; texture coordinates only where the material has a texture; ``flat``: no normals."""
    primitive = Primitive(
        positions=mesh.positions,
        normals=None if flat else mesh.normals,
        texcoord_0=mesh.uv if material.pbr.baseColorTexture is not None else None,
        indices=mesh.indices.astype(np.uint32),
        material=material.pbr,
    )
    return Part(name, primitive, material, np.eye(4) if matrix is None else matrix)


def checkerboard(size_px: int, cells: int, dark: RGB, light: RGB) -> np.ndarray:
    """(size, size, 4) uint8 display codes of a checkerboard."""
    row, column = np.mgrid[0:size_px, 0:size_px] * cells // size_px
    return _codes(np.where(((row + column) % 2 == 0)[..., None], light, dark))


def noise(rng: np.random.Generator, size_px: int, dark: RGB, light: RGB, slope: float = 1.0) -> np.ndarray:
    """(size, size, 4) uint8 codes of periodic noise whose amplitude falls with frequency to the power ``slope``."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size_px), np.fft.fftfreq(size_px)))
    frequency[0, 0] = np.inf
    spectrum = np.fft.fft2(rng.standard_normal((size_px, size_px))) / frequency**slope
    field = np.real(np.fft.ifft2(spectrum))
    share = np.clip(0.5 + field / (4.0 * field.std()), 0.0, 1.0)[..., None]
    return _codes(np.asarray(dark) * (1.0 - share) + np.asarray(light) * share)


def _codes(color: np.ndarray) -> np.ndarray:
    rgba = np.ones((*color.shape[:2], 4))
    rgba[..., :3] = color
    return np.round(np.clip(rgba, 0.0, 1.0) * 255.0).astype(np.uint8)


def generator(name: str) -> np.random.Generator:
    """The random numbers of scene ``name``, the same on every machine."""
    words = np.frombuffer(hashlib.sha256(name.encode()).digest()[:16], np.uint32)
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([int(word) for word in words])))


def recipe_sha256(name: str, version: int) -> str:
    """The identity of a procedural scene: its recipe's name and version."""
    return hashlib.sha256(f"procedural {name} {version}".encode()).hexdigest()
