"""A scene as Mitsuba itself would render it: the yardstick for the engine's speed and pictures.

Only what both can express exactly: diffuse (Phong without highlights) and perfect mirrors, base colour textures, point,
spot-free directional and area lights, all movers at one moment. Everything else raises InputError.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pyrender

from renderers.backend import mi
from renderers.frozen import opaque_float, opaque_uint
from renderers.requirements import texture_image
from renderers.space import TracerSpace, part_points
from renderers.textures import rgba8
from stimuli.errors import InputError, problem
from stimuli.scene import Light, Material, Part, Phong, Scene, scene_at


def diffuse_only(scene: Scene, textures: bool = True) -> Scene:
    """``scene`` with every material replaced by a diffuse one of its colour (``textures`` only where that is white),
    without ambient light and emission."""
    memo: dict[int, Material] = {}

    def plain(material: Material) -> Material:
        if id(material) not in memo:
            factor = material.pbr.baseColorFactor
            red, green, blue = np.ones(3) if factor is None else np.asarray(factor, float)[:3]
            color = (float(red), float(green), float(blue))
            if material.phong is not None:
                color = material.phong.diffuse
            texture = material.pbr.baseColorTexture if textures and color == (1.0, 1.0, 1.0) else None
            pbr = pyrender.MetallicRoughnessMaterial(baseColorFactor=np.array([*color, 1.0]), baseColorTexture=texture)
            memo[id(material)] = Material(material.name, pbr, Phong((0, 0, 0), color, (0, 0, 0), 1.0))
        return memo[id(material)]

    def parts(old: tuple[Part, ...]) -> tuple[Part, ...]:
        return tuple(replace(part, material=plain(part.material)) for part in old)

    movers = tuple(replace(mover, parts=parts(mover.parts)) for mover in scene.movers)
    return replace(
        scene, static=parts(scene.static), movers=movers, ambient=(0.0, 0.0, 0.0), background=(0.0, 0.0, 0.0)
    )


def diffuse_or_mirror(material: Material) -> dict[str, Any]:
    """A diffuse material or a perfect mirror as a Mitsuba plugin. Raises InputError for every other one."""
    phong = material.phong
    if phong is None or phong.transmission:
        raise InputError(problem(material.name, "material", "not diffuse or mirror", "Phong without highlights"))
    if max(phong.specular) > 0:
        if max(phong.diffuse) > 0:
            raise InputError(problem(material.name, "material", "diffuse and mirror at once", "one of the two"))
        mirror = {"type": "rgb", "value": list(phong.specular)}
        return {"type": "twosided", "bsdf": {"type": "conductor", "material": "none", "specular_reflectance": mirror}}
    image = texture_image(material.pbr.baseColorTexture)
    reflectance: dict[str, Any] = {"type": "rgb", "value": list(phong.diffuse)}
    if image is not None:
        if phong.diffuse != (1.0, 1.0, 1.0):
            raise InputError(problem(material.name, "material", f"texture times {phong.diffuse}", "a texture times 1"))
        # Mitsuba's first row is v = 1 of a flipped picture; ours is v = 0.
        bitmap = mi.Bitmap(np.ascontiguousarray(rgba8(image)[::-1, :, :3]))
        bitmap.set_srgb_gamma(True)
        reflectance = {"type": "bitmap", "bitmap": bitmap, "filter_type": "bilinear", "wrap_mode": "repeat"}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def _mesh(part: Part, points: np.ndarray, bsdf: Any) -> Any:
    primitive = part.primitive
    faces = np.asarray(primitive.indices).reshape(-1, 3).astype(np.int64)
    smooth, textured = primitive.normals is not None, primitive.texcoord_0 is not None
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    if not smooth:
        properties["face_normals"] = True
    mesh = mi.Mesh(part.name, len(points), len(faces), properties, smooth, textured)
    values = mi.traverse(mesh)
    values["vertex_positions"] = opaque_float(points)
    values["faces"] = opaque_uint(faces)
    if smooth:
        normals = np.asarray(primitive.normals, np.float64) @ np.linalg.pinv(part.matrix[:3, :3])
        values["vertex_normals"] = opaque_float(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    if textured:
        uv = np.array(primitive.texcoord_0, np.float64)[:, :2]
        values["vertex_texcoords"] = opaque_float(np.stack([uv[:, 0], 1 - uv[:, 1]], 1))
    values.update()
    return mesh


def _light(light: Light, space: TracerSpace, time_s: float) -> dict[str, Any]:
    if light.track is not None and not np.allclose(light.track.pose(np.array([time_s]))[0], np.eye(4)):
        raise InputError(problem(light.name, "light", "a moving light", "one that rests"))
    intensity = np.asarray(light.intensity, float)
    if light.kind == "point" and light.falloff == "inverse_square":
        rgb = {"type": "rgb", "value": (intensity * space.scale**2).tolist()}
        return {"type": "point", "position": space.points(np.array(light.position)).tolist(), "intensity": rgb}
    if light.kind == "directional":
        rgb = {"type": "rgb", "value": intensity.tolist()}
        return {"type": "directional", "direction": list(light.direction), "irradiance": rgb}
    if light.kind == "area":
        u, v, normal = (np.asarray(value, float) for value in (light.edge_u, light.edge_v, light.direction))
        corner = np.asarray(light.corner, float)
        if np.dot(np.cross(u, v), normal) < 0:
            u, v = v, u
        # Mitsuba's rectangle spans [-1, 1]^2 and shines along +z.
        matrix = np.eye(4)
        matrix[:3, 0], matrix[:3, 1] = u / 2 * space.scale, v / 2 * space.scale
        matrix[:3, 2] = np.cross(u, v) / np.linalg.norm(np.cross(u, v)) * space.scale
        matrix[:3, 3] = space.points(corner + u / 2 + v / 2)
        emitter = {"type": "area", "radiance": {"type": "rgb", "value": intensity.tolist()}}
        black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
        return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "emitter": emitter, "bsdf": black}
    raise InputError(problem(light.name, "light", light.kind, "point (inverse square) | directional | area"))


def mitsuba_scene(
    scene: Scene,
    space: TracerSpace,
    size_px: tuple[int, int],
    time_s: float = 0.0,
    bsdf: Callable[[Material], dict[str, Any]] = diffuse_or_mirror,
    watertight: bool = True,
) -> Any:
    """``scene`` at ``time_s`` in tracer space as a Mitsuba scene with its camera (box filter, one sample a pixel).

    ``bsdf``: the Mitsuba plugin that stands for a material. ``watertight``: no ray slips between two triangles, as in
    our tracer; Mitsuba's own default is False. Raises InputError for what Mitsuba cannot express.
    """
    scene = scene_at(scene, time_s)
    loaded: dict[int, Any] = {}
    groups = [(np.eye(4), scene.static), *((m.track.pose(np.array([time_s]))[0], m.parts) for m in scene.movers)]
    tree: dict[str, Any] = {"type": "scene", "embree_use_robust_intersections": watertight}
    for g, (matrix, parts) in enumerate(groups):
        for p, part in enumerate(parts):
            placed = replace(part, matrix=matrix @ part.matrix)
            if id(part.material) not in loaded:
                loaded[id(part.material)] = mi.load_dict(bsdf(part.material))
            points = space.points(part_points(placed, scene.name))
            tree[f"mesh_{g}_{p}"] = _mesh(placed, points, loaded[id(part.material)])
    for k, light in enumerate(scene.lights):
        tree[f"light_{k}"] = _light(light, space, time_s)
    camera = scene.camera.pose(np.array([time_s]))[0].copy()
    camera[:3, 3] = space.points(camera[:3, 3])
    camera[:3, [0, 2]] *= -1  # Mitsuba's camera looks along +z with +x to the left
    tree["sensor"] = {
        "type": "perspective",
        "fov": float(np.degrees(scene.camera.yfov_rad)),
        "fov_axis": "y",
        "near_clip": 1e-5,
        "far_clip": 1e5,
        "to_world": mi.ScalarTransform4f(camera),
        "film": {"type": "hdrfilm", "width": size_px[0], "height": size_px[1], "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": 1},
    }
    return mi.load_dict(tree)
