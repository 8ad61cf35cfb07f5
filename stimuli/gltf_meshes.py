"""glTF mesh primitives as `Primitive`: triangles from any mode, checked vertices, morph weights, skins at one pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stimuli.errors import InputError, problem
from stimuli.gltf_buffers import Document, refuse_extensions
from stimuli.gltf_materials import MaterialReader, TextureUse
from stimuli.gltf_morphs import MorphTargets
from stimuli.scene import Material, Primitive

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MODE_NAMES = {0: "points", 1: "lines", 2: "line loops", 3: "line strips"}


@dataclass(frozen=True)
class ReadPrimitive:
    """One glTF primitive: float64 vertex arrays, triangles (F, 3), its material, its joints where it is skinned, its
    targets where it morphs (the arrays are then those of the resting weights)."""

    positions: np.ndarray
    normals: np.ndarray | None
    texcoord: np.ndarray | None
    color: np.ndarray | None
    indices: np.ndarray
    material: Material
    joints: np.ndarray | None = None
    weights: np.ndarray | None = None
    targets: MorphTargets | None = None

    def as_pyrender(self, mirrored: bool) -> Primitive:
        """The arrays as pyrender holds them; ``mirrored`` turns the winding round."""
        return Primitive(
            positions=self.positions,
            normals=self.normals,
            texcoord_0=self.texcoord,
            color_0=self.color,
            indices=self.indices[:, ::-1] if mirrored else self.indices,
            material=self.material.pbr,
        )

    @property
    def positions64(self) -> np.ndarray | None:
        """The float64 positions where float32 would change them, else None."""
        return None if np.array_equal(self.positions, self.positions.astype(np.float32)) else self.positions


def read_primitive(
    document: Document, materials: MaterialReader, mesh: dict[str, Any], number: int, weights: list[float] | None
) -> ReadPrimitive | None:
    """Primitive ``number`` of ``mesh``; None, with a note, for what has no triangles. ``weights`` morph its targets."""
    entry = mesh["primitives"][number]
    where = f"{document.path.name}: mesh {mesh.get('name', '?')!r} primitive {number}"
    attributes = entry.get("attributes", {})
    mode = entry.get("mode", _TRIANGLES)
    if mode in _MODE_NAMES:
        document.note(f"{document.path.name}: {_MODE_NAMES[mode]} are not drawn (they have no surface)")
        return None
    if mode not in (_TRIANGLES, _STRIP, _FAN):
        raise InputError(problem(where, "mode", mode, "0 to 6"))
    if "POSITION" not in attributes:
        document.note(f"{where}: has no POSITION; left out")
        return None
    stored = document.item("accessors", attributes["POSITION"], where)
    if "bufferView" not in stored and "sparse" not in stored:
        # Compressed primitives may leave their accessors empty.
        refuse_extensions(document, entry.get("extensions", {}))
    positions = _attribute(document, attributes["POSITION"], 3, f"{where}: POSITION")
    targets = _targets(document, entry, positions, where)
    resting = np.zeros(0 if targets is None else len(targets.position_steps))
    resting[: len(weights or [])] = (weights or [])[: len(resting)]
    if targets is not None:
        positions = targets.at(resting)[0]
    require_finite(positions, f"{document.path}: mesh {mesh.get('name', '?')!r} primitive {number}: POSITION")
    count = len(positions)
    indices = document.raw(entry["indices"])[:, 0].astype(np.int64) if "indices" in entry else np.arange(count)
    if indices.size and int(indices.max()) >= count:
        raise InputError(problem(where, "vertex index", int(indices.max()), f"below {count}"))
    faces = triangles_of(indices, mode)
    if not len(faces):
        document.note(f"{where}: has no triangles; left out")
        return None
    read = materials.read(entry.get("material"))
    normals = None
    if "NORMAL" in attributes:
        normals = _attribute(document, attributes["NORMAL"], 3, f"{where}: NORMAL", count)
        if targets is not None:
            normals = targets.at(resting)[1]
            assert normals is not None
        normals, mended = mend_normals(positions, normals, faces)
        if mended:
            document.note(f"{where}: {mended} normals of length 0 or nan; their face's normal is used")
    color = None
    if "COLOR_0" in attributes:
        color = document.array(attributes["COLOR_0"])
        color = np.hstack([color, np.ones((count, 4 - color.shape[1]))])
    joints, weighting = _skinning(document, attributes, where, count)
    return ReadPrimitive(
        positions=positions,
        normals=normals,
        texcoord=_texcoord(document, attributes, read.use, where, count),
        color=color,
        indices=faces.astype(np.uint32),
        material=read.material,
        joints=joints,
        weights=weighting,
        targets=targets,
    )


def _targets(document: Document, entry: dict[str, Any], positions: np.ndarray, where: str) -> MorphTargets | None:
    """The morph targets of a primitive; None where it has none. What a target does not name it does not move."""
    given = entry.get("targets", [])
    if not given:
        return None
    attributes, count = entry["attributes"], len(positions)
    steps = {}
    for name in ("POSITION", "NORMAL"):
        steps[name] = np.zeros((len(given), count, 3))
        for number, target in enumerate(given):
            if name in target:
                step = _attribute(document, target[name], 3, f"{where}: target {number} {name}", count)
                require_finite(step, f"{where}: target {number} {name}")
                steps[name][number] = step
    normals = document.array(attributes["NORMAL"]) if "NORMAL" in attributes else None
    return MorphTargets(positions, normals, steps["POSITION"], steps["NORMAL"])


def triangles_of(indices: np.ndarray, mode: int) -> np.ndarray:
    """(F, 3) triangles from an index list of mode 4 (triangles), 5 (strip) or 6 (fan); a rest of 1 or 2 is dropped."""
    if mode == _TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    if len(indices) < 3:
        return np.zeros((0, 3), indices.dtype)
    if mode == _FAN:
        return np.stack([indices[1:-1], indices[2:], np.full(len(indices) - 2, indices[0])], axis=1)
    strip = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    # Every second triangle of a strip is wound the other way round.
    strip[1::2] = strip[1::2][:, [0, 2, 1]]
    return strip


def require_finite(positions: np.ndarray, where: object) -> None:
    """InputError, with the first bad vertex, unless every coordinate is a finite number that float32 can hold."""
    bad = np.flatnonzero(~(np.abs(positions) < np.finfo(np.float32).max).all(axis=1))
    if bad.size:
        value = ", ".join(f"{x:g}" for x in positions[bad[0]])
        raise InputError(
            problem(where, f"{bad.size} bad vertices, the first is {bad[0]}", f"({value})", "finite numbers")
        )


def mend_normals(positions: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Unit normals (N, 3), and how many had no direction and took that of a face that uses them."""
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(normals, axis=1)
    bad = ~((length > 0.0) & np.isfinite(length))
    safe = np.where(bad[:, None], 0.0, normals) / np.where(bad, 1.0, length)[:, None]
    used = np.zeros(len(positions), bool)
    used[faces] = True
    if not (bad & used).any():
        return np.where(bad[:, None], (0.0, 0.0, 1.0), safe), 0
    corner = positions[faces]
    face_normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(face_normal, axis=1, keepdims=True)
    face_normal = np.where(area > 0.0, face_normal / np.where(area > 0.0, area, 1.0), (0.0, 0.0, 1.0))
    per_vertex = np.tile((0.0, 0.0, 1.0), (len(positions), 1))
    per_vertex[faces.reshape(-1)] = np.repeat(face_normal, 3, axis=0)
    return np.where(bad[:, None], per_vertex, safe), int((bad & used).sum())


