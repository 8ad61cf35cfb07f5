"""The moving fixation target stands in view, in front of the scene, and moves smoothly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from renderers.fixation_target import (
    NEARNESS,
    REACH,
    SPEED_DEG_S,
    least_depth,
    target_path,
    with_fixation_target,
)
from stimuli import load_scene
from stimuli.scene import Mover
from tests.renderers.scenes import SlidingCamera, quad, scene_of, unlit


def test_it_is_nearer_than_a_wall_and_within_the_view() -> None:
    scene = scene_of(quad((-9, -9, -5), (18, 0, 0), (0, 18, 0), unlit(), "wall"))
    path = target_path(scene.camera.yfov_rad, 8.0, 0)
    assert least_depth(scene, scene.camera, path, 0.0, 8.0) == pytest.approx(5.0, rel=1e-4)
    made = with_fixation_target(scene, scene.camera, 0.0, 8.0)
    places = made.movers[-1].track.pose(np.linspace(0, 8.0, 401))[:, :3, 3]
    np.testing.assert_allclose(-places[:, 2], 5.0 * NEARNESS, rtol=1e-4)
    field = np.tan(scene.camera.yfov_rad / 2)
    seen = places[:, :2] / -places[:, 2:]
    assert np.abs(seen).max() <= REACH * field * 1.0001
    assert np.ptp(seen, axis=0).max() > 0.5 * REACH * field  # across the picture
    speed = np.linalg.norm(np.diff(seen, axis=0), axis=1) / 0.02
    assert speed.max() <= np.tan(np.radians(SPEED_DEG_S)) * 1.001  # an eye can follow it
    assert np.quantile(speed, 0.1) > 0.7 * np.tan(np.radians(SPEED_DEG_S))  # even, but for the corners


def test_paths_begin_in_the_middle_and_differ_by_seed_alone() -> None:
    paths = [target_path(1.0, 8.0, seed).directions(np.linspace(-1, 8, 90)) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(paths[0], paths[1])
    assert np.abs(paths[0] - paths[2]).max() > 0.1
    for path in paths:
        assert (path[:10, :2] == 0).all()  # it waits there while a clip warms up


@pytest.mark.parametrize("duration_s", [0.0, 0.25, 1.0, 8.0, 20.0])
def test_paths_close_and_take_the_time_of_the_clip(duration_s: float) -> None:
    for seed in range(20):
        path = target_path(1.0, duration_s, seed)
        assert path.times_s[-1] == pytest.approx(duration_s)
        assert (path.corners[[0, -1]] == 0).all()
        assert np.abs(path.corners).max() <= REACH * np.tan(0.5)
        legs = np.linalg.norm(np.diff(path.corners, axis=0), axis=1)
        assert legs.sum() <= np.tan(np.radians(SPEED_DEG_S)) * duration_s * 1.0001
        assert legs.sum() > 0.1 * duration_s * np.tan(np.radians(SPEED_DEG_S)) or duration_s == 0


def test_a_wall_that_moves_in_pushes_the_target_nearer() -> None:
    far = quad((-9, -9, -5), (18, 0, 0), (0, 18, 0), unlit(), "wall")
    scene = scene_of(far)
    coming = replace(scene, static=(), movers=(Mover("wall", (far,), SlidingCamera((0.0, 0.0, 0.5), from_s=0.0)),))
    path = target_path(scene.camera.yfov_rad, 8.0, 0)
    assert least_depth(coming, scene.camera, path, 0.0, 8.0) == pytest.approx(1.0, rel=1e-3)


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
    assert (np.abs(plain - shown).max(axis=2) > 1e-5).sum() < 60
