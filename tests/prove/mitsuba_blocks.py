"""The engine against Mitsuba's own integrators on kitchen, robots and sponza, 512x288, 1,024 samples a pixel, in 8x8
blocks. ``python -m tests.prove.mitsuba_blocks [SCENE ...]`` writes evidence/mitsuba_blocks_SCENE.json and pictures.

Both sides estimate the same integral: the pixel's square (box filter), jittered, textures at level 0 and bilinear. Each
side is 64 independent renders, of 16 samples (Mitsuba's, random: 1,024 in all) and of 4 (ours, quasi-random: 256);
their spread gives each block's standard error. ``our_share``: in how many blocks ours is the smaller.

Materials that both can express: diffuse colour times texture, or a perfect mirror of the file's specular colour. No
highlight, no transmission, no cut-outs, and not both at once: Mitsuba 3.9.1's `blendbsdf` of a diffuse and a mirror
lobe of half weight reflects 0.797 of what it should, for it divides the mirror by the density of both lobes.
`path` also carries light from one diffuse surface to the next, which Whitted shading has not: its scene has
reflectances times `DIM` and lights times 1 / `DIM`, so that only direct light is left.
Forms: the engine as it is, and with shadow and mirror rays started where Mitsuba starts them (9e-5 (1 + |p|) off the
surface, ours 5e-6 max(1, |p|)): what only the second passes is Mitsuba's offset. ``cones``: textures looked up as
`reference` does at 1,024 samples a pixel, by cones of 1/32 pixel. ``bodies baked``: with Mitsuba's ray starts, and all
movers' vertices in the still mesh: Mitsuba rounds them to float32 in the scene's space, so that the normals of robots'
small facets are off by up to 2e-4 rad (ours, in each body's own space, by 4e-7), which three mirrors magnify.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyrender
from PIL import Image

from renderers import Tracer
from renderers.backend import activate, dr, mi
from renderers.mitsuba_scene import mitsuba_scene
from renderers.requirements import MIRROR_LEAST, base_rgba, texture_image
from renderers.space import TracerSpace, tracer_space
from renderers.textures import decode_srgb, rgba8
from stimuli import load_scene
from stimuli.errors import InputError, problem
from stimuli.scene import RGB, Light, Material, Part, Phong, Primitive, Scene
from tests.prove.engine_oracles import FILES, SIZE_PX, pixel_rays
from tests.renderers.mitsuba_oracle import block_means, our_means, z_of_means

RUNS, SPP, OUR_SPP = 64, 16, 4
DIM = 1e-6
ASKED = 0.999
ROUNDING = 2e-4
"""Relative, for float32 sums and the texture decoder's polynomial; a |z| of 4 is then at least 8e-4 of the value."""
_WRAP = {10497: "repeat", 33071: "clamp", 33648: "mirror"}


# The scenes -----------------------------------------------------------------------------------------------------------


def _rgb(values: Any) -> RGB:
    red, green, blue = (float(v) for v in values)
    return red, green, blue


def expressible(scene: Scene, mirrors: bool, smooth: bool) -> Scene:
    """``scene`` with diffuse, textured materials (``mirrors``: perfect mirrors where the file's specular colour is the
    larger one). ``smooth``: vertex normals are kept; without them faces are flat.
    """
    memo: dict[tuple[int, bool], Material] = {}

    def plain(part: Part) -> Material:
        material, has_uv = part.material, part.primitive.texcoord_0 is not None
        if (id(material), has_uv) not in memo:
            phong = material.phong
            diffuse = _rgb(base_rgba(material)[:3] if phong is None else phong.diffuse)
            specular = (0.0, 0.0, 0.0)
            if mirrors and phong is not None and max(phong.specular) > max(*diffuse, MIRROR_LEAST):
                diffuse, specular = specular, phong.specular
            texture = material.pbr.baseColorTexture if has_uv else None
            pbr = pyrender.MetallicRoughnessMaterial(baseColorTexture=texture)
            memo[id(material), has_uv] = Material(material.name, pbr, Phong((0, 0, 0), diffuse, specular, 0.0))
        return memo[id(material), has_uv]

    def parts(old: tuple[Part, ...]) -> tuple[Part, ...]:
        new = []
        for part in old:
            own = part.primitive
            bare = Primitive(
                positions=own.positions,
                normals=own.normals if smooth else None,
                texcoord_0=own.texcoord_0,
                indices=own.indices,
                material=own.material,
            )
            new.append(replace(part, material=plain(part), primitive=bare))
        return tuple(new)

    movers = tuple(replace(mover, parts=parts(mover.parts)) for mover in scene.movers)
    black = (0.0, 0.0, 0.0)
    return replace(scene, static=parts(scene.static), movers=movers, ambient=black, background=black)


