"""Mixed reality: virtual objects and their shadows over the camera's picture of a captured room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from renderers.backend import activate
from stimuli.errors import InputError
from stimuli.procedural.shapes import matte
from stimuli.scene import Light
from tests.renderers.polar.shown import polar, show, wall_of_noise
from tests.renderers.scenes import scene_of
from tests.renderers.scenes_by_hand import box, diffuse, quad

activate()


def test_virtual_objects_and_their_shadows_over_the_capture() -> None:
    real = replace(matte("floor", (0.25, 0.5, 0.75)), captured=True)
    floor = quad((-5, -1, 5), (10, 0, 0), (0, 0, -10), real)
    cube = box((0, -0.3, -4), (0.4, 0.2, 0.4), diffuse((1, 0, 0)))
    light = Light("point", (20.0,) * 3, position=(0, 3, -4))
    scene = scene_of(floor, cube, lights=(light,))
    size = (96, 72)
    frame = show(polar(scene, size, mixed_reality=True, width=512, height=512))
    assert frame.alpha.shape == (72, 96)
    capture = np.array((0.25, 0.5, 0.75))

    def at(x: float, y: float, z: float) -> tuple[int, int]:
        pixel = 2 * np.tan(np.pi / 6) / 72
        return int(36 - y / -z / pixel), int(48 + x / -z / pixel)

    free, shadow, object_ = at(2, -1, -4), at(0.0, -1, -3.53), at(0, -0.3, -3.6)
    assert frame.alpha[free] == pytest.approx(0, abs=1e-3)
    np.testing.assert_allclose(frame.color[free], capture, atol=1e-3)
    assert frame.alpha[shadow] == pytest.approx(1, abs=1e-3)  # the only light is gone
    np.testing.assert_allclose(frame.color[shadow], 0, atol=1e-3)
    assert frame.alpha[object_] == pytest.approx(1, abs=1e-6)
    assert frame.color[object_][1] < 0.01  # the cube's own colour, not the room's
    assert frame.alpha[0].max() == 0  # above the horizon: neither room nor object
    with pytest.raises(InputError, match="captured"):
        polar(wall_of_noise(), size, mixed_reality=True)
