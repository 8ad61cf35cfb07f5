"""Light probes: octahedral maps, furnace, Cornell box against Mitsuba's path tracer, walls that hold the light."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.backend import activate, dr, mi
from renderers.camera import Ray
from renderers.engine import Engine
from renderers.frozen import opaque_float
from renderers.mitsuba_scene import mitsuba_scene
from renderers.parameters import Probes
from renderers.polar.octahedral import border_sources, decode, encode, look_up, padded_index, texel_direction
from renderers.polar.probes import ProbeGrid, fibonacci, random_rotation, scene_box
from renderers.produce import units_of
from renderers.space import tracer_space
from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError
from stimuli.scene import Light
from tests.renderers.polar.rooms import cornell, furnace, irradiance_at, probed, state_at, wall
from tests.renderers.scenes import scene_of
from tests.renderers.scenes_by_hand import box, quad

activate()


def random_directions(seed: int, count: int) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_octahedral_maps_are_inverse_and_a_smooth_function_crosses_their_folds() -> None:
    d = random_directions(1, 4000)
    d = np.concatenate([d, np.eye(3), -np.eye(3), [[0.6, 0.8, 0.0], [-0.6, 0.8, -1e-7]]])
    v = mi.Vector3f(d.T.astype(np.float32))
    np.testing.assert_allclose(decode(*encode(v)).numpy().T, d, atol=1e-6)
    n = 14
    texels = dr.arange(mi.UInt32, n * n)
    stored = np.zeros(((n + 2) ** 2, 2), np.float32)
    towards = texel_direction(texels, n).numpy().T
    stored[padded_index(texels, n).numpy()] = np.stack([towards @ (0.3, 0.5, -0.8), towards[:, 2]], axis=1)
    border, source = border_sources(n)
    assert len(border) == 4 * n + 4
    stored[border] = stored[source]
    found = look_up(mi.Vector2f, opaque_float(stored), mi.UInt32(0), v, n).numpy().T
    error = np.abs(found - np.stack([d @ (0.3, 0.5, -0.8), d[:, 2]], axis=1))
    assert error.max() < 0.09  # on the creases of the map; a border in the wrong order is off by 1
    assert error.mean() < 0.013


def test_rays_of_a_probe_cover_the_sphere_evenly() -> None:
    d = fibonacci(256) @ random_rotation(np.random.default_rng(0)).T
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1)
    np.testing.assert_allclose(d.mean(axis=0), 0, atol=0.01)
    np.testing.assert_allclose(d.T @ d / 256, np.eye(3) / 3, atol=0.01)


@pytest.mark.parametrize(("albedo", "tolerance"), [(0.0, 1e-5), (0.5, 1e-3), (0.9, 0.01)])
def test_furnace(albedo: float, tolerance: float) -> None:
    engine = probed(furnace(albedo, 1.0), settle_passes=0)
    for k in range(100):
        state = state_at(engine, k)
        engine.indirect.update(state, 0, 1, hysteresis=0.3)
    assert engine.indirect.arrays.valid.numpy().min() == 1
    ray = engine.camera_ray(state, mi.Float([0.5, 4.0, 7.5]), mi.Float([0.5, 4.0, 2.0]))
    np.testing.assert_allclose(engine.sample(state, ray).color.numpy(), 1 / (1 - albedo), rtol=tolerance)


def test_each_update_is_one_bounce() -> None:
    engine = probed(furnace(0.5, 1.0), settle_passes=0)
    state = state_at(engine, 0)
    for bounces in range(1, 5):
        found = irradiance_at(engine, state, [(0, -0.9, 0)], [(0, 1, 0)])
        np.testing.assert_allclose(found, 2 - 0.5 ** (bounces - 1), rtol=1e-4)
        engine.indirect.update(state, 0, 1, hysteresis=0.0)


def path_traced(scene, engine: Engine, rays: Ray, spp: int) -> np.ndarray:
    """(N, 3) by Mitsuba's `path`, the light itself hidden from the eye."""
    integrator = mi.load_dict({"type": "path", "max_depth": 12, "rr_depth": 20})
    theirs = mitsuba_scene(scene, engine.space, (8, 8), 0.0)
    count = dr.width(rays.d)
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(7, count * spp)
    lane = dr.arange(mi.UInt32, count * spp) // spp
    o, d = (dr.gather(t, v, lane) for t, v in ((mi.Point3f, mi.Point3f(rays.o)), (mi.Vector3f, rays.d)))
    color = integrator.sample(theirs, sampler, mi.RayDifferential3f(o, d))[0].numpy().T
    return color.reshape(count, spp, 3).mean(axis=1)


