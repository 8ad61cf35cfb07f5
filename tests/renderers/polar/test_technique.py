"""Polar as a technique: rays, penumbras, quality by pose, changes between frames, extremes."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from renderers.backend import activate
from renderers.clip_frames import render_clip, view_at
from renderers.eccentricity import eye_plane, picture_eccentricity_deg
from renderers.engine import Engine
from renderers.parameters import Polar as Parameters
from renderers.parameters import Vanilla as VanillaParameters
from renderers.polar.quality import light_samples, pose_delta
from renderers.polar.technique import Polar
from renderers.technique import View, ViewGeometry
from renderers.vanilla import Vanilla
from stimuli.errors import InputError
from stimuli.procedural.shapes import matte, part, sphere
from stimuli.scene import Light, Mover, StillCamera
from tests.renderers.polar.rooms import cornell
from tests.renderers.polar.shown import RATE, WHITE, Path, polar, shift, show, turn, wall_of_noise
from tests.renderers.scenes import noise_pixels, scene_of, unlit
from tests.renderers.scenes import quad as textured_quad
from tests.renderers.scenes_by_hand import box, diffuse, look_at, quad

activate()


# Rays ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mapping", ["acuity", "equal_density"])
@pytest.mark.parametrize("gaze", [None, (20.0, 10.0), (-90.0, 0.0), (300.0, 0.0), (0.0, 90.0)])
def test_fewer_rays_than_pixels_in_every_view(mapping: str, gaze: tuple[float, float] | None) -> None:
    size = (256, 144)
    frame = show(polar(wall_of_noise(), size, mapping=mapping), gaze=gaze)
    assert 0 < frame.rays["primary"] < size[0] * size[1] / 8
    assert np.isfinite(frame.color).all()
    assert frame.color.min() > 0.0  # every pixel is covered: the wall has no black texel left after filtering


@pytest.mark.parametrize("mapping", ["acuity", "equal_density"])
def test_equal_rays_are_better_within_5_degrees_than_a_uniform_grid(mapping: str) -> None:
    size, scene, gaze = (256, 144), wall_of_noise(), (6.0, -4.0)
    frame = show(polar(scene, size, mapping=mapping), gaze=gaze)
    near = picture_eccentricity_deg(eye_plane(size, scene.camera.yfov_rad, None, gaze), size) < 5
    wanted = show(Vanilla(Engine(scene), size, VanillaParameters(), 0, "total")).color
    scale = np.sqrt(frame.rays["primary"] / (size[0] * size[1]))
    rays = frame.rays["primary"]
    (uniform,) = render_clip(
        scene, "framed_low_resolution", size, 60, 1 / 60, {"samples_per_s": rays * 60}, exposure=1.0
    )
    assert uniform.rays["primary"] == pytest.approx(rays, rel=0.1)
    assert scale < 0.4

    def error(picture: np.ndarray) -> float:
        return float(np.sqrt(np.mean((picture - wanted)[near] ** 2)))

    assert error(frame.color) < 0.6 * error(uniform.color)


def test_texels_are_shown_as_they_would_be_traced() -> None:
    # As wide a buffer as the picture has pixels: near the gaze the picture is a pixel-centred one, to a texel's size.
    size, scene = (64, 48), scene_of(textured_quad((-4, -3, -3), (8, 0, 0), (0, 6, 0), unlit(noise_pixels(3, 8))))
    found = show(polar(scene, size, width=1024, height=1024)).color
    wanted = show(Vanilla(Engine(scene), size, VanillaParameters(), 0, "total")).color
    assert np.abs(found - wanted).mean() < 0.002


def test_a_screen_of_given_geometry_shows_the_cameras_picture() -> None:
    size, scene = (64, 48), scene_of(textured_quad((-4, -3, -3), (8, 0, 0), (0, 6, 0), unlit(noise_pixels(3, 8))))
    wanted = show(Vanilla(Engine(scene), size, VanillaParameters(), 0, "total")).color
    geometry = ViewGeometry(0.6, 0.34, 0.4, (0.12, -0.05))
    found = show(polar(scene, size, width=1024, height=1024), gaze=(5.0, 5.0), geometry=geometry).color
    assert np.abs(found - wanted).mean() < 0.003


# Light ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("samples", "tolerance"), [(1, 0.51), (64, 1 / 8), (256, 1 / 16)])
def test_the_penumbra_of_an_edge_is_the_analytic_one(samples: int, tolerance: float) -> None:
    # A square light at height 2, a half plane x < 0 at height 1, seen from below it.
    light = Light("area", (5.0,) * 3, direction=(0, -1, 0), corner=(-0.4, 2, -0.4), edge_u=(0.8, 0, 0),
                  edge_v=(0, 0, 0.8))  # fmt: skip
    floor = quad((-5, 0, 5), (10, 0, 0), (0, 0, -10), diffuse(WHITE))
    edge = quad((-5, 1, 5), (5, 0, 0), (0, 0, -10), diffuse(WHITE))
    camera = look_at((0, 0.9, 0), (0, 0, 0), 70.0, up=(0, 0, -1))
    size = (81, 27)
    settings = {"quality": samples, "width": 512, "height": 256, "dynamic_width": False}
    lit, shadowed = (
        show(polar(scene_of(*parts, lights=(light,), camera=camera), size, **settings)).color[13, :, 0]
        for parts in ((floor,), (floor, edge))
    )
    x = (np.arange(81) + 0.5 - 40.5) * 2 * np.tan(np.radians(35.0)) / 27 * 0.9
    # A light point X is seen from the floor point x if the line crosses height 1 beyond 0: X > -x (heights 1 and 2).
    u = (np.arange(400) + 0.5) / 400 * 0.8 - 0.4
    lx, lz = np.meshgrid(u, u, indexing="ij")
    weight = 1 / (4 + (lx[None] - x[:, None, None]) ** 2 + lz[None] ** 2) ** 2  # cos cos / d^2 of a small patch
    analytic = (weight * (lx[None] > -x[:, None, None])).sum(axis=(1, 2)) / weight.sum(axis=(1, 2))
    ratio = shadowed / lit
    assert np.abs(ratio - analytic).max() < tolerance + 0.01
    assert (np.diff(ratio) > -1e-3).all()
    soft = (ratio > 0.02) & (ratio < 0.98)
    assert soft.sum() > 3 if samples > 1 else soft.sum() <= 1


def test_soft_shadows_only_while_the_head_is_still() -> None:
    light = Light("area", (5.0,) * 3, direction=(0, -1, 0), corner=(-0.4, 2, -3.4), edge_u=(0.8, 0, 0),
                  edge_v=(0, 0, 0.8))  # fmt: skip
    floor = quad((-5, -1, 5), (10, 0, 0), (0, 0, -10), diffuse(WHITE))
    found = {}
    for speed in (0.0, 10.0, 100.0):
        camera = Path(lambda t, speed=speed: turn(speed * t))
        technique = polar(scene_of(floor, lights=(light,), camera=camera), (32, 24))
        frame = show(technique)
        found[speed] = frame.rays["shadow"] / frame.rays["primary"]
    assert found[0.0] > 3.5 * found[10.0] > 3.5 * 3.5 * found[100.0] > 0
    params = Parameters()
    view = view_at(0, RATE, Fraction(0), (8, 8), Path(lambda t: shift(t)))  # one unit a second
    assert pose_delta(view, 1.0).moving_deg_s == pytest.approx(57.2958, rel=1e-6)
    assert pose_delta(view, 1.0).turning_deg_s == 0
    assert light_samples(params, pose_delta(view, 1e9)) == 256
    assert light_samples(params, pose_delta(view, 10.0)) == 64
    assert light_samples(params, pose_delta(view, 0.1)) == 1


@pytest.mark.parametrize("speed", [1e-4, 3.0, 90.0, 179.0 * 60])
def test_turning_is_measured_to_the_last_digit(speed: float) -> None:
    view = view_at(0, RATE, Fraction(0), (8, 8), Path(lambda t: turn(speed * t)))
    assert pose_delta(view, 1.0).turning_deg_s == pytest.approx(speed, rel=1e-6)


def test_the_width_follows_head_speed_recovers_and_the_picture_stays_complete() -> None:
    gc.collect()  # a mesh of another test that is freed on the way is a new recording
    camera = Path(lambda t: turn(20 * np.sin(8 * t) ** 2 if t > 0 else 0.0))
    technique = polar(replace(wall_of_noise(), camera=camera), (128, 72), quality=1)
    speeds, rays = [], []
    for k in range(0, 36):
        frame = show(technique, k)
        view = view_at(k, RATE, Fraction(0), (128, 72), camera)
        speeds.append(pose_delta(view, 1.0).turning_deg_s)
        rays.append(frame.rays["primary"])
        assert frame.color[:, 32:96].min() > 0  # no hole, no leftover of a wider buffer
    assert np.corrcoef(speeds, rays)[0, 1] < -0.9  # clamped at half the width
    assert min(rays) < 0.6 * max(rays)
    assert rays[0] == max(rays)
    slowest_again = int(np.argmin(speeds[6:])) + 6
    assert rays[slowest_again] > 0.9 * rays[0]
    assert technique._trace_kernel.recordings <= 2


# Changes between frames -----------------------------------------------------------------------------------------------


def test_all_kinds_of_objects_move_appear_and_go_from_one_frame_to_the_next() -> None:
    def mover(name: str, thing: object, x: Callable[[float], float], visible: tuple = (-np.inf, np.inf)) -> Mover:
        return Mover(name, (thing,), Path(lambda t: shift(x(t), 0, -4)), visible)

    ball = part("ball", sphere(0.4, 16, 24), matte("ball", WHITE))
    cube = box((0, 0, 0), (0.35, 0.35, 0.35), diffuse(WHITE))
    mesh = quad((-0.4, -0.4, 0), (0.8, 0, 0), (0, 0.8, 0), diffuse(WHITE))
    at_3 = 3 / 60 - 1e-6
    scene = scene_of(
        movers=(
            mover("moved", ball, lambda t: -1.5 if t < at_3 else -0.7),
            mover("added", cube, lambda t: 0.5, (at_3, np.inf)),
            mover("removed", mesh, lambda t: 1.6, (-np.inf, at_3)),
        ),
        lights=(Light("directional", WHITE, direction=(0, 0, -1)),),
    )
    technique = polar(scene, (96, 54), width=128, height=128)
    bodies = technique.engine.tracer.arrays.bodies
    seen = {}
    for k in range(5):
        frame = show(technique, k)
        found = frame.color[..., 0]
        x = [int(48 + v / 4 / np.tan(np.pi / 6) * 27) for v in (-1.5, -0.7, 0.5, 1.6)]
        seen[k] = [bool(found[27, column] > 0.05) for column in x]
    assert seen[2] == [True, False, False, True]
    assert seen[3] == [False, True, True, False]  # the very next frame
    assert all(a is b for a, b in zip(bodies, technique.engine.tracer.arrays.bodies, strict=True))


def test_a_moving_light_is_where_it_is_now() -> None:
    floor = quad((-5, -1, 5), (10, 0, 0), (0, 0, -10), diffuse(WHITE))
    light = Light("point", WHITE, track=Path(lambda t: shift(-1.0 if t < 3 / 60 - 1e-6 else 1.0, -0.5, -3)))
    technique = polar(scene_of(floor, lights=(light,)), (64, 48), width=96, height=96)
    brightest = [int(show(technique, k).color[..., 0].max(axis=0).argmax()) for k in range(5)]
    assert brightest[0] == brightest[1] == brightest[2] < 25
    assert brightest[3] == brightest[4] > 38


def test_probes_bring_bounced_light_by_name_or_by_the_clips_lighting() -> None:
    room = cornell()
    size = (24, 24)
    settings = {"grid": (4, 4, 4), "rays": 64}
    frames = {
        "none": show(polar(room, size, quality=64, width=64, height=64)),
        "by name": show(polar(room, size, quality=64, width=64, height=64, probes=True, probe_settings=settings)),
    }
    engine = Engine(room, lighting="probes")
    frames["lighting"] = show(Polar(engine, size, Parameters(quality=64, width=64, height=64), 0, "total"))
    cartesian = show(Vanilla(engine, size, VanillaParameters(light_samples=64), 0, "total"))
    light = {name: float(frame.color.mean()) for name, frame in frames.items()}
    assert light["by name"] > 1.2 * light["none"]
    assert light["lighting"] == pytest.approx(light["by name"], rel=0.1)
    assert cartesian.color.mean() == pytest.approx(light["lighting"], rel=0.05)  # the same for every technique
    assert frames["by name"].rays["probe"] >= 64 * 64
    assert frames["none"].rays["probe"] == 0
    assert frames["by name"].rays["ambient_occlusion"] > 0


def test_a_live_gaze_and_a_changing_width_record_no_kernel_anew() -> None:
    gc.collect()  # a mesh of another test that is freed on the way is a new recording
    technique = polar(replace(wall_of_noise(), camera=Path(lambda t: turn(9 * np.sin(9 * t)))), (48, 36), quality=1)
    gazes = np.random.default_rng(2).uniform(-30, 30, (40, 2))
    for k, gaze in enumerate(gazes):
        assert np.isfinite(show(technique, k, tuple(gaze)).color).all()
    kernels = (technique._trace_kernel, technique._mark_kernel, technique._resolve_kernel)
    assert max(kernel.recordings for kernel in kernels) <= 6


# Extremes -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "params", [{}, {"mapping": "equal_density"}, {"probes": True, "probe_settings": {"grid": (2, 2, 2)}}]
)
@pytest.mark.parametrize("size", [(1, 1), (3, 2), (33, 17)])
def test_empty_scenes_single_triangles_and_no_lights(params: dict, size: tuple[int, int]) -> None:
    triangle = quad((-1, -1, -3), (2, 0, 0), (0, 2, 0), diffuse(WHITE))
    triangle.primitive.indices = np.array([[0, 1, 2]])
    for scene in (scene_of(background=(0.1, 0.2, 0.3)), scene_of(triangle)):
        technique = polar(scene, size, **params)
        for gaze in (None, (1e-9, 0.0), (180.0, 0.0), (0.0, -90.0)):
            frame = show(technique, gaze=gaze)
            assert np.isfinite(frame.color).all()
            assert frame.clamped == 0
        if not scene.static:
            np.testing.assert_allclose(frame.color, np.broadcast_to((0.1, 0.2, 0.3), frame.color.shape), rtol=1e-5)


def test_narrow_and_wide_fields() -> None:
    for field in (1e-3, 1.0, 120.0, 179.0):
        scene = replace(wall_of_noise(), camera=StillCamera(np.eye(4), np.radians(field)))
        frame = show(polar(scene, (40, 30)))
        assert frame.rays["primary"] <= 1200
        assert np.isfinite(frame.color).all()
        assert frame.color[15, 20].max() > 0


def test_parameters_out_of_range_and_gazes_that_are_no_numbers_are_one_line() -> None:
    for bad in ({"width": 1}, {"height": 5}, {"quality": 2}, {"mapping": "log"}, {"least_width": 0}):
        with pytest.raises(InputError, match="polar"):
            next(render_clip(wall_of_noise(), "polar", (8, 8), params=bad))
    with pytest.raises(InputError, match="gaze"):
        show(polar(wall_of_noise(), (8, 8)), gaze=(float("nan"), 0.0))


def test_the_debug_picture_has_rings_every_15_degrees() -> None:
    technique = polar(wall_of_noise(), (120, 90), width=1024, height=512)
    view: View = view_at(0, RATE, Fraction(0), (120, 90), technique.engine.scene.camera, (10.0, 5.0))
    found = technique.show(view)
    wanted = picture_eccentricity_deg(eye_plane((120, 90), np.pi / 3, None, (10.0, 5.0)), (120, 90))
    inner = (wanted > 0.5) & (wanted < 30)
    np.testing.assert_allclose(found["main.eccentricity"][inner], wanted[inner], atol=0.1)
    hue = found["main"].argmax(axis=2)
    for ring in range(3):
        clear = (wanted > 15 * ring + 1) & (wanted < 15 * ring + 14)
        assert (hue[clear] == (3 - ring) % 3).all()
