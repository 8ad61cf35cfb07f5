"""The engine's pictures against Mitsuba's `direct` and `path` where both can express the scene.

Full length (512x288, 1,024 samples, real scenes) in tests/prove/mitsuba_blocks.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyrender
import pytest

from renderers.backend import mi
from renderers.engine import Engine
from renderers.mitsuba_scene import diffuse_only, mitsuba_scene
from stimuli import load_scene
from stimuli.scene import Light, Material
from tests.renderers.mitsuba_oracle import block_means, centre_pictures, emitter_quad, our_means, z_of_means
from tests.renderers.scenes_by_hand import box, crowd, diffuse, look_at, pbr, quad, scene

RUNS = 16
ROUNDING = 2e-4


def their_means(there: Any, integrator: Any, spp: int) -> np.ndarray:
    """(RUNS, rows, columns) block means of Mitsuba's renders."""
    renders = (mi.render(there, integrator=integrator, spp=spp, seed=seed) for seed in range(RUNS))
    return np.array([block_means(np.array(picture)) for picture in renders])


@pytest.mark.parametrize("name", ["tunnel_geom", "bart_kitchen/bart_kitchen.glb", "bart_robots/bart_robots.glb"])
def test_direct_light_equals_mitsubas_but_for_its_shadow_edges(assets, name: str) -> None:
    """Same rays, one point light, no randomness. Mitsuba starts shadow rays 9e-5 (1 + |p|) off the surface, ours 5e-6:
    they differ at the edges of shadows and in gaps that narrow."""
    subject = diffuse_only(load_scene(name if name == "tunnel_geom" else str(assets / name)))
    time_s = subject.duration_s * 0.25
    pose = subject.camera.pose(np.array([time_s]))[0]
    if name == "tunnel_geom":  # its own lamp, falling off as Mitsuba's do
        subject = replace(subject, lights=(Light("point", (18.0, 17.0, 15.0), subject.lights[0].position),))
    else:
        place = pose[:3, 3] + 0.1 * Engine(subject).space.radius * pose[:3, 1]
        strength = (0.1 * Engine(subject).space.radius) ** 2
        subject = replace(subject, lights=(Light("point", (strength,) * 3, tuple(place)),))
    ours, theirs = centre_pictures(subject, (256, 144), time_s)
    assert (theirs > 0).mean() > 0.2
    apart = np.abs(ours - theirs).max(axis=1) > 1e-3 * (1 + theirs.max(axis=1))
    assert apart.mean() < 0.02


def test_area_light_and_movers_equal_direct_in_every_block() -> None:
    light = Light(
        "area", (6.0, 5.0, 4.0), direction=(0, 0, -1), corner=(-1.5, -1, 4), edge_u=(1, 0, 0), edge_v=(0, 1, 0)
    )
    subject = scene((quad((-3, -3, -1), (6, 0, 0), (0, 6, 0), diffuse((0.7, 0.6, 0.5))),), crowd(8), (light,))
    size = (64, 48)
    ours = our_means(subject, size, 0.0, spp=16, runs=RUNS)
    there = mitsuba_scene(subject, Engine(subject).space, size)
    integrator = mi.load_dict({"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True})
    assert (z_of_means(ours, their_means(there, integrator, 32), ROUNDING) < 4).all()


def test_textures_and_mirrors_equal_path_in_every_block() -> None:
    """Glowing textured quads seen directly and in a mirror box."""
    image = np.random.default_rng(0).integers(0, 256, (16, 16, 4), dtype=np.uint8)
    image[..., 3] = 255
    sampler = pyrender.Sampler(magFilter=9729, minFilter=9987)
    texture = pyrender.Texture(source=image, source_channels="RGBA", sampler=sampler)
    glow = Material("glow", pbr(baseColorTexture=texture), unlit=True)
    mirror = diffuse((0.0, 0.0, 0.0), ambient=(0, 0, 0), specular=(0.8, 0.7, 0.6))
    places = [((-3, -3, -1), (6, 0, 0), (0, 6, 0)), ((-3, -3, 6), (6, 0, 0), (0, 6, 0))]
    cube = box((0.2, 0.1, 0.6), (0.5, 0.6, 0.4), mirror)
    subject = scene((*(quad(*place, glow) for place in places), cube), camera=look_at((1, 0.8, 4), (0, 0, 0)))
    size = (64, 48)
    ours = our_means(subject, size, 0.0, spp=16, runs=RUNS)
    space = Engine(subject).space
    there = mitsuba_scene(scene((cube,), camera=subject.camera), space, size)
    tree = {f"shape_{k}": shape for k, shape in enumerate(there.shapes())}
    tree |= {f"glow_{k}": emitter_quad(*place, image, space, flip=k == 1) for k, place in enumerate(places)}
    both = mi.load_dict({"type": "scene", "sensor": there.sensors()[0], **tree})
    integrator = mi.load_dict({"type": "path", "max_depth": 5})
    assert (z_of_means(ours, their_means(both, integrator, 32), ROUNDING) < 4).all()
