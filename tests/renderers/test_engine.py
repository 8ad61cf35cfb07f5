"""What the engine shades, against answers that can be worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pyrender
import pytest

from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.frozen import frozen
from renderers.vanilla import frame_lanes
from stimuli.errors import InputError
from stimuli.scene import Light, Material, Mover, StillCamera
from tests.renderers.engine_samples import RATE, WALL, sampled
from tests.renderers.scenes_by_hand import Drift, Scaled, box, crowd, diffuse, look_at, pbr, quad, scene


def test_closed_white_box_under_ambient_light_is_one_everywhere() -> None:
    inside = box((0, 0, 0), (1, 1, 1), Material("white", pbr((1.0, 1.0, 1.0))))
    got = sampled(scene((inside,), camera=look_at((0.2, 0.1, 0.5), (0, 0, -1), 100), ambient=(1.0, 1.0, 1.0)), (33, 21))
    np.testing.assert_allclose(got["color"], 1.0, atol=1e-6)
    assert got["hit"].all()


def test_two_facing_mirrors_stop_at_depth_three() -> None:
    """Between mirrors of weight 0.5 and emission-free ambient 1: 1 + 1/2 + 1/4 + 1/8, then dropped."""
    mirror = diffuse((0.0, 0.0, 0.0), ambient=(1.0, 1.0, 1.0), specular=(0.5, 0.5, 0.5))
    inside = box((0, 0, 0), (1, 1, 1), mirror)
    got = sampled(scene((inside,), camera=look_at((0.2, 0.1, 0.5), (0, 0, -1)), ambient=(1.0, 1.0, 1.0)), (17, 11))
    np.testing.assert_allclose(got["color"], 1.875, rtol=1e-6)
    assert (got["reflection"] == 3).all()


def test_a_mirror_below_three_percent_sends_no_ray() -> None:
    faint = diffuse((0.0, 0.0, 0.0), ambient=(1.0, 1.0, 1.0), specular=(0.029, 0.029, 0.029))
    got = sampled(
        scene((box((0, 0, 0), (1, 1, 1), faint),), camera=look_at((0, 0, 0.5), (0, 0, -1)), ambient=(1.0,) * 3)
    )
    assert (got["reflection"] == 0).all()


def test_transmission_goes_straight_on_and_casts_no_shadow() -> None:
    glass = diffuse((0.1, 0.1, 0.1), ambient=(0, 0, 0), transmission=0.5)
    pane = quad((-3, -3, 1), (6, 0, 0), (0, 6, 0), glass)
    light = Light("directional", (np.pi,) * 3, direction=(0.0, 0.0, -1.0))
    got = sampled(scene((WALL, pane), lights=(light,)))
    np.testing.assert_allclose(got["color"], np.tile(0.1 + 0.5 * np.array([0.5, 0.25, 1.0]), (63, 1)), rtol=1e-5)
    assert (got["transmission"] == 1).all()
    np.testing.assert_allclose(got["z"], 4.0, rtol=1e-6)


def test_alpha_blend_covers_by_alpha_and_mask_cuts_out() -> None:
    light = Light("directional", (np.pi,) * 3, direction=(0.0, 0.0, -1.0))
    blend = Material("film", pbr((1.0, 1.0, 1.0), alpha=0.25, alphaMode="BLEND"), unlit=True)
    pane = quad((-3, -3, 1), (6, 0, 0), (0, 6, 0), blend)
    got = sampled(scene((WALL, pane), lights=(light,)))
    np.testing.assert_allclose(got["color"], np.tile(0.25 + 0.75 * np.array([0.5, 0.25, 1.0]), (63, 1)), rtol=1e-5)
    image = np.full((2, 2, 4), 255, np.uint8)
    image[:, 0, 3] = 0  # the left half is cut out
    sampler = pyrender.Sampler(magFilter=9728, minFilter=9728)
    texture = pyrender.Texture(source=image, source_channels="RGBA", sampler=sampler)
    leaf = Material("leaf", pbr(alphaMode="MASK", alphaCutoff=0.5, baseColorTexture=texture), unlit=True)
    got = sampled(scene((WALL, quad((-3, -3, 1), (6, 0, 0), (0, 6, 0), leaf)), lights=(light,)), (8, 5))
    z = got["z"].reshape(5, 8)
    np.testing.assert_allclose(z[:, :4], 5.0, rtol=1e-6)
    np.testing.assert_allclose(z[:, 4:], 4.0, rtol=1e-6)


def test_mirror_and_glass_together_follow_both_rays() -> None:
    both = diffuse((0.0, 0.0, 0.0), ambient=(0, 0, 0), specular=(0.25, 0.25, 0.25), transmission=0.5)
    pane = quad((-3, -3, 1), (6, 0, 0), (0, 6, 0), both)
    glow = Material("glow", pbr((1.0, 0.0, 0.0)), unlit=True)
    behind = Material("behind", pbr((0.0, 1.0, 0.0)), unlit=True)
    walls = (quad((-9, -9, 9), (18, 0, 0), (0, 18, 0), glow), quad((-9, -9, 0), (18, 0, 0), (0, 18, 0), behind), pane)
    got = sampled(scene(walls))
    np.testing.assert_allclose(got["color"], np.tile([0.25, 0.5, 0.0], (63, 1)), rtol=1e-5)
    assert (got["reflection"] == 1).all()
    assert (got["transmission"] == 1).all()


def test_ambient_occlusion_of_open_and_half_closed_places() -> None:
    options = {"lighting": "ambient_occlusion", "ao_samples": 1024, "ao_radius": 50.0}
    open_wall = sampled(scene((WALL,)), (5, 5), rng=True, **options)
    np.testing.assert_allclose(open_wall["light"], 1.0)
    np.testing.assert_allclose(open_wall["color"], np.tile([0.5, 0.25, 1.0], (25, 1)))
    # A tall wall rising from the middle line closes half of the sky of points at its foot.
    tall = quad((0, -40, 0), (0, 80, 0), (0, 0, 40), diffuse())
    camera = StillCamera(look_at((1.0, 0, 3), (0.002, 0, 0)).matrix, np.radians(0.02))
    corner = sampled(scene((WALL, tall), camera=camera), (5, 5), rng=True, **options)
    np.testing.assert_allclose(corner["light"].mean(), 0.5, atol=0.02)
    assert (corner["ambient_occlusion"] == 1024).all()


def test_short_ambient_occlusion_rays_see_only_near_things() -> None:
    lid = quad((-3, -3, 0.5), (6, 0, 0), (0, 6, 0), diffuse())
    camera = look_at((0, 0, 0.4), (0, 0, 0), 30)
    for radius, expected in ((0.2, 1.0), (50.0, 0.0)):
        got = sampled(
            scene((WALL, lid), camera=camera), (3, 3), rng=True, lighting="ambient_occlusion", ao_radius=radius
        )
        assert abs(got["light"].mean() - expected) < 0.06


def test_shading_is_clamped_and_counted() -> None:
    bright = Light("point", (1e30,) * 3, (0.0, 0.0, 2.0))
    got = sampled(scene((WALL,), lights=(bright,)))
    assert (got["color"] == 65504).all()
    assert (got["clamped"] == 1).all()
    got = sampled(scene((WALL,), lights=(Light("point", (np.nan, 1.0, 1.0), (0.0, 0.0, 2.0)),)))
    assert np.isfinite(got["color"]).all()


def test_the_background_is_seen_where_nothing_is() -> None:
    got = sampled(scene(background=(0.1, 0.2, 0.3)))
    np.testing.assert_allclose(got["color"], np.tile([0.1, 0.2, 0.3], (63, 1)), rtol=1e-6)
    assert not got["hit"].any()
    assert np.isinf(got["z"]).all()


@pytest.mark.parametrize(("scale", "offset"), [(1e-6, 0.0), (1.0, 1e5)])
def test_scale_and_place_of_the_world_change_no_pixel(scale: float, offset: float) -> None:
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = offset
    parts = (WALL, box((0.3, 0.1, 0.6), (0.4, 0.3, 0.5), diffuse(specular=(0.3, 0.3, 0.3))))
    plain = scene(parts, crowd(6), (Light("point", (9.0, 8.0, 7.0), (1.0, 1.5, 3.0)),), ambient=(0.1, 0.1, 0.1))
    camera = plain.camera.pose(np.zeros(1))[0].copy()
    camera[:3, 3] = camera[:3, 3] * scale + offset
    light = replace(
        plain.lights[0],
        position=tuple(np.array(plain.lights[0].position) * scale + offset),
        intensity=tuple(np.array(plain.lights[0].intensity) * scale**2),
    )
    moved = replace(
        plain,
        static=tuple(replace(part, matrix=matrix) for part in parts),
        movers=tuple(Mover(m.name, m.parts, Scaled(m.track, matrix)) for m in plain.movers),
        lights=(light,),
        camera=StillCamera(camera, plain.camera.yfov_rad),
    )
    a, b = sampled(plain, (96, 64), want_motion=True), sampled(moved, (96, 64), want_motion=True)
    apart = np.abs(a["color"] - b["color"]).max(axis=1)
    assert (apart > 1e-4).mean() < 0.004  # edges of shadows and bodies
    still = np.abs(a["motion"] - b["motion"]).max(axis=1)
    assert np.quantile(still, 0.99) < 1e-3


def test_motion_is_where_the_point_went() -> None:
    """A box that drifts by 0.48 units a second, 5 units away: pixels a refresh by the camera's own scale."""
    mover = Mover("box", (box((0, 0, 0), (0.5, 0.5, 0.5), diffuse()),), Drift((0, 0, 0), (0.48, -0.24, 0.0)))
    subject = scene((quad((-9, -9, -4), (18, 0, 0), (0, 18, 0), diffuse()),), (mover,))
    got = sampled(subject, (64, 64), want_motion=True)
    on = got["mover"].ravel() == 1
    per_unit = 64 / (2 * np.tan(np.radians(20)) * 4.5)
    assert on.sum() > 20
    np.testing.assert_allclose(
        got["motion"][on], np.tile([0.002 * per_unit, 0.001 * per_unit], (on.sum(), 1)), atol=2e-4
    )
    assert (got["motion"][~on] == 0).all()


