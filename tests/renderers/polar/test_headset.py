"""Polar in a headset: HERR's four viewports (40 degrees at 60 px a degree, 90 at 22, for each eye), scaled down."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from renderers.backend import activate
from renderers.stereo import headset_viewports
from renderers.technique import ViewGeometry
from stimuli.errors import InputError
from tests.renderers.polar.shown import polar, show, wall_of_noise
from tests.renderers.scenes import scene_of, unlit
from tests.renderers.scenes_by_hand import quad

activate()


def test_four_viewports_take_nine_times_fewer_rays_than_they_have_pixels() -> None:
    viewports = headset_viewports("polar", 1 / 4)
    size = viewports[0].size_px
    frame = show(polar(wall_of_noise(), size, quality=1), viewports=viewports)
    pixels = sum(v.size_px[0] * v.size_px[1] for v in viewports)
    assert list(frame.viewports) == ["left inset", "left surround", "right inset", "right surround"]
    for v in viewports:
        assert frame.viewports[v.name].shape == (*v.size_px[::-1], 3)
    np.testing.assert_array_equal(frame.color, frame.viewports["left inset"])
    assert pixels / frame.rays["primary"] > 5
    assert frame.viewports["left inset"].min() > 0


def test_each_eye_sees_from_its_own_place() -> None:
    near = scene_of(quad((-0.05, -5, -1), (0.1, 0, 0), (0, 10, 0), unlit()), background=(0.2, 0.2, 0.2))
    frame = show(polar(near, (64, 64), width=256, height=256), viewports=headset_viewports("polar", 1 / 20))
    middle = {}
    for name in ("left surround", "right surround"):
        row = frame.viewports[name][frame.viewports[name].shape[0] // 2, :, 0] - 0.2
        middle[name] = (row * (np.arange(len(row)) + 0.5 - len(row) / 2)).sum() / row.sum() * 2 / len(row)
    # 90 degrees: half the width is 1 at distance 1; the left eye sees the bar to the right.
    assert middle["left surround"] == pytest.approx(0.032, abs=0.01)
    assert middle["right surround"] == pytest.approx(-0.032, abs=0.01)


def test_viewports_on_a_screen_or_of_equal_names_are_refused() -> None:
    technique = polar(wall_of_noise(), (16, 16))
    v = headset_viewports("polar", 1 / 20)
    with pytest.raises(InputError, match="headset"):
        show(technique, viewports=v, geometry=ViewGeometry(0.6, 0.3, 0.5))
    with pytest.raises(InputError, match="names"):
        show(technique, viewports=(v[0], v[0]))
    with pytest.raises(InputError, match="left inset"):
        show(technique, viewports=(replace(v[0], yfov_rad=np.pi),))
