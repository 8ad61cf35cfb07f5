"""Metrics on pictures whose error can be worked out by hand, and on planted failures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from renderers.metrics import Comparison, flicker, pixels_per_degree, psnr_db, ring_rmse, sequence_error, tracked_mean
from renderers.technique import ViewGeometry


def moving_texture(n: int, speed: int, size: int = 48) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    wide = np.kron(rng.random((size // 4, 40, 3)), np.ones((4, 4, 1)))
    frames = np.stack([wide[:, 80 - k * speed : 80 - k * speed + size] for k in range(n)])
    motion = np.zeros((*frames.shape[:3], 2))
    motion[..., 0] = speed
    return frames, motion


def test_the_same_sequence_has_no_error() -> None:
    frames, motion = moving_texture(8, 2)
    error = sequence_error(frames, frames, motion, 30.0)
    assert error.rmse == error.rmse_still == error.rmse_tracking == error.flicker == error.flip_still == 0
    assert error.psnr_db == math.inf


def test_a_constant_offset_is_its_own_rmse_and_does_not_flicker() -> None:
    frames, motion = moving_texture(8, 1)
    error = sequence_error(np.clip(frames, 0, 0.9) + 0.1, np.clip(frames, 0, 0.9), motion, 30.0)
    assert error.rmse == pytest.approx(0.1, abs=1e-6)
    assert error.rmse_still == pytest.approx(0.1, abs=1e-6)
    assert error.flicker == pytest.approx(0.0, abs=1e-6)
    assert error.psnr_db == pytest.approx(20.0, abs=1e-4)


def test_alternating_error_is_all_flicker_and_none_to_the_eye() -> None:
    reference = np.full((8, 16, 16, 3), 0.5)
    test = reference + 0.1 * np.array([1, -1] * 4)[:, None, None, None]
    error = sequence_error(test, reference, np.zeros((8, 16, 16, 2)), 30.0)
    assert error.flicker == pytest.approx(0.1, abs=1e-6)
    assert error.rmse == pytest.approx(0.1, abs=1e-6)
    assert error.rmse_still == pytest.approx(0.0, abs=1e-6)


def test_the_tracking_eye_sees_a_moving_texture_sharp() -> None:
    frames, motion = moving_texture(4, 3)
    seen = tracked_mean(frames, motion)
    np.testing.assert_allclose(seen[:, 12:], frames[-1][:, 12:], atol=1e-6)
    assert np.abs(frames.mean(0) - frames[-1])[:, 12:].max() > 0.2  # the still eye does not


def test_following_is_bilinear_and_clamped_to_the_edge() -> None:
    rng = np.random.default_rng(3)
    pictures, motion = rng.random((3, 9, 12, 3)), 8 * rng.random((3, 9, 12, 2)) - 4
    y, x = np.mgrid[0:9, 0:12].astype(float)
    total = pictures[2].copy()
    for k in (2, 1):  # scipy's own sampling, a step at a time
        sampled = [map_coordinates(motion[k][..., c], (y, x), order=1, mode="nearest") for c in (0, 1)]
        x, y = x - sampled[0], y - sampled[1]
        total += np.stack(
            [map_coordinates(pictures[k - 1][..., c], (y, x), order=1, mode="nearest") for c in range(3)], 2
        )
    np.testing.assert_allclose(tracked_mean(pictures, motion), total / 3, atol=1e-5)


def test_a_comparison_made_once_gives_each_sequence_its_own_error() -> None:
    frames, motion = moving_texture(8, 2)
    others = [np.clip(frames + shift, 0, 1) for shift in (0.05, 0.1)]
    once = Comparison(frames, motion, 30.0, 1)
    assert [once.error(other) for other in others] == [sequence_error(o, frames, motion, 30.0, 1) for o in others]
    assert once.error(frames).rmse_gaze is None


def test_one_refresh_late_is_worse_than_on_time_for_both_eyes() -> None:
    frames, motion = moving_texture(9, 2)
    error = sequence_error(frames[:-1], frames[1:], motion[1:], 30.0)
    assert min(error.rmse_still, error.rmse_tracking, error.flip_still, error.flip_tracking) > 0.01


def test_flicker_of_short_sequences_is_zero() -> None:
    assert flicker(np.ones((2, 4, 4, 3))) == 0.0


def test_lengths_must_agree() -> None:
    with pytest.raises(ValueError, match="cannot be compared"):
        sequence_error([np.zeros((2, 2, 3))], [], [np.zeros((2, 2, 2))], 30.0)


def test_pixels_per_degree_of_a_screen_and_of_a_camera() -> None:
    assert pixels_per_degree(1920, 1080, 1.0, ViewGeometry(0.53, 0.3, 0.7)) == pytest.approx(
        math.pi / 180 * 0.7 * 1920 / 0.53
    )
    assert pixels_per_degree(90, 90, math.pi / 2, None) == pytest.approx(1.0)


def test_rings_split_the_error_by_eccentricity() -> None:
    eccentricity = np.tile(np.arange(10.0), (4, 1))
    test = np.zeros((4, 10, 3))
    test[:, 5:] = 0.2
    rings = ring_rmse(test, np.zeros_like(test), eccentricity, [0, 5, 10, 20])
    assert rings[0] == 0 and rings[1] == pytest.approx(0.2) and math.isnan(rings[2])  # noqa: PT018


def test_psnr_of_a_tenth_is_twenty_decibels() -> None:
    assert psnr_db(0.1) == pytest.approx(20.0)
