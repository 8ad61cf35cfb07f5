"""The polar map: HERR's numbers, inverses, densities, sizes, and gazes where a basis could break."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from renderers.eccentricity import eye_plane
from renderers.polar.polar_map import (
    RadialMap,
    buffer_size,
    direction,
    farthest_deg,
    gaze_basis,
    polar_of,
    samples_to,
    width_in_use,
)
from stimuli.errors import InputError

GAZES = [(0.0, 0.0), (31.0, -12.0), (-90.0, 0.0), (90.0, 0.0), (0.0, 90.0), (0.0, -90.0), (180.0, 0.0), (89.0, 0.5)]


def test_766_samples_reach_45_degrees() -> None:
    assert samples_to(45.0) == pytest.approx(765.728, abs=1e-3)  # HERR, 3.2
    assert math.ceil(samples_to(45.0)) == 766
    assert samples_to(45.0) == pytest.approx(quad(lambda e: 200 / (e + 1), 0, 45)[0], abs=1e-6)


@pytest.mark.parametrize("kind", ["acuity", "equal_density"])
@pytest.mark.parametrize("most", [1e-3, 0.5, 45.0, 109.5, 180.0])
def test_share_and_eccentricity_are_inverse_and_grow(kind: str, most: float) -> None:
    radial = RadialMap(kind, most)
    shares = np.linspace(0, 1, 1001)
    eccentricities = radial.eccentricity_deg(shares)
    assert (np.diff(eccentricities) > 0).all()
    assert eccentricities[0] == pytest.approx(0, abs=1e-9 * most)
    assert eccentricities[-1] == pytest.approx(most, rel=1e-9)
    np.testing.assert_allclose(radial.share(eccentricities), shares, atol=1e-9)


@pytest.mark.parametrize("kind", ["acuity", "equal_density"])
def test_samples_lie_as_densely_as_the_formula_says(kind: str) -> None:
    radial, width, height = RadialMap(kind, 45.0), 1024, 1024
    centres = radial.centres_deg(width)
    edges = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 44.0])
    for low, high in itertools.pairwise(edges):
        texels = ((centres >= low) & (centres < high)).sum() * height
        wanted = quad(lambda e: float(radial.density(e, width, height)) * 360 * math.sin(math.radians(e)), low, high)[0]
        assert texels == pytest.approx(wanted, rel=0.02, abs=1.5 * height)


def test_the_first_map_follows_f_along_the_radius_and_the_second_acuity_squared_in_area() -> None:
    at = np.array([0.5, 1, 3, 10, 30])
    per_degree = np.gradient(RadialMap("acuity", 45.0).share(np.linspace(0, 45, 45001)), 1e-3)[(at * 1000).astype(int)]
    np.testing.assert_allclose(per_degree * samples_to(45.0), 200 / (at + 1), rtol=1e-5)
    second = RadialMap("equal_density", 45.0)
    acuity = 1 / (second.mar_slope * at + second.mar_foveal_deg)
    ratio = second.density(at, 1024, 1024) / acuity**2
    # sin e is e within 5 % to 30 degrees: the notes' small angles
    np.testing.assert_allclose(ratio / ratio[0], 1, rtol=0.05)
    first = RadialMap("acuity", 45.0).density(at, 1024, 1024) / acuity**2
    assert first[0] / first[2] > 2  # "too many samples near the look-at area"


@pytest.mark.parametrize("gaze", GAZES)
def test_directions_come_back(gaze: tuple[float, float]) -> None:
    basis = gaze_basis(eye_plane((16, 9), 1.0, None, gaze).gaze)
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(basis) == pytest.approx(-1)  # right x up points back at the eye, away from the gaze
    theta, phi = np.meshgrid(np.linspace(0.01, 179, 37), np.linspace(0.01, 6.27, 41))
    back_theta, back_phi = polar_of(basis, direction(basis, theta, phi))
    np.testing.assert_allclose(back_theta, theta, atol=1e-6)
    np.testing.assert_allclose(back_phi, phi, atol=1e-6)


def test_the_turn_is_counter_clockwise_from_the_right() -> None:
    basis = gaze_basis((0.0, 0.0, -1.0))
    np.testing.assert_allclose(basis[0], (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(basis[1], (0, 1, 0), atol=1e-12)


def test_the_farthest_point_of_a_picture() -> None:
    plane = eye_plane((100, 100), math.pi / 2)
    straight = np.array(plane.gaze)
    assert farthest_deg(plane, (100, 100), straight) == pytest.approx(54.7356, abs=1e-3)  # HERR's 90 x 90 degrees
    corner = np.array([1, 1, -1]) / math.sqrt(3)
    assert farthest_deg(plane, (100, 100), corner) == pytest.approx(109.471, abs=0.6)
    assert farthest_deg(plane, (100, 100), -straight) == 180.0
    up = farthest_deg(plane, (100, 100), np.array([0.0, 1.0, 0.0]))
    assert 125.2 <= up <= 136  # the lower edge's middle is 135 degrees away


def test_buffer_sizes() -> None:
    assert buffer_size(60.0, 45.0, None, None) == (1024, 1024)
    assert buffer_size(15.0, 45.0, None, None) == (256, 256)
    wide, high = buffer_size(15.0, 54.7, None, None)
    assert wide == math.ceil(256 * samples_to(54.7) / samples_to(45.0))
    assert high == 256
    assert buffer_size(1e-6, 1.0, None, None) == (2, 4)
    wide, high = buffer_size(3e4, 0.001, None, None, pixels=1200)  # a narrow field: no more texels than pixels
    assert 2 <= wide * high <= 1200
    assert buffer_size(15.0, 45.0, 77, 90) == (77, 90)
    with pytest.raises(InputError, match="odd height"):
        buffer_size(15.0, 45.0, 77, 91)


def test_the_width_falls_with_head_speed_and_is_clamped() -> None:
    widths = [width_in_use(1024, speed, 1 / 200, 0.5) for speed in (0, 20, 50, 100, 1e9)]
    assert widths == [1024, 922, 768, 512, 512]
    assert width_in_use(2, 1e9, 1 / 200, 0.5) == 2
