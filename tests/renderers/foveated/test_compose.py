"""What a frame leaves to the next one: pictures of their own memory, samples alone at first, light that may be lent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from renderers.backend import mi
from renderers.eccentricity import eye_plane, picture_eccentricity_deg
from renderers.engine import Engine
from renderers.foveated.compose import cacheable, lends_light
from renderers.foveated.technique import Foveated
from renderers.foveated.words import gathered
from renderers.parameters import Foveated as Parameters
from renderers.technique import Frame
from stimuli.scene import Scene
from tests.renderers.foveated.test_technique import (
    DISPLAY,
    NO_MARKS,
    SIZE,
    lit_scene,
    made,
    vanilla_frame,
    view,
    wall,
)
from tests.renderers.scenes import SlidingCamera, noise_pixels, quad, scene_of, unlit


def rendered(scene: Scene, frames: int, lighting: str = "direct", **params: object) -> tuple[Foveated, list[Frame]]:
    technique = Foveated(Engine(scene, lighting=lighting), SIZE, Parameters(**params), 3, "total")
    return technique, [technique.render(view(scene, k)) for k in range(frames)]


@pytest.mark.parametrize("scene", [wall(SlidingCamera((0.4, 0.0, 0.0))), lit_scene()])
def test_a_frame_keeps_its_picture_while_later_ones_are_rendered(scene: Scene) -> None:
    technique = Foveated(Engine(scene), SIZE, Parameters(), 3, "total")
    frames, kept = [], []
    for k in range(5):
        frames.append(technique.render(view(scene, k)).color)
        kept.append(frames[-1].copy())
    for frame, wanted in zip(frames, kept, strict=True):
        np.testing.assert_array_equal(frame, wanted)
    assert not np.array_equal(frames[0], frames[4])


def test_the_words_hold_what_is_shown() -> None:
    """Of a point-lit picture the colour itself, of sampled light what it is made of (before the post filter)."""
    for scene, error in ((wall(SlidingCamera((0.4, 0.0, 0.0))), 1 / 65536), (lit_scene(), 4 / 2048)):
        technique, frames = rendered(scene, 3, post_filter=0)
        picture, layout = technique._picture, technique._layout
        assert picture is not None
        found = gathered(layout, picture.words, technique._scanline)
        color = found["shown"] if layout == "shown" else found["surface"] + found["albedo"] * found["light"]
        wanted = np.minimum(frames[-1].color, 1)  # white is 1 where the exposure is
        np.testing.assert_allclose(np.minimum(color.numpy(), 1).T.reshape(wanted.shape), wanted, rtol=error)


def test_what_is_cached_shows_no_more_than_white() -> None:
    rng = np.random.default_rng(5)
    surface, albedo, light = (mi.Color3f(*(10 ** rng.uniform(-3, 2, (3, 500))).astype(np.float32)) for _ in range(3))
    albedo, light.x = albedo * 0.01, mi.Float(0)
    told = cacheable({"surface": surface * 0.02, "albedo": albedo, "light": light}, mi.Float(0.25))
    shown = (told["surface"] + told["albedo"] * told["light"]).numpy()
    wanted = np.minimum((surface * 0.02 + albedo * light).numpy(), 0.25)
    assert 0.2 < (wanted == 0.25).mean() < 0.8
    np.testing.assert_allclose(shown, wanted, rtol=1e-5)
    np.testing.assert_array_equal(told["light"].numpy(), light.numpy())
    (only,) = cacheable({"shown": surface}, mi.Float(0.25)).values()
    np.testing.assert_array_equal(only.numpy(), np.minimum(surface.numpy(), np.float32(0.25)))


@pytest.mark.parametrize("lit", [False, True])
def test_what_is_much_brighter_than_white_does_not_drown_what_is_dark(lit: bool) -> None:
    """Dark and bright squares, the bright ones 20 times white: what is carried over by fractions of pixels keeps their
    mean as it is displayed."""
    squares = np.where(noise_pixels(3, 256, 4)[..., :1] > 127, 255, 30).astype(np.uint8).repeat(3, axis=-1)
    base = lit_scene()
    material = replace(base.static[0].material, unlit=not lit, pbr=unlit(squares).pbr)
    wall_part = quad((-9, -9, -4), (18, 0, 0), (0, 18, 0), material, "wall", 3.0)
    scene = scene_of(wall_part, lights=base.lights if lit else (), camera=SlidingCamera((0.9, 0.5, 0.0)))
    technique = made(scene, p_min=0.1, r0_deg=0.0, r1_deg=0.0, **NO_MARKS)
    bright = np.percentile(vanilla_frame(scene, view(scene, 0)).color, 90)
    exposure = 20 / bright
    for k in range(12):
        frame = technique.render(view(scene, k, exposure=exposure))
    wanted = np.clip(vanilla_frame(scene, view(scene, 11)).color * exposure, 0, 1)
    assert 0.1 < (wanted < 0.9).mean() < 0.9
    found = np.clip(frame.color * exposure, 0, 1)
    carried = (technique.show(view(scene, 11))["sampled"] == 0)[20:-20, 20:-20]
    inner = (slice(20, -20), slice(20, -20))
    assert found[inner][carried].mean() == pytest.approx(wanted[inner][carried].mean(), abs=0.03)


def test_weights_and_ages_of_what_was_traced_and_what_was_not() -> None:
    technique, _ = rendered(wall(SlidingCamera((0.4, 0.0, 0.0))), 1)
    shown = technique.show(view(wall(), 0))
    assert (shown["alpha"] == 1).all()
    assert (shown["samples"] == 1).all()
    assert (shown["age"] == 0).all()
    technique, _ = rendered(wall(SlidingCamera((0.4, 0.0, 0.0))), 4)
    shown = technique.show(view(wall(), 3))
    traced = shown["sampled"] > 0
    assert ((shown["alpha"] > 0) == traced).all()
    assert (shown["age"][traced] == 0).all()
    assert (shown["age"][~traced] >= 1).all()


def test_after_a_cut_the_debug_pictures_tell_of_nothing_before_it() -> None:
    technique, _ = rendered(lit_scene(), 3)
    assert technique.show(view(lit_scene(), 2))["marks"].sum() > 100
    technique.render(view(lit_scene(), 3, cut=True))
    shown = technique.show(view(lit_scene(), 3))
    assert shown["marks"].sum() == 0
    assert (shown["sampled"] == 1).all()
    assert (shown["age"] == 0).all()


@pytest.mark.parametrize("lighting", ["direct", "ambient_occlusion"])
def test_light_is_lent_by_cached_surfaces_outside_of_fovea_and_marks(lighting: str) -> None:
    """A lit wall and a panel before it; at the side nothing at all, and a lamp that only glows."""
    base = lit_scene()
    lamp = quad((1.2, -0.2, -3), (0.4, 0, 0), (0, 0.4, 0), unlit(), "lamp")
    scene = scene_of(*base.static[1:], lamp, lights=base.lights, camera=base.camera)
    technique, _ = rendered(scene, 4, lighting, r0_deg=3.0, r1_deg=6.0)
    picture, shown = technique._picture, technique.show(view(scene, 3))
    assert picture is not None
    lent = lends_light(picture.info).numpy().reshape(SIZE[1], SIZE[0])
    albedo = gathered(technique._layout, picture.words, technique._scanline)["albedo"].numpy().max(axis=0)
    fovea = picture_eccentricity_deg(eye_plane(SIZE, 1.0, DISPLAY, None), SIZE) <= 3.0
    has_light = (albedo > 0).reshape(lent.shape) & (shown["samples"] > 0)
    np.testing.assert_array_equal(lent, has_light & ~fovea & (shown["marks"] == 0))
    assert 50 < lent.sum() < 0.5 * lent.size