def test_colour_bleeding_of_the_cornell_box_is_mitsubas() -> None:
    scene = cornell()
    engine = probed(scene, grid=(8, 8, 8), rays=128, settle_passes=0, bias=0.3)
    state = state_at(engine, 0)
    for k in range(24):
        engine.indirect.update(state, 0, 1, hysteresis=0.0 if k < 6 else 0.8)
    # Points of the floor from the red to the green wall, and of the ceiling, which only bounced light reaches.
    x = np.tile(np.linspace(-0.8, 0.8, 9), 2)
    targets = np.stack([x, np.repeat([-1.0, 1.0], 9), np.repeat([0.45, 0.6], 9)], axis=1)
    eye = np.array([0.0, 0.0, 0.9])
    d = (targets - eye) / np.linalg.norm(targets - eye, axis=1, keepdims=True)
    origin = np.broadcast_to(engine.space.points(eye), d.shape)
    rays = Ray(
        mi.Point3f(np.array(origin.T, np.float32)), mi.Vector3f(d.T.astype(np.float32)), mi.Float(0), mi.Float(1e-3)
    )
    ours = engine.sample(state, rays, light_samples=64).color.numpy().T
    theirs = path_traced(scene, engine, rays, 4096)
    floor, ceiling = ours[:9], ours[9:]
    assert (ceiling > 0).all()
    np.testing.assert_allclose(floor, theirs[:9], rtol=0.08)
    np.testing.assert_allclose(ceiling, theirs[9:], rtol=0.25)  # only bounced light, eight probes across
    # The colours bleed as much, and to the right sides.
    tint = np.log(ours[:, 0] / ours[:, 1])
    np.testing.assert_allclose(tint, np.log(theirs[:, 0] / theirs[:, 1]), atol=0.12)
    assert tint[0] > 0.05 > -0.02 > tint[8]


def test_no_light_leaks_through_a_thin_wall() -> None:
    engine = probed(cornell(divide=True), grid=(16, 8, 16), rays=64, settle_passes=8)
    state = state_at(engine, 0)
    z = np.linspace(-0.8, 0.8, 9)

    def floor(x: float) -> np.ndarray:
        points = np.stack([np.full(9, x), np.full(9, -1.0), z], axis=1)
        return irradiance_at(engine, state, points, np.tile((0.0, 1.0, 0.0), (9, 1)))

    bright = floor(-0.5).mean()
    assert bright > 0.05
    # Spacing is 0.125: at 2 cm from the wall half of the probes asked are lit ones behind it.
    for x, most in ((0.02, 0.04), (0.1, 0.015), (0.3, 0.01), (0.8, 0.005)):
        assert floor(x).max() < most * bright, x


def test_a_probe_inside_a_wall_gives_no_light_and_takes_none_away() -> None:
    scene = furnace(0.5, 1.0)
    block = box((0.25, 0.25, 0.25), (0.2, 0.2, 0.2), wall((0.5,) * 3, 1.0))
    block.primitive.indices = np.asarray(block.primitive.indices).reshape(-1, 3)[:, ::-1]  # a solid: faces look out
    engine = probed(scene_of(*scene.static, block), settle_passes=16)
    state = state_at(engine, 0)
    positions, valid = engine.indirect.positions, engine.indirect.arrays.valid.numpy()
    inside = (np.abs(positions - 0.25) < 0.2).all(axis=1)
    assert inside.sum() == 1
    np.testing.assert_array_equal(valid, np.where(inside, 0, 1))
    near = irradiance_at(engine, state, [(0.25, 0.46, 0.25), (0.46, 0.25, 0.25)], [(0, 1, 0), (1, 0, 0)])
    np.testing.assert_allclose(near, 2.0, rtol=0.02)