def _attribute(document: Document, index: int, width: int, where: str, count: int | None = None) -> np.ndarray:
    values = document.array(index)
    if values.shape[1] != width or (count is not None and len(values) != count):
        wanted = f"{'N' if count is None else count} x {width}"
        raise InputError(problem(where, "shape", f"{values.shape[0]} x {values.shape[1]}", wanted))
    return values


def _texcoord(
    document: Document, attributes: dict[str, int], use: TextureUse, where: str, count: int
) -> np.ndarray | None:
    """The coordinates that the material's textures want, their transform applied."""
    name = f"TEXCOORD_{use.texcoord}"
    if name not in attributes:
        return None
    uv = _attribute(document, attributes[name], 2, f"{where}: {name}", count)
    if not np.isfinite(uv).all():
        document.note(f"{where}: {name} holds nan or inf; 0 is used there")
        uv = np.nan_to_num(uv, nan=0.0, posinf=0.0, neginf=0.0)
    return uv @ use.transform[:2, :2].T + use.transform[:2, 2]


def _skinning(
    document: Document, attributes: dict[str, int], where: str, count: int
) -> tuple[np.ndarray | None, np.ndarray | None]:
    joints, weights = [], []
    number = 0
    while f"JOINTS_{number}" in attributes and f"WEIGHTS_{number}" in attributes:
        joints.append(document.raw(attributes[f"JOINTS_{number}"]).astype(np.intp))
        weights.append(_attribute(document, attributes[f"WEIGHTS_{number}"], 4, f"{where}: WEIGHTS_{number}", count))
        number += 1
    if not joints:
        return None, None
    total = np.hstack(weights)
    share = total.sum(axis=1, keepdims=True)
    return np.hstack(joints), np.divide(total, share, out=np.zeros_like(total), where=share > 0.0)
