"""Rays against a float64 reference: still and moving bodies, own times, any scale, any place."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest

from renderers import Tracer
from renderers.backend import dr, mi
from stimuli import load_scene
from stimuli.errors import InputError
from stimuli.scene import Mover, Scene
from tests.renderers.float64_tracer import nearest, world_triangles
from tests.renderers.scenes_by_hand import Drift, Scaled, box, crowd, diffuse, quad, scene


def rays(count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-1, 1, (count, 3)) + np.array([0, 0, 5])
    target = rng.uniform(-1.2, 1.2, (count, 3))
    return origin, target - origin


def expected(
    subject: Scene, origin: np.ndarray, direction: np.ndarray, time_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    t, owner = np.empty(len(origin)), np.empty(len(origin), int)
    for moment in np.unique(time_s):
        triangles, owners = world_triangles(subject, moment)
        for k in np.flatnonzero(time_s == moment):
            t[k], face = nearest(triangles, origin[k], direction[k] / np.linalg.norm(direction[k]))
            owner[k] = owners[face] if face >= 0 else -1
    return t, owner


@pytest.mark.parametrize("count", [0, 1, 4, 30])
def test_movers_are_hit_where_they_are_at_each_rays_own_time(count: int) -> None:
    subject = scene((quad((-3, -3, -2), (6, 0, 0), (0, 6, 0), diffuse()),), crowd(count))
    origin, direction = rays(300)
    time_s = np.random.default_rng(2).choice(np.linspace(0.0, 0.7, 40), 300)
    hits = Tracer(subject).trace(origin, direction, time_s)
    t, owner = expected(subject, origin, direction, time_s)
    agree = np.isclose(hits.t, t, rtol=1e-5)
    assert agree.sum() >= 299  # a ray may graze an edge
    np.testing.assert_array_equal(hits.mover[agree], owner[agree])
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    hit = agree & np.isfinite(t)
    np.testing.assert_allclose(hits.point[hit], (origin + unit * t[:, None])[hit], atol=2e-5)
    assert (np.einsum("ij,ij->i", hits.geometric_normal[hit], unit[hit]) < 0).all()
    assert np.isnan(hits.point[agree & ~hit]).all()


def test_walking_boxes_misses_no_body_that_asking_all_finds() -> None:
    subject = scene(movers=crowd(60))
    origin, direction = rays(20_000)
    walked, asked = Tracer(subject), Tracer(subject)
    assert walked.uses_proxy
    asked.uses_proxy = False
    for time_s in (0.0, 0.31):
        a, b = walked.trace(origin, direction, time_s), asked.trace(origin, direction, time_s)
        np.testing.assert_array_equal(a.t, b.t)
        np.testing.assert_array_equal(a.mover, b.mover)


@pytest.mark.parametrize(("scale", "offset"), [(1e-6, 0.0), (1.0, 1e5), (1e6, 0.0), (1e-3, -7.0)])
def test_scale_and_place_of_the_world_change_nothing(scale: float, offset: float) -> None:
    plain = scene(
        (quad((-3, -3, -2), (6, 0, 0), (0, 6, 0), diffuse()), box((0.3, 0.2, 0), (0.5, 0.4, 0.3), diffuse())), crowd(6)
    )
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = offset
    static = tuple(replace(part, matrix=matrix) for part in plain.static)
    movers = tuple(Mover(m.name, m.parts, Scaled(m.track, matrix)) for m in plain.movers)
    moved = replace(plain, static=static, movers=movers)
    origin, direction = rays(400)
    a = Tracer(plain).trace(origin, direction, 0.2)
    b = Tracer(moved).trace(origin * scale + offset, direction * scale, 0.2)
    same = np.isclose(a.t, b.t / scale, rtol=1e-5)
    assert same.mean() > 0.99
    np.testing.assert_allclose(a.normal[same], b.normal[same], atol=1e-4)
    np.testing.assert_array_equal(a.mover[same], b.mover[same])


@pytest.mark.parametrize("movers", [0, 1, 3, 6])
def test_rays_meet_glass_and_shadow_rays_pass_through_it(movers: int) -> None:
    """Both kinds in one body: still, or in each of some movers (few of them all asked, many by their boxes)."""
    glass, wood = diffuse(transmission=0.5), diffuse()
    panes = tuple(quad((k, 0, 0), (0.8, 0, 0), (0, 0.8, 0), glass if k % 2 else wood) for k in range(12))
    still = panes if not movers else ()
    groups = tuple(
        Mover(f"{m}", panes[m * 12 // movers : (m + 1) * 12 // movers], Drift((0, 0, 0), (0, 0, 0), 0))
        for m in range(movers)
    )
    tracer = Tracer(scene(still, groups))
    assert tracer.uses_proxy == (movers > 4)
    origin = np.stack([np.arange(12) + 0.4, np.full(12, 0.3), np.full(12, 2.0)], 1)
    hits = tracer.trace(origin, np.tile([0.0, 0, -1], (12, 1)))
    np.testing.assert_allclose(hits.t, 2.0, rtol=1e-6)
    poses = tracer.poses(np.array([0.0, 1 / 60]))
    o = mi.Point3f(tracer.space.points(origin).astype(np.float32).T)
    d, time_s = mi.Vector3f(0, 0, -1), dr.zeros(mi.Float, 12)
    blocked = tracer.occluded(tracer.arrays, poses, o, d, time_s, True, mi.Float(dr.inf))
    np.testing.assert_array_equal(np.array(blocked), np.arange(12) % 2 == 0)


def test_a_mover_is_there_only_in_its_seconds() -> None:
    mover = Mover("flash", crowd(1)[0].parts, crowd(1)[0].track, visible_s=(0.1, 0.2))
    subject = scene(movers=(mover,))
    at = mover.track.pose(np.array([0.05, 0.15, 0.25]))[:, :3, 3]
    hits = Tracer(subject).trace(at + np.array([0, 0, 5]), np.tile([0, 0, -1.0], (3, 1)), np.array([0.05, 0.15, 0.25]))
    np.testing.assert_array_equal(hits.mover, [-1, 0, -1])


def test_no_rays_and_no_scene() -> None:
    empty = Tracer(scene())
    assert empty.trace(np.zeros((0, 3)), np.zeros((0, 3))).t.shape == (0,)
    assert np.isinf(empty.trace(np.zeros((3, 3)), np.ones((3, 3))).t).all()


def test_one_kernel_serves_all_ray_counts() -> None:
    gc.collect()  # Dr.Jit's keys hold every live mesh of the process: one that is freed on the way is a new recording
    tracer = Tracer(scene((box((0, 0, 0), (1, 1, 1), diffuse()),), crowd(3)))
    # 15 launches of other widths. Recorded apart: 1 ray, 3 rays (as many as bodies), and all others, which Dr.Jit
    # records once more at their third call.
    for count in (1, 3, 5, 7, 9, 11, 13, 17, 19, 23, 27, 61, 101, 997):
        origin, direction = rays(count)
        hits = tracer.trace(origin, direction, np.linspace(0, 1, count))
        assert (
            np.isclose(hits.t, expected(tracer.scene, origin, direction, np.linspace(0, 1, count))[0], rtol=1e-5).mean()
            > 0.98
        )
    assert tracer._plain.kernel.recordings <= 4


def test_bad_meshes_and_rays_are_named() -> None:
    part = box((0, 0, 0), (1, 1, 1), diffuse())
    part.primitive.positions[3, 1] = np.nan
    with pytest.raises(InputError, match=r"mesh box: vertex position: got .*nan.* wanted finite"):
        Tracer(scene((part,)))
    tracer = Tracer(scene((box((0, 0, 0), (1, 1, 1), diffuse()),)))
    for origin, direction in (([[0, 0, np.nan]], [[0, 0, 1]]), ([[0, 0, 0]], [[0, 0, 0]]), ([[0, 0]], [[0, 1]])):
        with pytest.raises(InputError):
            tracer.trace(np.array(origin, float), np.array(direction, float))


def test_degenerate_triangles_are_never_hit_and_do_no_harm() -> None:
    part = quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), diffuse())
    part.primitive.indices = np.array([[0, 1, 2], [0, 2, 3], [0, 0, 0], [1, 1, 2]], np.uint32)
    hits = Tracer(scene((part,))).trace(np.array([[0.1, 0.2, 3.0]]), np.array([[0, 0, -2.0]]))
    np.testing.assert_allclose(hits.t, [3.0], rtol=1e-6)


@pytest.mark.parametrize(
    "name", ["bart_kitchen/bart_kitchen.glb", "bart_robots/bart_robots.glb", "sponza_dabrovic/sponza.glb"]
)
def test_depth_of_real_scenes_equals_a_float64_reference(assets, name: str) -> None:
    """A sample of pixels that covers the meshes seen; every mesh of the file in tests/prove/engine_oracles.py."""
    subject = load_scene(str(assets / name))
    time_s = 0.37 * subject.duration_s
    pose = subject.camera.pose(np.array([time_s]))[0]
    rng = np.random.default_rng(4)
    tan = np.tan(subject.camera.yfov_rad / 2)
    local = np.stack([rng.uniform(-1, 1, 80) * tan * 512 / 288, rng.uniform(-1, 1, 80) * tan, -np.ones(80)], 1)
    direction = local @ pose[:3, :3].T
    origin = np.tile(pose[:3, 3], (80, 1))
    hits = Tracer(subject).trace(origin, direction, time_s)
    triangles, _ = world_triangles(subject, time_s)
    t = np.array([nearest(triangles, o, d / np.linalg.norm(d))[0] for o, d in zip(origin, direction, strict=True)])
    assert np.isfinite(t).mean() > 0.5
    np.testing.assert_allclose(hits.t, t, rtol=1e-4)