def test_a_resting_mover_under_a_resting_camera_has_exactly_no_motion() -> None:
    movers = tuple(Mover(m.name, m.parts, Drift(m.track.start, (0, 0, 0))) for m in crowd(12))
    assert (sampled(scene((WALL,), movers), (64, 64), t1=3.7, want_motion=True)["motion"] == 0).all()


def test_motion_in_a_mirror_is_that_of_the_reflection() -> None:
    """A box beside the camera's axis drifts parallel to the mirror: so does its image, at the image's depth."""
    mirror = diffuse((0.0, 0.0, 0.0), ambient=(0, 0, 0), specular=(1.0, 1.0, 1.0))
    glass = quad((-3, -3, 0), (6, 0, 0), (0, 6, 0), mirror)
    mover = Mover("box", (box((0, 0, 7.0), (6.0, 6.0, 0.5), diffuse()),), Drift((0, 0, 0), (0.48, 0.0, 0.0)))
    got = sampled(scene((glass,), (mover,)), (32, 32), want_motion=True)
    assert got["mirrored"].all()
    per_unit = 32 / (2 * np.tan(np.radians(20)) * (5 + 6.5))
    np.testing.assert_allclose(got["motion"], np.tile([0.002 * per_unit, 0.0], (1024, 1)), atol=2e-4)


