"""`load_scene`: a file (glTF, GLB, OBJ, PLY) or the name of a procedural scene, as a `Scene`."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from stimuli.errors import InputError, problem
from stimuli.gltf import GltfContent, read_gltf
from stimuli.light_files import LightFiles, read_light_files
from stimuli.mesh_files import read_mesh
from stimuli.procedural import SCENES
from stimuli.scene import CameraPath, Light, Mover, Part, Scene, StillCamera

READER_VERSION = 2
"""Raised by hand whenever the same file would be read as another scene."""
DEFAULT_YFOV_RAD = float(np.radians(50.0))
_MALFORMED = (KeyError, TypeError, IndexError, AttributeError, ValueError, OverflowError, struct.error)


def load_scene(path_or_name: str | Path, animation: str | None = None) -> Scene:
    """The scene behind a path or a name in `SCENES`; a file of that name wins.

    ``animation``: which of a glTF file's animations is played (None: the first). Light files ``STEM_scene.json`` and
    ``STEM_lights.json`` beside it are read. InputError, one line each, where it cannot be loaded.
    """
    path = Path(path_or_name)
    try:
        path.stat()
    except FileNotFoundError:
        pass
    except OSError as error:
        got = (error.strerror or "an error").lower()
        raise InputError(problem(f"{str(path)[:60]}...", "scene", got, "a file that can be read")) from error
    if not path.is_file() and str(path_or_name) in SCENES:
        if animation is not None:
            raise InputError(
                problem(path_or_name, "animation", repr(animation), "none: a procedural scene has only its own")
            )
        return SCENES[str(path_or_name)]()
    if path.is_dir():
        raise InputError(problem(path, "scene", "a folder", "a .glb, .gltf, .obj or .ply file"))
    if not path.is_file():
        names = " | ".join(SCENES)
        raise InputError(
            problem(path_or_name, "scene", "no such file or name", f"a .glb, .gltf, .obj or .ply file, or {names}")
        )
    if path.suffix.lower() in (".glb", ".gltf"):
        return _load_gltf(path, animation)
    if path.suffix.lower() in (".obj", ".ply"):
        if animation is not None:
            raise InputError(problem(path, "animation", repr(animation), "none: this format has no animations"))
        return _load_mesh(path)
    raise InputError(problem(path, "file type", path.suffix or "none", ".glb, .gltf, .obj or .ply"))


def bounding_sphere(parts: tuple[Part, ...] | list[Part], movers: tuple[Mover, ...] = ()) -> tuple[np.ndarray, float]:
    """Centre (3,) and half diagonal of the axis-aligned box round everything at time 0; radius 1 round nothing."""
    boxes = [_box(part, np.eye(4)) for part in parts]
    for mover in movers:
        pose = mover.track.pose(np.zeros(1))[0]
        boxes += [_box(part, pose) for part in mover.parts]
    if not boxes:
        return np.zeros(3), 1.0
    low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    return (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0 or 1.0


def framing_camera(centre: np.ndarray, radius: float, yfov_rad: float = DEFAULT_YFOV_RAD) -> StillCamera:
    """A camera on +z of the sphere that just frames it."""
    matrix = np.eye(4)
    matrix[:3, 3] = centre + np.array([0.0, 0.0, radius / np.sin(yfov_rad / 2.0)])
    return StillCamera(matrix, yfov_rad)


def _load_gltf(path: Path, animation: str | None) -> Scene:
    try:
        content = read_gltf(path, animation)
    except InputError:
        raise
    except _MALFORMED as error:
        reason = " ".join(f"{type(error).__name__} {error}".split())[:200]
        raise InputError(problem(path, "malformed glTF", reason, "glTF 2.0 as the specification has it")) from error
    lights = read_light_files(path, content.node_track)
    if not content.static and not content.movers:
        raise InputError(problem(path, "scene", "no triangles", "at least one mesh with triangles"))
    content.digest.update(f"gltf reader {READER_VERSION} animation {content.animation}".encode())
    for data in lights.data:
        content.digest.update(data)
    scene = Scene(
        name=path.stem,
        static=tuple(content.static),
        movers=tuple(content.movers),
        lights=(*lights.lights, *content.lights),
        camera=_camera(content, lights),
        sha256=content.digest.hexdigest(),
        ambient=lights.ambient,
        background=lights.background,
        default_exposure=1.0 if content.has_phong else None,
        duration_s=content.duration_s,
        notes=(*content.notes, *lights.notes),
        view=lights.view,
        skins=tuple(content.skins),
    )
    return with_light(scene)


def _load_mesh(path: Path) -> Scene:
    content = read_mesh(path)
    lights = read_light_files(path, lambda _name: None)
    digest = hashlib.sha256(path.read_bytes())
    digest.update(f"mesh reader {READER_VERSION}".encode())
    for data in [*content.data, *lights.data]:
        digest.update(data)
    scene = Scene(
        name=path.stem,
        static=tuple(content.parts),
        movers=(),
        lights=tuple(lights.lights),
        camera=lights.view or framing_camera(*bounding_sphere(content.parts)),
        sha256=digest.hexdigest(),
        ambient=lights.ambient,
        background=lights.background,
        notes=(*content.notes, *lights.notes),
        view=lights.view,
    )
    return with_light(scene)


def _camera(content: GltfContent, lights: LightFiles) -> CameraPath:
    if content.camera is not None:
        return content.camera
    if lights.view is not None:
        return lights.view
    content.notes.append(f"{content.path.name}: no camera; one of 50 degrees stands on +z and frames everything")
    return framing_camera(*bounding_sphere(content.static, tuple(content.movers)))


def with_light(scene: Scene) -> Scene:
    """``scene``, or where it has no light and no ambient term, with a directional light from the camera, said aloud."""
    if scene.lights or any(scene.ambient):
        return scene
    light = Light("directional", (np.pi, np.pi, np.pi), track=scene.camera, name="camera light")
    line = f"{scene.name}: no light in the file; one directional light shines from the camera"
    return replace(scene, lights=(light,), notes=(*scene.notes, line))


def _box(part: Part, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    matrix = pose @ part.matrix
    used = part.positions[np.unique(part.primitive.indices)]
    world = used @ matrix[:3, :3].T + matrix[:3, 3]
    return world.min(axis=0), world.max(axis=0)
