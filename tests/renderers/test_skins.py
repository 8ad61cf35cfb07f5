"""Meshes that bend, against skinning worked out here in float64: depth, shading, motion, and who refuses them."""

from __future__ import annotations

import gc
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from renderers import Tracer, render_clip
from renderers.backend import dr, mi
from renderers.catalogue import TECHNIQUES
from renderers.clip_frames import technique_params, view_at
from renderers.engine import Engine
from renderers.frozen import frozen
from renderers.vanilla import frame_lanes
from stimuli import load_scene
from stimuli.errors import InputError
from stimuli.scene import Light, Scene, Skin, VertexTrack, scene_at
from tests.renderers.float64_tracer import nearest, world_triangles
from tests.renderers.scenes_by_hand import diffuse, look_at, quad
from tests.stimuli.tiny_glb import TinyGlb

RATE = Fraction(240)
RINGS, SIDES = 9, 12
SIZE = (64, 48)


def bar() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions (N, 3), normals, faces and the second bone's weight (N,) of a tube of height 2 along y."""
    angle = np.arange(SIDES) * 2 * np.pi / SIDES
    height = np.linspace(0, 2, RINGS)
    around = np.stack([np.cos(angle), np.zeros(SIDES), np.sin(angle)], 1)
    positions = (0.3 * around[None] + height[:, None, None] * [0, 1, 0]).reshape(-1, 3)
    k, j = np.mgrid[0 : RINGS - 1, 0:SIDES]
    a, b = k * SIDES + j, k * SIDES + (j + 1) % SIDES
    faces = np.stack([a, a + SIDES, b, b, a + SIDES, b + SIDES], -1).reshape(-1, 3)
    weight = np.repeat(np.clip(height - 0.5, 0, 1), SIDES)
    return positions, np.tile(around, (RINGS, 1)), faces, weight


def bent(time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions and unit normals at ``time_s``: the second bone turns about z at (0, 1, 0), a right angle a second."""
    positions, normals, _, weight = bar()
    angle = np.pi / 2 * np.clip(time_s, 0, 1)  # glTF turns at an even rate between two keys
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    turned = (positions - [0, 1, 0]) @ turn.T + [0, 1, 0]
    blend = (1 - weight)[:, None, None] * np.eye(3) + weight[:, None, None] * turn
    placed = (1 - weight)[:, None] * positions + weight[:, None] * turned
    inverse = np.linalg.inv(blend).transpose(0, 2, 1)
    out = np.einsum("nab,nb->na", inverse, normals)
    return placed, out / np.linalg.norm(out, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def bending(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The bar between two bones, before a wall, under one light."""
    positions, normals, faces, weight = bar()
    glb = TinyGlb()
    joints = np.tile([0, 1, 0, 0], (len(positions), 1))
    weights = np.stack([1 - weight, weight, 0 * weight, 0 * weight], 1)
    mesh = glb.mesh(
        positions, faces, NORMAL=glb.accessor(normals), JOINTS_0=glb.accessor(joints, "u1"),
        WEIGHTS_0=glb.accessor(weights),
    )  # fmt: skip
    one, two = glb.node(), glb.node(translation=[0, 1, 0])
    glb.node(mesh=mesh, skin=0, name="bar")
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, :3, 3] = (0, -1, 0)
    glb.json["skins"] = [
        {"joints": [one, two], "inverseBindMatrices": glb.accessor(bind.transpose(0, 2, 1).reshape(2, 16))}
    ]
    half = np.sin(np.pi / 4)
    glb.animate(two, "rotation", [0.0, 1.0], [[0, 0, 0, 1], [0, 0, half, half]])
    folder: Path = tmp_path_factory.mktemp("skin")
    scene = load_scene(glb.write(folder))
    skinned = replace(scene.static[0], material=diffuse((0.6, 0.5, 0.4)))
    wall = quad((-4, -2, -1.5), (8, 0, 0), (0, 8, 0), diffuse((0.3, 0.4, 0.5)))
    return replace(
        scene, static=(skinned, wall), lights=(Light("point", (30.0, 30.0, 30.0), (1.0, 3.0, 3.0)),),
        camera=look_at((0, 1, 5), (0, 1, 0)), default_exposure=1.0,
    )  # fmt: skip