def with_mirrors(scene: Scene) -> Scene:
    """``scene`` with every third of its still materials a mirror, for files that have none."""
    materials = list({id(part.material): part.material for part in scene.static}.values())
    shiny = Phong((0, 0, 0), (0, 0, 0), (0.8, 0.7, 0.6), 0.0)
    changed = {id(material): replace(material, phong=shiny) for material in materials[::3]}
    static = (replace(part, material=changed.get(id(part.material), part.material)) for part in scene.static)
    return replace(scene, static=tuple(static))


def point_lights(scene: Scene, time_s: float) -> tuple[Light, ...]:
    """The scene's lights as point lights that fall off with the square and light a wall 0.35 radii away to about 1.

    Where none of them reaches what the camera sees (the sky of robots hides its sun), one beside the camera.
    """
    strength = np.pi * (0.35 * tracer_space(scene).radius) ** 2
    lights = []
    for light in scene.lights:
        matrix = np.eye(4) if light.track is None else light.track.pose(np.array([time_s]))[0]
        place = matrix[:3, :3] @ np.asarray(light.position) + matrix[:3, 3]
        color = np.asarray(light.intensity) / max(light.intensity) * strength / len(scene.lights)
        lights.append(Light("point", _rgb(color), _rgb(place), name=light.name))
    tracer = Tracer(scene)
    seen = tracer.trace(*pixel_rays(scene, time_s, (32, 18)), time_s)
    starts = (seen.point + 1e-3 * tracer.space.radius * seen.geometric_normal)[np.isfinite(seen.t)]
    for light in lights:
        away = np.asarray(light.position) - starts
        if (tracer.trace(starts, away, time_s).t > np.linalg.norm(away, axis=1)).any():
            return tuple(lights)
    pose = scene.camera.pose(np.array([time_s]))[0]
    radius = tracer.space.radius
    return (Light("point", ((0.1 * radius) ** 2,) * 3, _rgb(pose[:3, 3] + 0.1 * radius * pose[:3, 1])),)


def area_light(scene: Scene, time_s: float) -> Light:
    """A square of 0.08 radii above the camera, facing down and forwards."""
    radius = tracer_space(scene).radius
    pose = scene.camera.pose(np.array([time_s]))[0]
    right, up, forward = pose[:3, 0], pose[:3, 1], -pose[:3, 2]
    u, v = 0.08 * radius * right, 0.08 * radius * (forward + up) / np.sqrt(2)
    normal = (forward - up) / np.sqrt(2)
    place = pose[:3, 3] + 0.08 * radius * up - u / 2 - v / 2
    return Light("area", (60.0, 55.0, 50.0), direction=_rgb(normal), corner=_rgb(place), edge_u=_rgb(u), edge_v=_rgb(v))


# Mitsuba's side -------------------------------------------------------------------------------------------------------