def test_one_recording_serves_a_hundred_frames_and_two_sizes() -> None:
    subject = scene((WALL,), crowd(6), (Light("point", (9.0,) * 3, (1.0, 1.5, 3.0)),))
    engine = Engine(subject)

    def kernel(state: Any, x: Any, y: Any) -> Any:
        return engine.sample(state, engine.camera_ray(state, x, y)).color

    run = frozen(kernel)
    pictures = {}
    for index in range(100):
        size = (31, 17) if index % 2 else (15, 9)
        _, x, y = frame_lanes(size)
        state = engine.state(view_at(index, RATE, Fraction(0), size, subject.camera))
        pictures[size] = run(size[0] * size[1], state, x, y).numpy()
    assert run.recordings <= 4
    for size, picture in pictures.items():
        fresh = Engine(subject)
        index = 99 if size == (31, 17) else 98
        _, x, y = frame_lanes(size)
        state = fresh.state(view_at(index, RATE, Fraction(0), size, subject.camera))
        color = fresh.sample(state, fresh.camera_ray(state, x, y)).color.numpy()
        np.testing.assert_allclose(picture, color, atol=1e-6)
    assert run(0, None, None, None) is None


def test_rays_between_the_knots_see_movers_in_between() -> None:
    """Per-ray times: half a refresh before t1, a drifting box stands half a step back."""
    mover = Mover("box", (box((0, 0, 0), (0.5, 0.5, 0.5), diffuse()),), Drift((0, 0, 0), (0, 0, 48.0)))
    subject = scene((), (mover,))
    engine = Engine(subject)
    _, x, y = frame_lanes((3, 3))
    state = engine.state(view_at(0, RATE, Fraction(0), (3, 3), subject.camera))
    from renderers.backend import mi

    time_s = mi.Float(np.linspace(-1 / 240, 0, 9).astype(np.float32))
    z = engine.sample(state, engine.camera_ray(state, x * 0 + 1.5, y * 0 + 1.5, time_s), time_s).z.numpy()
    np.testing.assert_allclose(z, 5 - (0.5 + 48 * np.linspace(-1 / 240, 0, 9)), rtol=1e-5)


def test_wrong_settings_are_named() -> None:
    for options in (
        {"lighting": "radiosity"},
        {"sphere_lights": "box"},
        {"ao_samples": 0},
        {"ao_radius": -1.0},
        {"device": "tpu"},
    ):
        with pytest.raises(InputError, match="wanted"):
            Engine(scene((WALL,)), **options)
    engine = Engine(scene((WALL,)))
    state = engine.state(view_at(0, RATE, Fraction(0), (1, 1), engine.scene.camera))
    with pytest.raises(InputError, match="a square"):
        engine.sample(state, engine.camera_ray(state, 0.5, 0.5), light_samples=3)
