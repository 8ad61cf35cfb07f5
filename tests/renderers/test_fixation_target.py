"""The moving fixation target stands in view, in front of the scene, and moves smoothly."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.fixation_target import NEARNESS, PERIOD_S, REACH, least_depth, with_fixation_target
from stimuli import load_scene
from tests.renderers.scenes import quad, scene_of, unlit


def test_it_is_nearer_than_a_wall_and_within_the_view() -> None:
    scene = scene_of(quad((-9, -9, -5), (18, 0, 0), (0, 18, 0), unlit(), "wall"))
    assert least_depth(scene, scene.camera, 0.0, 8.0) == pytest.approx(5.0, rel=1e-4)
    made = with_fixation_target(scene, scene.camera, 0.0, 8.0)
    places = made.movers[-1].track.pose(np.linspace(0, PERIOD_S, 400))[:, :3, 3]
    np.testing.assert_allclose(-places[:, 2], 5.0 * NEARNESS, rtol=1e-4)
    field = np.tan(scene.camera.yfov_rad / 2)
    assert np.abs(places[:, :2] / -places[:, 2:]).max() <= REACH * field * 1.0001
    assert np.abs(np.diff(places, axis=0)).max() < 0.3


def test_a_scene_with_its_own_target_keeps_it() -> None:
    scene = scene_of(quad((-9, -9, -5), (18, 0, 0), (0, 18, 0), unlit(), "wall"))
    once = with_fixation_target(scene, scene.camera, 0.0, 8.0)
    assert with_fixation_target(once, scene.camera, 0.0, 8.0) is once


def test_it_is_seen_in_a_procedural_scene() -> None:
    from renderers import render_clip

    scene = load_scene("tunnel_geom")
    made = with_fixation_target(scene, scene.camera, 1.0, 1.0)
    plain = next(render_clip(scene, "vanilla", (320, 240), duration_s=1 / 240, start_s=1.0, exposure=1.0)).color
    shown = next(render_clip(made, "vanilla", (320, 240), duration_s=1 / 240, start_s=1.0, exposure=1.0)).color
    green = (shown[..., 1] > 0.7) & (shown[..., 0] < 0.1)
    assert green.any()
    assert green[117:123, 157:163].any()  # the path begins in the middle
    assert (np.abs(plain - shown).max(axis=2) > 0).sum() < 60
