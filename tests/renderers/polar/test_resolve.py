"""Polar to Cartesian: smooth pictures come back, nothing breaks at the gaze or where the angle wraps."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.backend import activate
from renderers.eccentricity import picture_eccentricity_deg
from renderers.polar.panels import eyes_of
from renderers.polar.polar_map import RadialMap, gaze_basis, polar_of
from renderers.technique import ViewGeometry, Viewport
from tests.renderers.polar.pictures import (
    eye_of,
    map_of,
    pixel_directions,
    still_view,
    texel_directions,
    through_buffer,
)

activate()
GAZES = [None, (13.0, -7.0), (30.0, 20.0), (60.0, 0.0), (-90.0, 0.0), (0.0, 90.0), (180.0, 0.0)]
KINDS = ["acuity", "equal_density"]


def waves(d: np.ndarray) -> np.ndarray:
    """A smooth picture: waves of about 15 degrees."""
    return 2 + np.sin(18 * d[..., 0] + 1) * np.cos(14 * d[..., 1]) + 0.5 * np.sin(11 * d[..., 2])


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_smooth_picture_comes_back(kind: str, gaze: tuple[float, float] | None) -> None:
    eye = eye_of((120, 90), gaze=gaze)
    (found,) = through_buffer(waves, eye, kind, (512, 512))
    wanted = waves(pixel_directions(eye.panels[0]))
    behind = gaze == (180.0, 0.0)  # the picture then holds the pole of the map's coarse end
    assert np.abs(found - wanted).max() < (0.2 if behind else 0.02)
    (finer,) = through_buffer(waves, eye, kind, (1024, 1024))
    assert np.abs(finer - wanted).max() < 0.4 * np.abs(found - wanted).max()  # second order: a quarter


@pytest.mark.parametrize("kind", KINDS)
def test_no_seam_at_the_gaze(kind: str) -> None:
    # A picture of half a degree around the gaze in a buffer that reaches 45 degrees: mostly inside the first ring.
    eye, size, radial = eye_of((200, 200), yfov_deg=0.5), (64, 64), RadialMap(kind, 45.0)
    first = radial.centres_deg(size[0])[0]
    theta, _ = polar_of(gaze_basis(eye.panels[0].plane.gaze), pixel_directions(eye.panels[0]))
    inside = theta < min(first, 0.25)
    assert inside.sum() > 40
    noise = np.random.default_rng(5).uniform(0, 1, (size[1], size[0]))
    (found,) = through_buffer(lambda d: noise, eye, kind, size, radial)
    # At the gaze: the mean of opposite texels. A pixel's step sideways changes little on every line through it.
    opposite = (noise[:, 0] + np.roll(noise[:, 0], size[1] // 2)) / 2
    middle = found[99:101, 99:101]
    assert opposite.min() - 0.05 < middle.min() <= middle.max() < opposite.max() + 0.05
    (flat,) = through_buffer(lambda d: np.full(d.shape[:-1], 0.7), eye, kind, size, radial)
    np.testing.assert_allclose(flat, 0.7, rtol=1e-6)
    # A ramp keeps its slope through the gaze: no step, no plateau.
    (ramp,) = through_buffer(lambda d: np.degrees(d[..., 0]), eye, kind, size, radial)
    steps = np.diff(ramp[100]) / 0.0025
    np.testing.assert_allclose(steps, 1, atol=0.02)


def test_the_angle_wraps_without_a_seam() -> None:
    eye = eye_of((101, 101))
    (found,) = through_buffer(waves, eye, "acuity", (512, 256))
    wanted = waves(pixel_directions(eye.panels[0]))
    right = np.s_[50, 51:]  # the row where the angle passes from 360 to 0 degrees
    assert np.abs(found - wanted)[right].max() <= np.abs(found - wanted).max()
    jump = np.abs(np.diff(found - wanted, axis=0))[48:52, 55:].max()
    assert jump < 0.01


def test_texels_outside_a_clamped_radius_take_the_last_ring() -> None:
    eye = eye_of((40, 30))
    radial = map_of(eye)
    assert texel_directions(radial, (8, 8), eye.panels[0].plane.gaze).shape == (8, 8, 3)
    (found,) = through_buffer(lambda d: np.broadcast_to(np.arange(8.0), (8, 8)), eye, "acuity", (8, 8))
    assert found.max() < 7 + 1e-5
    assert found[0, 0] == pytest.approx(7)


def test_a_screen_is_seen_at_its_angles() -> None:
    geometry = ViewGeometry(0.6, 0.34, 0.5, (0.1, -0.05))
    eye = eye_of((160, 90), geometry=geometry, gaze=(8.0, 3.0))
    plane = eye.panels[0].plane
    basis = gaze_basis(plane.gaze)
    theta, _ = polar_of(basis, pixel_directions(eye.panels[0]))
    np.testing.assert_allclose(theta, picture_eccentricity_deg(plane, (160, 90)), atol=1e-9)

    def eccentricity(d: np.ndarray) -> np.ndarray:
        return polar_of(basis, d)[0]

    (found,) = through_buffer(eccentricity, eye, "acuity", (256, 64))
    within = (theta > 0.5) & (theta < 43)  # the last half texel is clamped
    np.testing.assert_allclose(found[within], theta[within], atol=0.02)


def test_four_viewports_come_from_one_buffer_an_eye() -> None:
    viewports = tuple(
        Viewport(f"{side} {kind}", size, np.radians(field), offset, kind == "inset")
        for side, offset in (("left", -0.03), ("right", 0.03))
        for kind, size, field in (("inset", (80, 60), 20.0), ("surround", (99, 99), 90.0))
    )
    view = still_view((99, 99), gaze=(12.0, -9.0))
    eyes = eyes_of(view.__class__(**{**view.__dict__, "viewports": viewports}), (99, 99))
    assert [eye.offset_m for eye in eyes] == [-0.03, 0.03]
    for eye in eyes:
        found = through_buffer(waves, eye, "acuity", (512, 512))
        for panel, picture in zip(eye.panels, found, strict=True):
            assert np.abs(picture - waves(pixel_directions(panel))).max() < 0.05
        inset = pixel_directions(eye.panels[0])
        assert inset[29:31, 39:41].mean(axis=(0, 1)) @ np.array(eye.panels[0].plane.gaze) > 0.9999
