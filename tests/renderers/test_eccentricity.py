"""Angles at the eye, against trigonometry by hand; the device's against the host's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from renderers.backend import activate, mi
from renderers.eccentricity import (
    angles_of,
    direction_of,
    eccentricity_deg,
    eye_plane,
    gaze_at,
    picture_eccentricity_deg,
)
from renderers.eye_angles import pixel_eccentricity_deg, plane_values
from renderers.technique import ViewGeometry
from stimuli.errors import InputError

SCREEN = ViewGeometry(0.6, 0.4, 0.5)


def test_a_screen_point_is_seen_at_the_angle_of_its_tangent() -> None:
    plane = eye_plane((600, 400), 1.0, SCREEN)
    assert eccentricity_deg(plane, 300, 200) == pytest.approx(0, abs=1e-9)
    assert eccentricity_deg(plane, 600, 200) == pytest.approx(math.degrees(math.atan(0.3 / 0.5)))
    assert eccentricity_deg(plane, 300, 0) == pytest.approx(math.degrees(math.atan(0.2 / 0.5)))


def test_without_geometry_the_display_subtends_the_cameras_field() -> None:
    plane = eye_plane((1182, 1464), math.radians(106))
    assert eccentricity_deg(plane, 591, 0) == pytest.approx(53)
    assert 2 * eccentricity_deg(plane, 0, 732) == pytest.approx(94, abs=0.1)  # the DK2's field


def test_a_gaze_off_centre_is_at_its_own_point_and_the_centre_is_as_far_as_the_gaze() -> None:
    plane = eye_plane((600, 400), 1.0, SCREEN, (20.0, 0.0))
    assert eccentricity_deg(plane, 300 + 1000 * 0.5 * math.tan(math.radians(20)), 200) == pytest.approx(0, abs=1e-6)
    assert eccentricity_deg(plane, 300, 200) == pytest.approx(20)


def test_an_offset_screen_counts_from_its_own_centre() -> None:
    aside = ViewGeometry(0.6, 0.4, 0.5, (0.3, 0.1))
    assert eccentricity_deg(eye_plane((60, 40), 1.0, aside), 30, 20) == pytest.approx(0, abs=1e-6)
    azimuth = math.degrees(math.atan2(0.3, 0.5))
    straight_ahead = gaze_at((0.0, 0.0), aside)
    assert straight_ahead[0] == pytest.approx(-azimuth)
    e = eccentricity_deg(eye_plane((60, 40), 1.0, aside, straight_ahead), 0, 20 + 10)
    assert e == pytest.approx(0, abs=1e-6)  # the foot point is half a width to the left, 0.1 m down


def test_directions_and_angles_are_inverse() -> None:
    for azimuth, elevation in ((0.0, 0.0), (30.0, -20.0), (-100.0, 60.0), (179.0, 0.0)):
        assert angles_of(direction_of(azimuth, elevation)) == pytest.approx((azimuth, elevation))


@pytest.mark.parametrize("gaze", [(math.nan, 0.0), (0.0, math.inf)])
def test_a_gaze_that_is_not_finite_is_refused(gaze: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="gaze"):
        eye_plane((8, 8), 1.0, SCREEN, gaze)


@pytest.mark.parametrize("geometry", [ViewGeometry(0, 1, 1), ViewGeometry(1, math.nan, 1), ViewGeometry(1, 1, -1)])
def test_a_geometry_without_size_is_refused(geometry: ViewGeometry) -> None:
    with pytest.raises(InputError, match="view_geometry"):
        eye_plane((8, 8), 1.0, geometry)


@pytest.mark.parametrize("gaze", [None, (12.0, -7.0), (80.0, 40.0), (170.0, 0.0)])
def test_kernels_agree_with_the_host(gaze: tuple[float, float] | None) -> None:
    activate()
    plane = eye_plane((37, 23), 1.2, None, gaze)
    x, y = np.meshgrid(np.arange(37) + 0.5, np.arange(23) + 0.5)
    found = pixel_eccentricity_deg(plane_values(plane), mi.Float(x.ravel()), mi.Float(y.ravel())).numpy()
    np.testing.assert_allclose(found.reshape(23, 37), picture_eccentricity_deg(plane, (37, 23)), atol=2e-4)


@pytest.mark.parametrize("geometry", [None, SCREEN, ViewGeometry(0.6, 0.4, 0.5, (0.2, -0.1))])
@pytest.mark.parametrize("point", [(0.2, 0.15), (-0.25, 0.1), (0.0, -0.2)])
def test_the_gaze_at_a_point_has_no_eccentricity_there(
    geometry: ViewGeometry | None, point: tuple[float, float]
) -> None:
    """The moving target: wherever it is drawn, the fovea is on it."""
    size = (600, 400)
    plane = eye_plane(size, 1.0, geometry, gaze_at(point, geometry))
    low, step_x, step_y = plane.corner, plane.step_x[0], plane.step_y[1]
    x_px, y_px = (point[0] - low[0]) / step_x, (point[1] - low[1]) / step_y
    assert eccentricity_deg(plane, x_px, y_px) == pytest.approx(0, abs=1e-6)
