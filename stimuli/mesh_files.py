"""OBJ and PLY meshes, read by trimesh, as static parts. Their v runs upwards; here it runs downwards (glTF)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from stimuli.errors import InputError, problem
from stimuli.gltf_materials import decode_image, texture_of
from stimuli.gltf_meshes import mend_normals, require_finite
from stimuli.scene import Material, Part, Primitive, pyrender


@dataclass
class MeshContent:
    """The parts of a mesh file, what the user should hear, and the bytes of further files that were read."""

    parts: list[Part] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


def read_mesh(path: Path) -> MeshContent:
    """Read ``path`` (.obj or .ply). STEM_texture.png or STEM.png beside an OBJ without materials is its texture."""
    import trimesh  # slow to import; only these two formats need it

    require_numbers_in_text(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded: Any = trimesh.load(path, process=False, force="scene")
    # trimesh has no error of its own for a broken file: its readers let through what they stumble over.
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, NotImplementedError, OSError) as error:
        raise InputError(problem(path, "broken mesh", _line(error), f"a {path.suffix[1:].upper()} file")) from error
    content = MeshContent()
    for name, mesh in loaded.geometry.items():
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            content.parts.append(_part(path, str(name), mesh, content))
    if not content.parts:
        raise InputError(problem(path, "mesh", "no triangles", "at least one"))
    return content


def require_numbers_in_text(path: Path) -> None:
    """InputError where a text OBJ has a vertex line that is not three finite numbers (trimesh skips or drops those)."""
    if path.suffix.lower() != ".obj":
        return
    with path.open("rb") as lines:
        for number, line in enumerate(lines, 1):
            if line.startswith((b"v ", b"v\t")):
                fields = line.split()[1:4]
                try:
                    good = len(fields) == 3 and bool(np.isfinite([float(value) for value in fields]).all())
                except ValueError:
                    good = False
                if not good:
                    got = line.decode("latin-1").strip()[:60]
                    raise InputError(problem(f"{path}:{number}", "vertex", repr(got), "three finite numbers"))


def _part(path: Path, name: str, mesh: Any, content: MeshContent) -> Part:
    positions = np.asarray(mesh.vertices, np.float64)
    faces = np.asarray(mesh.faces, np.int64)
    require_finite(positions, f"{path}: mesh {name!r}")
    if faces.min() < 0 or faces.max() >= len(positions):
        raise InputError(problem(path, "vertex index", int(faces.max()), f"below {len(positions)}"))
    visual = mesh.visual
    uv = getattr(visual, "uv", None)
    texcoord = None
    if uv is not None and len(uv) == len(positions):
        texcoord = np.nan_to_num(np.asarray(uv, np.float64)[:, :2])
        texcoord = np.stack([texcoord[:, 0], 1.0 - texcoord[:, 1]], axis=1)
    material = _material(path, name, visual, texcoord is not None, content)
    color = None
    if getattr(visual, "kind", None) == "vertex":
        # Vertex colours of PLY files are display codes.
        codes = np.asarray(visual.vertex_colors, np.float64) / 255.0
        color = np.hstack([decode_srgb(codes[:, :3]), codes[:, 3:4]])
    normals = None
    if "vertex_normals" in mesh._cache.cache:
        normals = mend_normals(positions, np.asarray(mesh.vertex_normals, np.float64), faces)[0]
    else:
        normals = smooth_normals(positions, faces)
        content.notes.append(f"{path.name}: no normals in the file; smooth ones were made")
    primitive = Primitive(
        positions=positions,
        normals=normals,
        texcoord_0=texcoord,
        color_0=color,
        indices=faces.astype(np.uint32),
        material=material.pbr,
    )
    exact = np.array_equal(positions, positions.astype(np.float32))
    return Part(name, primitive, material, np.eye(4), None if exact else positions)


def _material(path: Path, name: str, visual: Any, has_uv: bool, content: MeshContent) -> Material:
    source = getattr(visual, "material", None)
    image = getattr(source, "image", None)
    factor = np.ones(4)
    pixels = np.asarray(image.convert("RGBA")) if isinstance(image, Image.Image) else None
    named = path.suffix.lower() == ".obj" and b"\nmtllib " in b"\n" + path.read_bytes()
    if named:
        _note_missing_libraries(path, content)
    if source is not None and named:
        diffuse = np.asarray(getattr(source, "diffuse", (255, 255, 255, 255)), np.float64) / 255.0
        factor[: len(diffuse)] = diffuse
    elif has_uv:
        for beside in (path.with_name(f"{path.stem}_texture.png"), path.with_suffix(".png")):
            if beside.is_file():
                data = beside.read_bytes()
                content.data.append(data)
                content.notes.append(
                    f"{path.name}: names no material; its texture is {beside.name}, which lies beside it"
                )
                pixels = decode_image(data, str(beside))
                break
    if pixels is None and not named:
        factor[:3] = 0.7
    # What the material file and its pictures said is part of the scene's identity.
    content.data.append(factor.tobytes() + (b"" if pixels is None else pixels.tobytes()))
    pbr = pyrender.MetallicRoughnessMaterial(
        name=name,
        baseColorFactor=factor,
        baseColorTexture=None if pixels is None else texture_of(pixels, name),
        metallicFactor=0.0,
        roughnessFactor=0.8,
        doubleSided=True,
    )
    return Material(name=name, pbr=pbr)


def _note_missing_libraries(path: Path, content: MeshContent) -> None:
    for line in path.read_bytes().splitlines():
        if line.startswith(b"mtllib "):
            name = line[7:].decode("utf-8", "replace").strip()
            text = f"{path.name}: material file {name} is not there; its materials are plain"
            if not path.with_name(name).is_file() and text not in content.notes:
                content.notes.append(text)


def smooth_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(N, 3) unit normals: the area-weighted mean over each vertex's faces; (0, 0, 1) where no face gives one."""
    corner = positions[faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.stack(
        [np.bincount(faces.reshape(-1), np.repeat(across[:, axis], 3), len(positions)) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 1.0))


def decode_srgb(codes: np.ndarray) -> np.ndarray:
    """Display values in [0, 1] to linear ones (IEC 61966-2-1)."""
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


def _line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]