def plugin(dim: float) -> Callable[[Material], dict[str, Any]]:
    """Materials of `expressible` as Mitsuba plugins, diffuse colours times ``dim``."""

    def diffuse(material: Material) -> dict[str, Any]:
        assert material.phong is not None
        color = np.asarray(material.phong.diffuse) * dim
        texture = material.pbr.baseColorTexture
        image = texture_image(texture)
        reflectance: dict[str, Any] = {"type": "rgb", "value": color.tolist()}
        if image is not None:
            wrap = [_WRAP[int(getattr(texture.sampler, name, None) or 10497)] for name in ("wrapS", "wrapT")]
            if wrap[0] != wrap[1]:
                raise InputError(problem(material.name, "texture wrap", wrap, "the same in both directions"))
            # Mitsuba's first row is v = 1 of a flipped picture; ours is v = 0.
            linear = decode_srgb(rgba8(image)[::-1, :, :3] / 255.0) * color
            bitmap = mi.Bitmap(np.ascontiguousarray(linear, np.float32))
            reflectance = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": wrap[0]}
        return {"type": "diffuse", "reflectance": reflectance}

    def made(material: Material) -> dict[str, Any]:
        assert material.phong is not None
        if max(material.phong.specular) > 0:
            rgb = {"type": "rgb", "value": list(material.phong.specular)}
            mirror = {"type": "conductor", "material": "none", "specular_reflectance": rgb}
            return {"type": "twosided", "bsdf": mirror}
        return {"type": "twosided", "bsdf": diffuse(material)}

    return made


def their_means(subject: Scene, space: TracerSpace, time_s: float, integrator: str, runs: int) -> np.ndarray:
    """(runs, rows, columns) block means of Mitsuba's `direct` or `path`."""
    dim = DIM if integrator == "path" else 1.0
    lights = tuple(replace(light, intensity=_rgb(np.asarray(light.intensity) / dim)) for light in subject.lights)
    there = mitsuba_scene(replace(subject, lights=lights), space, SIZE_PX, time_s, plugin(dim))
    # A path of 5 edges: three mirrors, a surface, its light. Roulette ends those that went on from a dim surface.
    settings = {
        "direct": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True},
        "path": {"type": "path", "max_depth": 5, "rr_depth": 1, "hide_emitters": True},
    }
    made = mi.load_dict(settings[integrator])
    renders = (np.array(mi.render(there, integrator=made, spp=SPP, seed=1000 + run)) for run in range(runs))
    means = np.array([block_means(picture) for picture in renders])
    del there, made, renders
    gc.collect()  # a scene that is freed while a kernel is recorded aborts the process
    dr.sync_thread()
    return means


# The comparison -------------------------------------------------------------------------------------------------------


AS_IT_IS, STARTS, CONES, BAKED = "as it is", "Mitsuba's ray starts", "cones", "bodies baked"


@dataclass(frozen=True)
class Case:
    """One comparison: what is lit how, the scene, Mitsuba's integrator, the forms of our side, renders a side."""

    name: str
    scene: Scene
    integrator: str
    forms: tuple[str, ...] = (AS_IT_IS, STARTS)
    runs: int = RUNS


