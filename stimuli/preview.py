"""A contact sheet of a scene along its camera path, by pyrender's raster, in a child process.

A child, because pyrender cannot share a process with another current GL context. The raster knows no shadows and no
mirrors here: a light at the camera shows shape, texture and motion; the scene's own lights are for the ray tracer.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from stimuli.camera_path import camera_path, scene_radius
from stimuli.errors import InputError, problem
from stimuli.load import load_scene
from stimuli.scene import CameraPath, Material, Part, Scene, pyrender, scene_at

COLUMNS, ROWS = 4, 3
TILE_PX = (400, 225)
_LABEL_PX = 18
_LIMIT_S = 600


def write_contact_sheet(scene: str, out: Path, animation: str | None = None, path: str = "file") -> list[str]:
    """Render ``scene`` at 12 evenly spaced times into the picture ``out``; returns the scene's notes.

    InputError as `load_scene` and `camera_path` raise it; RuntimeError, with its last line, where the child failed.
    """
    if out.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(problem(out, "picture", out.suffix or "no ending", ".png or .jpg"))
    if not out.parent.is_dir():
        raise InputError(problem(out, "folder", "none there", "a folder that exists"))
    order = json.dumps({"scene": scene, "out": str(out), "animation": animation, "path": path})
    command = [sys.executable, "-m", "stimuli.preview", order]
    try:
        child = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_LIMIT_S)
    except subprocess.TimeoutExpired as error:
        raise RuntimeError(f"the raster took more than {_LIMIT_S} s") from error
    if child.returncode == 2:
        raise InputError(*child.stderr.strip().splitlines())
    if child.returncode != 0:
        lines = child.stderr.strip().splitlines() or [f"exit code {child.returncode}"]
        raise RuntimeError(f"the raster failed: {lines[-1]}")
    notes: list[str] = json.loads(child.stdout.splitlines()[-1])
    return notes


def frame_times(scene: Scene, camera: CameraPath, count: int) -> np.ndarray:
    """``count`` times spread over the scene's animation, or over 4 s where it has none."""
    length = scene.duration_s or 4.0
    return np.linspace(0.0, length, count, endpoint=False)


def raster(
    scene: Scene, camera: CameraPath, times_s: np.ndarray, size_px: tuple[int, int], supersample: int = 2
) -> list[np.ndarray]:
    """(H, W, 3) uint8 pictures of ``scene`` at ``times_s``; call it only in a process without a GL context."""
    width, height = size_px[0] * supersample, size_px[1] * supersample
    view = pyrender.Scene(bg_color=[*scene.background, 1.0], ambient_light=[0.25, 0.25, 0.25])
    meshes: dict[tuple[int, tuple[float, float]], pyrender.Mesh] = {}
    skinned = {skin.part for skin in scene.skins}
    for number, part in enumerate(scene.static):
        if number not in skinned:
            view.add(_mesh(part, (-np.inf, np.inf), meshes), pose=part.matrix)
    moving = []
    for mover in scene.movers:
        for part in mover.parts:
            node = view.add(_mesh(part, mover.visible_s, meshes), pose=np.eye(4))
            moving.append((mover, part, node))
    radius = scene_radius(scene)
    eye = view.add(pyrender.PerspectiveCamera(camera.yfov_rad, znear=1e-3 * radius, zfar=20.0 * radius), pose=np.eye(4))
    lamp = view.add(pyrender.DirectionalLight(intensity=3.0), pose=np.eye(4))
    pictures = []
    renderer = pyrender.OffscreenRenderer(width, height)
    try:
        for time_s in times_s:
            at = np.array([time_s])
            poses = {id(mover): mover.track.pose(at)[0] for mover in scene.movers}
            for mover, part, node in moving:
                seen = mover.visible_s[0] <= time_s <= mover.visible_s[1]
                node.mesh.is_visible = seen
                view.set_pose(node, poses[id(mover)] @ part.matrix)
            for node in (eye, lamp):
                view.set_pose(node, camera.pose(at)[0])
            posed = scene_at(scene, float(time_s))
            bent = [view.add(_mesh(posed.static[number], (-np.inf, np.inf), {})) for number in skinned]
            color, _depth = renderer.render(view)
            for node in bent:
                view.remove_node(node)
            small = Image.fromarray(color).resize(size_px, Image.Resampling.BOX)
            pictures.append(np.asarray(small))
    finally:
        renderer.delete()
    return pictures


def _mesh(
    part: Part, visible_s: tuple[float, float], meshes: dict[tuple[int, tuple[float, float]], pyrender.Mesh]
) -> pyrender.Mesh:
    """One pyrender mesh for all nodes that show the same primitive in the same seconds."""
    key = id(part.primitive), visible_s
    if key not in meshes:
        source = part.primitive
        shown = pyrender.Primitive(
            positions=source.positions,
            normals=source.normals,
            # pyrender turns pictures upside down on upload; ours have v downwards as glTF has it.
            texcoord_0=None if source.texcoord_0 is None else source.texcoord_0 * (1.0, -1.0) + (0.0, 1.0),
            color_0=source.color_0,
            indices=source.indices,
            material=_preview_material(part.material),
        )
        meshes[key] = pyrender.Mesh([shown])
    return meshes[key]


def _preview_material(material: Material) -> pyrender.MetallicRoughnessMaterial:
    pbr = material.pbr
    base = np.array(pbr.baseColorFactor)
    if material.transmission > 0.0:
        base[3] = 1.0 - 0.8 * material.transmission
    return pyrender.MetallicRoughnessMaterial(
        baseColorFactor=base,
        baseColorTexture=pbr.baseColorTexture,
        # A metal mirrors its surroundings, which this raster has not got.
        metallicFactor=min(float(pbr.metallicFactor), 0.3),
        roughnessFactor=max(float(pbr.roughnessFactor), 0.4),
        emissiveFactor=np.clip(pbr.emissiveFactor, 0.0, 1.0),
        alphaMode="BLEND" if material.transmission > 0.0 else pbr.alphaMode,
        doubleSided=True,
    )


def _sheet(scene: Scene, camera: CameraPath) -> Image.Image:
    times = frame_times(scene, camera, COLUMNS * ROWS)
    width, height = TILE_PX
    title = (
        f"{scene.name}: {scene.triangle_count:,} triangles, {len(scene.static)} static parts, "
        f"{len(scene.movers)} movers, {len(scene.lights)} lights, path '{camera.name}' (preview light at the camera)"
    )
    sheet = Image.new("RGB", (COLUMNS * width, ROWS * (height + _LABEL_PX) + _LABEL_PX), (24, 24, 24))
    pen = ImageDraw.Draw(sheet)
    pen.text((6, 3), title, fill=(235, 235, 235))
    for i, (time_s, picture) in enumerate(zip(times, raster(scene, camera, times, TILE_PX), strict=True)):
        x, y = i % COLUMNS * width, _LABEL_PX + i // COLUMNS * (height + _LABEL_PX)
        sheet.paste(Image.fromarray(picture), (x, y))
        pen.text((x + 6, y + height + 2), f"{time_s:.2f} s", fill=(190, 190, 190))
    return sheet


def _child(order: str) -> int:
    wanted = json.loads(order)
    try:
        scene = load_scene(wanted["scene"], wanted["animation"])
        camera = camera_path(scene, wanted["path"])
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    _sheet(replace(scene, camera=camera), camera).save(wanted["out"])
    print(json.dumps(list(scene.notes)))
    return 0


if __name__ == "__main__":
    sys.exit(_child(sys.argv[1]))
