"""The scene's triangles as flat arrays: one list of vertices, faces and materials over all bodies.

A hit is a global face number and two barycentrics; what lies there is gathered from these arrays, whichever body it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from renderers.requirements import Requirements, is_cutout, is_see_through
from renderers.space import BodySpace, TracerSpace, body_space, part_points
from stimuli.errors import InputError, problem
from stimuli.scene import Material, Part, Scene


@dataclass(frozen=True)
class Body:
    """Triangles that move together and are traced together. ``mover`` 0 is the static scene, m is mover m - 1.

    ``hidden`` bodies (see-through or cut-out materials) are never asked by shadow rays. ``positions`` (N, 3) float32 in
    the body's traced space, ``faces`` (F, 3) uint32 into them, ``face_base`` the global number of face 0.
    """

    mover: int
    hidden: bool
    positions: np.ndarray
    faces: np.ndarray
    face_base: int


@dataclass(frozen=True)
class Geometry:
    """All bodies. ``vertices`` (N, 8) float32: x y z u nx ny nz v (normal 0: flat); ``faces`` (F, 4) uint32: three
    vertices and a material; ``colors`` (N, 4) float32 or None; ``spaces``: one `BodySpace` a mover.
    """

    bodies: tuple[Body, ...]
    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None
    materials: tuple[Material, ...]
    spaces: tuple[BodySpace, ...]


def _part_arrays(part: Part, points: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray]:
    """(N, 8) float32 vertices without scale applied to normals, and (F, 3) faces of one part."""
    primitive = part.primitive
    count = len(points)
    faces = np.arange(count) if primitive.indices is None else np.asarray(primitive.indices)
    faces = faces.reshape(-1, 3).astype(np.int64)
    if faces.size and (faces.min() < 0 or faces.max() >= count):
        raise InputError(problem(f"{where}: mesh {part.name}", "vertex index", int(faces.max()), f"0 to {count - 1}"))
    vertices = np.zeros((count, 8), np.float32)
    vertices[:, :3] = points
    if primitive.texcoord_0 is not None:
        vertices[:, 3], vertices[:, 7] = np.asarray(primitive.texcoord_0, np.float32)[:, :2].T
    if primitive.normals is not None:
        normals = np.asarray(primitive.normals, np.float64) @ np.linalg.pinv(part.matrix[:3, :3])  # inverse transpose
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        vertices[:, 4:7] = np.where(length > 0, normals / np.where(length > 0, length, 1), 0)
    return vertices, faces


def _colors(part: Part, count: int) -> np.ndarray:
    """(N, 4) float32 vertex colours; white where the part has none."""
    colors = part.primitive.color_0
    out = np.ones((count, 4), np.float32)
    if colors is not None:
        values = np.asarray(colors)
        scale = 1.0 / np.iinfo(values.dtype).max if values.dtype.kind in "ui" else 1.0
        out[:, : values.shape[1]] = values * scale
    return out


def pack(scene: Scene, space: TracerSpace, needs: Requirements) -> Geometry:
    """The arrays of ``scene`` in ``space``. Raises InputError for positions that are not finite and bad indices."""
    spaces = tuple(body_space(mover, space, scene.name) for mover in scene.movers)
    groups: list[tuple[int, TracerSpace | BodySpace, tuple[Part, ...]]] = [(0, space, scene.static)]
    groups += [(m + 1, spaces[m], mover.parts) for m, mover in enumerate(scene.movers)]
    numbers: dict[int, int] = {}
    materials: list[Material] = []
    bodies: list[Body] = []
    all_vertices: list[np.ndarray] = []
    all_faces: list[np.ndarray] = []
    all_colors: list[np.ndarray] = []
    vertex_base = face_base = 0
    for mover, own, parts in groups:
        for hidden in (False, True):
            chosen = [p for p in parts if (is_see_through(p.material) or is_cutout(p.material)) == hidden]
            positions, body_faces, start = [], [], vertex_base
            for part in chosen:
                vertices, faces = _part_arrays(part, own.points(part_points(part, scene.name)), scene.name)
                if not len(faces):
                    continue
                if id(part.material) not in numbers:
                    numbers[id(part.material)] = len(materials)
                    materials.append(part.material)
                body_faces.append(faces + vertex_base - start)
                rows = np.empty((len(faces), 4), np.uint32)
                rows[:, :3], rows[:, 3] = faces + vertex_base, numbers[id(part.material)]
                all_faces.append(rows)
                all_vertices.append(vertices)
                positions.append(vertices[:, :3])
                if needs.colors:
                    all_colors.append(_colors(part, len(vertices)))
                vertex_base += len(vertices)
            if not positions:
                continue
            joined = np.concatenate(body_faces)
            bodies.append(Body(mover, hidden, np.concatenate(positions), joined.astype(np.uint32), face_base))
            face_base += len(joined)
    return Geometry(
        bodies=tuple(bodies),
        vertices=np.concatenate(all_vertices) if all_vertices else np.zeros((1, 8), np.float32),
        faces=np.concatenate(all_faces) if all_faces else np.zeros((1, 4), np.uint32),
        colors=np.concatenate(all_colors) if all_colors else None,
        materials=tuple(materials),
        spaces=spaces,
    )
