"""What a frame leaves to the next one: pictures of their own memory, samples alone at first, light that may be lent."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.eccentricity import eye_plane, picture_eccentricity_deg
from renderers.engine import Engine
from renderers.foveated.compose import lends_light
from renderers.foveated.technique import Foveated
from renderers.foveated.words import gathered
from renderers.parameters import Foveated as Parameters
from renderers.technique import Frame
from stimuli.scene import Scene
from tests.renderers.foveated.test_technique import DISPLAY, SIZE, lit_scene, view, wall
from tests.renderers.scenes import SlidingCamera, quad, scene_of, unlit


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
        np.testing.assert_allclose(color.numpy().T.reshape(frames[-1].color.shape), frames[-1].color, rtol=error)


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
