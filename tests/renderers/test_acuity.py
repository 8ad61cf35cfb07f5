"""Errors as an eye resolves them: where it looks, and how fine."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.acuity import GazeError, resolved_px
from renderers.eccentricity import eye_plane, gaze_point_px, picture_eccentricity_deg
from stimuli.errors import InputError

SIZE, PPD = (96, 64), 20.0


def seen_from(x_px: float, y_px: float) -> GazeError:
    columns, rows = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    return GazeError(np.hypot(columns - x_px, rows - y_px) / PPD * 8, PPD)


def patch(x: int, y: int, noise: bool = False) -> np.ndarray:
    """A picture that is wrong on 16x16 pixels: by 0.1, or by 0.1 of either sign at random."""
    wrong = np.zeros((SIZE[1], SIZE[0], 3))
    sign = np.random.default_rng(0).choice([-1, 1], (16, 16, 1)) if noise else 1.0
    wrong[y : y + 16, x : x + 16] = 0.1 * sign
    return wrong


def test_an_error_counts_most_where_the_eye_looks() -> None:
    gaze, nothing = seen_from(20, 32), np.zeros((SIZE[1], SIZE[0], 3))
    there, elsewhere = gaze.rmse(patch(12, 24), nothing), gaze.rmse(patch(76, 24), nothing)
    assert there > 1.5 * elsewhere > 0


def test_fine_noise_is_forgiven_far_from_the_gaze_and_not_near_it() -> None:
    nothing = np.zeros((SIZE[1], SIZE[0], 3))
    near, far = seen_from(20, 32), seen_from(20 - 400, 32)
    kept = [gaze.rmse(patch(12, 24, True), nothing) / gaze.rmse(patch(12, 24), nothing) for gaze in (near, far)]
    assert kept[0] > 0.7
    assert kept[1] < 0.35


def test_a_constant_error_is_its_own_rmse_at_any_eccentricity() -> None:
    test = np.full((SIZE[1], SIZE[0], 3), 0.3)
    assert seen_from(10, 10).rmse(test, test - 0.1) == pytest.approx(0.1, rel=1e-5)


def test_where_the_display_is_coarser_than_the_eye_it_is_plain_rmse() -> None:
    rng = np.random.default_rng(1)
    test, reference = rng.random((2, 8, 8, 3))
    plain = float(np.sqrt(np.mean((test - reference) ** 2)))
    assert GazeError(np.full((8, 8), 2.0), 5.0).rmse(test, reference) == pytest.approx(plain, rel=1e-5)


def test_the_resolved_distance_grows_with_eccentricity_and_is_never_below_a_pixel() -> None:
    assert resolved_px(np.array([0.0]), 20.0) == 1.0
    assert resolved_px(np.array([40.0]), 48.0) == pytest.approx(1.0 + 0.022 * 40 * 48)


def test_the_gaze_meets_the_picture_where_its_eccentricity_is_none() -> None:
    plane = eye_plane((64, 48), 0.9, None, (8.0, -5.0))
    x, y = gaze_point_px(plane)
    least = np.unravel_index(np.argmin(picture_eccentricity_deg(plane, (64, 48))), (48, 64))
    assert (int(y), int(x)) == least
    assert gaze_point_px(eye_plane((64, 48), 0.9)) == pytest.approx((32, 24))


def test_a_gaze_away_from_the_picture_meets_it_nowhere() -> None:
    with pytest.raises(InputError, match="gaze"):
        gaze_point_px(eye_plane((64, 48), 0.9, None, (120.0, 0.0)))
