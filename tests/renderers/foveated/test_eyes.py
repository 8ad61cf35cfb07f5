"""The eyes of a headset: parallax, a history each, and what cannot be a viewport."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from renderers.engine import Engine
from renderers.foveated.technique import Foveated
from renderers.parameters import Foveated as Parameters
from renderers.stereo import OCULUS_DK2
from renderers.technique import Viewport
from stimuli import load_scene
from stimuli.errors import InputError
from tests.renderers.foveated.test_technique import DISPLAY, made, view, wall


def test_both_eyes_of_a_headset_render_and_see_with_parallax() -> None:
    scene = load_scene("voxel_city")
    engine = Engine(scene)
    size = (78, 96)
    assert np.degrees(OCULUS_DK2.xfov_rad) == pytest.approx(94, abs=0.1)
    pictures = []
    for eye in OCULUS_DK2.eyes(scene.camera):
        technique = Foveated(engine, size, Parameters(), 1, "total")
        for k in range(3):
            frame = technique.render(view(scene, k, size, camera=eye, geometry=None))
        pictures.append(frame.color.copy())
    left, right = (eye.pose(np.array([1.0]))[0] for eye in OCULUS_DK2.eyes(scene.camera))
    assert np.linalg.norm(right[:3, 3] - left[:3, 3]) == pytest.approx(0.064)
    assert not np.array_equal(*pictures)
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.2


def headset(size_px: tuple[int, int] = (78, 96)) -> tuple[Viewport, ...]:
    """The DK2's two eyes at a small size."""
    half = OCULUS_DK2.eyes_apart_m / 2
    return tuple(
        Viewport(name, size_px, OCULUS_DK2.yfov_rad, offset) for name, offset in (("left", -half), ("right", half))
    )


@pytest.mark.parametrize("configuration", ["medium", "full"])
def test_the_viewports_of_a_headset_are_its_eyes_each_by_itself(configuration: str) -> None:
    scene = load_scene("tunnel_geom")
    engine, size = Engine(scene), (78, 96)
    together = Foveated(engine, size, Parameters(configuration=configuration), 4, "total")
    eyes = [Foveated(engine, size, Parameters(configuration=configuration), 4, "total") for _ in range(2)]
    for k in range(3):
        at = view(scene, k, size, gaze=(8.0, 3.0), geometry=None)
        frame = together.render(replace(at, viewports=headset()))
        alone = [
            technique.render(replace(at, camera=camera))
            for technique, camera in zip(eyes, OCULUS_DK2.eyes(scene.camera), strict=True)
        ]
    assert list(frame.viewports) == ["left", "right"]
    for picture, own in zip(frame.viewports.values(), alone, strict=True):
        np.testing.assert_array_equal(picture, own.color)
    np.testing.assert_array_equal(frame.color, alone[0].color)
    assert dict(frame.rays) == {kind: sum(own.rays[kind] for own in alone) for kind in alone[0].rays}
    assert frame.seconds["total"] > 0
    assert {"left.marks", "right.sampled"} <= set(together.show(replace(at, viewports=headset())))
    together.close()


def test_viewports_that_cannot_be_are_refused() -> None:
    scene = wall()
    technique = made(scene)
    left, right = headset()
    for wrong, geometry, message in (
        ((left, left), None, "a different one each"),
        ((left, right), DISPLAY, "viewports are a headset's"),
        ((replace(left, centred_on_gaze=True),), None, "centred_on_gaze"),
    ):
        with pytest.raises(InputError, match=message):
            technique.render(view(scene, 0, viewports=wrong, geometry=geometry))