def test_energy_never_grows_and_dies_when_the_light_goes_out() -> None:
    engine = probed(furnace(0.95, 1.0), grid=(2, 2, 2), rays=16, settle_passes=0, every_frames=1)
    most = 0.0
    for k in range(120):  # tests/prove/polar.py: 10,000 frames
        state = state_at(engine, k)
        most = max(most, float(irradiance_at(engine, state, [(0, 0, 0)], [(0, 1, 0)]).max()))
    assert most < 20 * 1.001
    dark = Engine(furnace(0.95, 0.0)).with_probes(engine.indirect.settings)
    start = state_at(dark, 0)
    dark.indirect.arrays.irradiance = engine.indirect.arrays.irradiance
    levels = []
    for k in range(1, 120):
        start = state_at(dark, k)
        levels.append(float(irradiance_at(dark, start, [(0, 0, 0)], [(0, 1, 0)]).max()))
    assert (np.diff(levels) < 1e-4).all()
    # Fifth roots fade by 0.03 of what one bounce loses, once a frame.
    fading = (1 - 0.03 * (1 - 0.95**0.2)) ** (5 * (len(levels) - 1))
    assert levels[-1] / levels[0] == pytest.approx(fading, rel=0.01)


def test_short_rays_darken_corners_only() -> None:
    scene = cornell()
    plain, short = probed(scene, settle_passes=4), probed(scene, settle_passes=4, occlusion_rays=16)
    found = []
    for engine in (plain, short):
        state = state_at(engine, 0)
        d = np.array([[-0.98, -1.0, -1.0], [0.0, -1.0, -0.2]]) - (0, 0, 0.9)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        o = np.broadcast_to(engine.space.points(np.array([0, 0, 0.9])), d.shape)
        ray = Ray(mi.Point3f(np.array(o.T, np.float32)), mi.Vector3f(d.T.astype(np.float32)), mi.Float(0), mi.Float(0))
        sample = engine.sample(state, ray)
        found.append(sample.surface.numpy().T.mean(axis=1))
        assert sample.rays["ambient_occlusion"].numpy().max() == engine.indirect.settings.occlusion_rays
    corner, middle = found[1] / found[0]
    assert corner < 0.7
    assert middle == pytest.approx(1, abs=0.02)


def test_every_probe_has_its_turn_and_a_repeated_view_costs_nothing() -> None:
    engine = probed(furnace(0.5, 1.0), settle_passes=0, every_frames=8)
    state_at(engine, 0)
    counts = []
    for k in range(1, 10):
        state_at(engine, k)
        counts.append(engine.indirect.rays["probe"])
    assert counts == [8 * 64] * 9  # 64 probes, an eighth a frame, 64 rays
    state_at(engine, 9)
    assert engine.indirect.rays["probe"] == 0


def test_the_same_seed_gives_the_same_light() -> None:
    found = []
    for seed in (3, 3, 4):
        engine = Engine(cornell()).with_probes(Probes(grid=(3, 3, 3), rays=16), seed)
        for k in range(3):
            state_at(engine, k, cut=k == 0)
        found.append(engine.indirect.arrays.irradiance.numpy().copy())
        again = [state_at(engine, k, cut=k == 0) for k in range(3)][-1]
        np.testing.assert_array_equal(again.indirect.irradiance.numpy(), found[-1])  # a cut starts anew
    np.testing.assert_array_equal(found[0], found[1])
    assert (found[0] != found[2]).any()


@pytest.mark.parametrize(
    "scene",
    [
        scene_of(),
        scene_of(quad((0, 0, -3), (1, 0, 0), (0, 1, 0), wall((0.5,) * 3))),
        scene_of(box((0, 0, -3), (1e-9, 1e-9, 1e-9), wall((0.5,) * 3)), lights=(Light("point", (1, 1, 1)),)),
    ],
    ids=["empty", "flat", "a speck"],
)
def test_degenerate_scenes_have_a_grid_and_finite_light(scene) -> None:
    low, high = scene_box(scene, tracer_space(scene))
    assert (high > low).all()
    engine = probed(scene, settle_passes=2, grid=(2, 1, 3))
    state = state_at(engine, 0)
    ray = engine.camera_ray(state, mi.Float([4.0]), mi.Float([4.0]))
    assert np.isfinite(engine.sample(state, ray).color.numpy()).all()


def test_impossible_grids_are_refused() -> None:
    engine = Engine(furnace(0.5, 1.0))
    for grid in ((0, 4, 4), (4, 4, 65)):
        with pytest.raises(InputError, match="grid"):
            ProbeGrid(engine, Probes(grid=grid))


def test_clips_lit_by_probes_are_one_unit_but_for_the_reference() -> None:
    def units(technique: str, lighting: str, **params: object) -> int:
        request = ClipRequest("room", "0" * 64, technique, params, (640, 480), "240", "8", lighting=lighting)
        return len(units_of(request))

    assert units("vanilla", "probes") == 1
    assert units("vanilla", "direct") > 1
    assert units("reference", "probes", spp=16) == units("reference", "direct", spp=16) > 1