def cases(scene: Scene, time_s: float) -> list[Case]:
    """Direct light of point lights and of an area light, mirrors and textures; with vertex normals, a quarter as long.

    Vertex normals are not quite common ground: where the shading plane and the face disagree, Mitsuba lights a face
    from behind and darkens one that looks at the eye, and our engine follows the face.
    """
    lights = point_lights(scene, time_s)
    flat, smooth = (replace(expressible(scene, False, normals), lights=lights) for normals in (False, True))
    shiny = replace(expressible(scene, True, False), lights=lights)
    if not any(max(p.material.phong.specular) > 0 for p in shiny.static if p.material.phong is not None):
        shiny = with_mirrors(shiny)
    return [
        Case(
            "path, mirrors and textures",
            shiny,
            "path",
            (AS_IT_IS, STARTS, BAKED) if scene.movers else (AS_IT_IS, STARTS),
        ),
        Case("direct, point lights", flat, "direct", (AS_IT_IS, STARTS, CONES)),
        Case("direct, area light", replace(flat, lights=(area_light(scene, time_s),)), "direct"),
        Case("direct, vertex normals", smooth, "direct", (STARTS,), RUNS // 4),
    ]


def baked(scene: Scene, time_s: float) -> Scene:
    """``scene`` with its movers standing still as they are at ``time_s``."""
    parts = list(scene.static)
    for mover in scene.movers:
        matrix = mover.track.pose(np.array([time_s]))[0]
        parts += [replace(part, matrix=matrix @ part.matrix) for part in mover.parts]
    return replace(scene, static=tuple(parts), movers=())


def agreement(ours: np.ndarray, theirs: np.ndarray) -> dict[str, float]:
    """Blocks at |z| >= 4, the share below, and how both errors compare."""
    z = z_of_means(ours, theirs, ROUNDING)
    own, other = (means.std(axis=0, ddof=1) for means in (ours, theirs))
    return {
        "blocks": z.size, "beyond_4": int((z >= 4).sum()), "share_below_4": float((z < 4).mean()),
        "median": float(np.median(z)), "largest": float(z.max()), "our_share": float((own <= other).mean()),
        "mean_difference": float((ours.mean(axis=0) - theirs.mean(axis=0)).mean() / theirs.mean()),
    }  # fmt: skip


def compare(case: Case, time_s: float, where: Path) -> dict[str, Any]:
    """Every form of one case; |z| of each block as a picture (white: 8 and more)."""
    start_s = time.perf_counter()
    theirs = their_means(case.scene, tracer_space(case.scene), time_s, case.integrator, case.runs)
    found: dict[str, Any] = {"lit_blocks": float((theirs.mean(axis=0) > 0).mean()), "samples": case.runs * SPP}
    for form in case.forms:
        subject = baked(case.scene, time_s) if form == BAKED else case.scene
        cone_px = 1 / 32 if form == CONES else 0.0
        ours = our_means(subject, SIZE_PX, time_s, OUR_SPP, case.runs, cone_px, as_mitsuba=form != AS_IT_IS)
        found[form] = agreement(ours, theirs)
        name = f"{where}_{case.name}_{form}".replace(", ", "_").replace(" ", "_").replace("'", "")
        z = z_of_means(ours, theirs, ROUNDING)
        picture = np.repeat(np.repeat(np.clip(z / 8, 0, 1), 8, 0), 8, 1)
        Image.fromarray((picture * 255).astype(np.uint8)).save(f"{name}.png")
        np.savez_compressed(f"{name}.npz", ours=ours, theirs=theirs)
    found["seconds"] = time.perf_counter() - start_s
    return found


def main(names: list[str]) -> int:
    """Every case of the scenes ``names`` (all); 1 where one of 1,024 samples agrees in too few blocks (`ASKED`).

    The form that has most in common with Mitsuba counts, the last but for ``cones``; the others say what is left out.
    """
    assets = Path(os.environ.get("STUDYAPP_ASSETS", Path(__file__).parents[3] / "shared" / "assets"))
    activate("auto")
    out = Path("evidence")
    out.mkdir(exist_ok=True)
    held = True
    for name in names or list(FILES):
        scene = load_scene(str(assets / FILES[name]))
        time_s = 0.31 * scene.duration_s
        found: dict[str, Any] = {"size_px": SIZE_PX, "rounding": ROUNDING, "load": os.getloadavg()[0]}
        for case in cases(scene, time_s):
            found[case.name] = compare(case, time_s, out / f"blocks_{name}")
            print(name, case.name, json.dumps(found[case.name]), flush=True)
            (out / f"mitsuba_blocks_{name}.json").write_text(json.dumps(found, indent=2))
            common = BAKED if BAKED in case.forms else STARTS
            held &= case.runs < RUNS or found[case.name][common]["share_below_4"] >= ASKED
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
