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

    The first ``casting`` faces cast shadows; the others (see-through or cut-out materials) are never asked by shadow
    rays. ``deforms``: skinned meshes, whose positions are those of time 0. ``positions`` (N, 3) float32 in the body's
    traced space, ``faces`` (F, 3) uint32 into them, ``face_base`` the global number of face 0.
    """

    mover: int
    casting: int
    positions: np.ndarray
    faces: np.ndarray
    face_base: int
    deforms: bool = False


@dataclass(frozen=True)
class Deforming:
    """Where the skinned meshes lie in the arrays: a run of vertices and a run of faces.

    ``order``: the scene's skins (by number) in the order of their vertices.
    """

    first_vertex: int
    vertices: int
    first_face: int
    faces: int
    order: tuple[int, ...]


@dataclass(frozen=True)
class Geometry:
    """All bodies. ``vertices`` (N, 8) float32: x y z u nx ny nz v (normal 0: flat); ``faces`` (F, 4) uint32: three
    vertices and a material; ``colors`` (N, 4) float32 or None; ``spaces``: one `BodySpace` a mover; ``deforming``: None
    without skinned meshes.
    """

    bodies: tuple[Body, ...]
    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None
    materials: tuple[Material, ...]
    spaces: tuple[BodySpace, ...]
    deforming: Deforming | None = None


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


def _deforming(bodies: list[Body], order: tuple[int, ...]) -> Deforming | None:
    """The run of the body that deforms."""
    if not order:
        return None
    at = [body.deforms for body in bodies].index(True)
    return Deforming(
        first_vertex=sum(len(body.positions) for body in bodies[:at]),
        vertices=len(bodies[at].positions),
        first_face=bodies[at].face_base,
        faces=len(bodies[at].faces),
        order=order,
    )


def pack(scene: Scene, space: TracerSpace, needs: Requirements) -> Geometry:
    """The arrays of ``scene`` in ``space``. Raises InputError for positions that are not finite and bad indices."""
    spaces = tuple(body_space(mover, space, scene.name) for mover in scene.movers)
    skinned = {skin.part for skin in scene.skins}
    rigid = tuple(part for number, part in enumerate(scene.static) if number not in skinned)
    bending = tuple(scene.static[skin.part] for skin in scene.skins)
    groups: list[tuple[int, TracerSpace | BodySpace, tuple[Part, ...], bool]] = [
        (0, space, rigid, False), (0, space, bending, True),
    ]  # fmt: skip
    groups += [(m + 1, spaces[m], mover.parts, False) for m, mover in enumerate(scene.movers)]
    order: list[int] = []
    numbers: dict[int, int] = {}
    materials: list[Material] = []
    bodies: list[Body] = []
    all_vertices: list[np.ndarray] = []
    all_faces: list[np.ndarray] = []
    all_colors: list[np.ndarray] = []
    vertex_base = face_base = 0
    for mover, own, parts, deforms in groups:
        # What casts shadows comes first.
        hidden = [is_see_through(part.material) or is_cutout(part.material) for part in parts]
        positions, body_faces, start, casting = [], [], vertex_base, 0
        for number in sorted(range(len(parts)), key=hidden.__getitem__):
            part = parts[number]
            vertices, faces = _part_arrays(part, own.points(part_points(part, scene.name)), scene.name)
            if not len(faces):
                continue
            if deforms:
                order.append(number)
            if id(part.material) not in numbers:
                numbers[id(part.material)] = len(materials)
                materials.append(part.material)
            body_faces.append(faces + vertex_base - start)
            casting += 0 if hidden[number] else len(faces)
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
        numbered = joined.astype(np.uint32)
        bodies.append(Body(mover, casting, np.concatenate(positions), numbered, face_base, deforms))
        face_base += len(joined)
    return Geometry(
        bodies=tuple(bodies),
        vertices=np.concatenate(all_vertices) if all_vertices else np.zeros((1, 8), np.float32),
        faces=np.concatenate(all_faces) if all_faces else np.zeros((1, 4), np.uint32),
        colors=np.concatenate(all_colors) if all_colors else None,
        materials=tuple(materials),
        spaces=spaces,
        deforming=_deforming(bodies, tuple(order)),
    )