@dataclass(frozen=True)
class Before:
    """Another mesh's vertices, one unit nearer to the eye and half a unit to the left."""

    inner: VertexTrack

    def vertices(self, time_s: float) -> tuple[np.ndarray, np.ndarray | None]:
        positions, normals = self.inner.vertices(time_s)
        return positions + np.array([-0.5, 0, 1]), normals


def rays(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    origin = np.tile([0.0, 1.0, 5.0], (200, 1))
    return origin, rng.uniform([-1.6, -0.2, -0.3], [0.6, 2.2, 0.3], (200, 3)) - origin


def test_rays_hit_the_bar_as_it_is_bent_at_their_own_time(bending: Scene) -> None:
    origin, direction = rays()
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    times_s = np.random.default_rng(1).choice([0.0, 0.3, 0.55, 1.0], 200)
    hits = Tracer(bending).trace(origin, direction, times_s)
    _, _, faces, _ = bar()
    on_bar = 0
    for time_s in np.unique(times_s):
        positions, normals = bent(time_s)
        for k in np.flatnonzero(times_s == time_s):
            t, face = nearest(positions[faces], origin[k], unit[k])
            if not np.isfinite(t):
                assert hits.point[k, 2] == pytest.approx(-1.5, abs=1e-5)  # the wall
                continue
            assert hits.t[k] == pytest.approx(t, rel=1e-5)
            on_bar += 1
            place = origin[k] + t * unit[k]
            a, b, c = positions[faces[face]]
            u, v = np.linalg.lstsq(np.stack([b - a, c - a], 1), place - a, rcond=None)[0]
            smooth = np.array([1 - u - v, u, v]) @ normals[faces[face]]
            np.testing.assert_allclose(hits.normal[k], smooth / np.linalg.norm(smooth), atol=1e-4)
    assert on_bar > 40


def test_shadows_follow_the_bending_bar_and_pass_through_one_of_glass(bending: Scene) -> None:
    """Two skinned meshes: the bar, and the same of glass, before it."""
    glass = replace(bending.static[0], material=diffuse(transmission=0.5))
    skin = bending.skins[0]
    both = replace(bending, static=(bending.static[0], glass), skins=(skin, Skin(1, Before(skin.track))))
    origin, direction = rays()
    tracer = Tracer(both)
    for time_s in (0.0, 1.0, 0.3):
        tracer.trace(origin, direction, time_s)  # the shapes of that time
        d = (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)
        o = tracer.space.points(origin).astype(np.float32)
        blocked = tracer.occluded(
            tracer.arrays, tracer.poses(np.zeros(1)), mi.Point3f(o.T), mi.Vector3f(d.T), dr.zeros(mi.Float, 200),
            True, mi.Float(dr.inf),
        )  # fmt: skip
        positions, _ = bent(time_s)
        own = np.array([np.isfinite(nearest(positions[bar()[2]], a, b)[0]) for a, b in zip(origin, d, strict=True)])
        assert 20 < own.sum() < 180
        np.testing.assert_array_equal(np.array(blocked), own)


@pytest.mark.parametrize("technique", ["vanilla", "reference", "taa", "temporally_dense", "checkerboard"])
def test_a_frame_shows_the_shape_of_its_own_time(bending: Scene, technique: str) -> None:
    params = {"spp": 2} if technique == "reference" else {}
    start = Fraction(1, 2)
    first = next(render_clip(bending, technique, SIZE, RATE, 1 / RATE, params, start_s=start)).color
    still = replace(scene_at(bending, float(start)), skins=())
    wanted = next(render_clip(still, technique, SIZE, RATE, 1 / RATE, params, start_s=start)).color
    at_rest = replace(bending, skins=())
    unbent = next(render_clip(at_rest, technique, SIZE, RATE, 1 / RATE, params, start_s=start)).color
    # The same but for rays that graze an edge (and taa's first fetch along the motion, which the still scene has not).
    off, far_off = np.abs(first - wanted), np.abs(first - unbent)
    assert (off.max(axis=2) > 1e-3).mean() < (0.05 if technique == "taa" else 0.005)
    assert far_off.mean() > (4 if technique == "taa" else 20) * off.mean()
    assert (far_off.max(axis=2) > 1e-3).mean() > 0.03


def test_motion_follows_the_vertices(bending: Scene) -> None:
    engine = Engine(bending)
    _, x, y = frame_lanes(SIZE)
    view = view_at(0, RATE, Fraction(1, 2), SIZE, bending.camera)

    def kernel(state: object, x: object, y: object) -> object:
        sample = engine.sample(state, engine.camera_ray(state, x, y), want_motion=True)
        return sample.motion, sample.point, sample.hit

    motion, point, _ = frozen(kernel)(SIZE[0] * SIZE[1], engine.state(view), x, y)
    places = engine.space.world_points(point.numpy().T)
    motion = motion.numpy().T
    _, _, faces, _ = bar()
    now, before = (bent(float(t))[0] for t in (view.t1, view.t0))
    eye = bending.camera.pose(np.zeros(1))[0]
    pixel = 2 * np.tan(bending.camera.yfov_rad / 2) / SIZE[1]

    def project(p: np.ndarray) -> np.ndarray:
        own = (p - eye[:3, 3]) @ eye[:3, :3]
        return np.array([own[0], -own[1]]) / -own[2] / pixel

    checked = 0
    for place, found in zip(places[::2], motion[::2], strict=True):
        if place[2] < -1.4:
            np.testing.assert_allclose(found, 0, atol=1e-3)  # the wall rests
            continue
        d = place - eye[:3, 3]
        t, face = nearest(now[faces], eye[:3, 3], d / np.linalg.norm(d))
        if not np.isfinite(t):
            continue
        a, b, c = now[faces[face]]
        u, v = np.linalg.lstsq(np.stack([b - a, c - a], 1), place - a, rcond=None)[0]
        then = np.array([1 - u - v, u, v]) @ before[faces[face]]
        np.testing.assert_allclose(found, project(place) - project(then), atol=2e-3)
        checked += np.abs(project(place) - project(then)).max() > 0.02
    assert checked > 20


def test_a_new_shape_is_no_new_recording(bending: Scene) -> None:
    gc.collect()  # a mesh of another test that is freed on the way is a new recording
    engine = Engine(bending)
    made = TECHNIQUES["vanilla"](engine, SIZE, technique_params("vanilla", {}), 0, "total")
    frames = [
        np.array(made.render(view_at(k, RATE, Fraction(k, 12), SIZE, bending.camera, cut=k == 0)).color)
        for k in range(6)
    ]
    assert made._kernel.recordings <= 2
    assert all(np.abs(a - b).max() > 0.05 for a, b in pairwise(frames))


@pytest.mark.parametrize("technique", ["adaptive_frameless", "traditional_frameless"])
def test_samples_with_times_of_their_own_refuse_it_in_one_line(bending: Scene, technique: str) -> None:
    with pytest.raises(InputError, match=r"got meshes whose vertices move \(bar\), wanted rigid bodies") as caught:
        next(render_clip(bending, technique, SIZE, RATE, 1 / RATE))
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["cesium_man/CesiumMan.glb", "robot_expressive/RobotExpressive.glb"])
def test_real_characters_are_hit_where_their_skins_are(assets: Path, name: str) -> None:
    subject = load_scene(str(assets / name))
    assert subject.skins
    time_s = 0.43 * subject.duration_s
    triangles, _ = world_triangles(scene_at(subject, time_s), time_s)
    rng = np.random.default_rng(0)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    eye = high + 2 * (high - low)
    origin = np.tile(eye, (80, 1))
    direction = triangles[rng.choice(len(triangles), 80)].mean(axis=1) - eye
    hits = Tracer(subject).trace(origin, direction, time_s)
    wanted = [nearest(triangles, eye, d / np.linalg.norm(d))[0] for d in direction]
    np.testing.assert_allclose(hits.t, wanted, rtol=1e-5)
