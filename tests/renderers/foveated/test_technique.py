"""Foveated ray tracing as a whole: what is traced, what equals full ray tracing, gaze, marks, cache, post filter."""

from __future__ import annotations

import gc
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import chi2

from renderers.eccentricity import eye_plane, picture_eccentricity_deg
from renderers.engine import Engine
from renderers.foveated.foveal_function import sampling_probability
from renderers.foveated.technique import Foveated
from renderers.parameters import Foveated as Parameters
from renderers.parameters import Vanilla as VanillaParameters
from renderers.technique import Frame, Gaze, View, ViewGeometry
from renderers.vanilla import Vanilla
from stimuli import load_scene
from stimuli.scene import CameraPath, Light, Material, Scene, StillCamera
from tests.renderers.scenes import SlidingCamera, noise_pixels, quad, scene_of, unlit
from tests.renderers.scenes_by_hand import pbr

SIZE = (120, 90)
RATE = Fraction(75)
NO_MARKS = {"eps_depth": 1e6, "eps_lum": 1e6, "eps_edge": 0.0}
DISPLAY = ViewGeometry(1.0, 0.75, 0.5)


def wall(camera: CameraPath | None = None, distance: float = 2.0, block: int = 16) -> Scene:
    """An unlit textured wall across the view."""
    half = 6 * distance
    part = quad(
        (-half, -half, -distance), (2 * half, 0, 0), (0, 2 * half, 0), unlit(noise_pixels(1, 256, block)), "wall", 2.0
    )
    return scene_of(part, camera=camera)


def view(scene: Scene, index: int, size_px: tuple[int, int] = SIZE, gaze: Gaze | None = None, **more: object) -> View:
    t1 = 1 + index / RATE
    options = {"geometry": DISPLAY, "cut": index == 0, "camera": scene.camera, **more}
    return View(index, t1 - 1 / RATE, t1, size_px, gaze=gaze, **options)


def made(
    scene: Scene, size_px: tuple[int, int] = SIZE, seed: int = 3, lighting: str = "direct", **params: object
) -> Foveated:
    return Foveated(Engine(scene, lighting=lighting), size_px, Parameters(**params), seed, "total")


def vanilla_frame(scene: Scene, at: View, seed: int = 3, light_samples: int = 1, lighting: str = "direct") -> Frame:
    params = VanillaParameters(light_samples=light_samples)
    return Vanilla(Engine(scene, lighting=lighting), at.size_px, params, seed, "total").render(at)


@pytest.mark.parametrize("params", [{"configuration": "full"}, {"r0_deg": 180.0, "r1_deg": 180.0}])
@pytest.mark.parametrize("lighting", ["direct", "ambient_occlusion"])
def test_full_is_vanilla_to_the_last_bit(params: dict, lighting: str) -> None:
    """By configuration, and by a fovea as large as the field (then through the whole pipeline)."""
    scene = load_scene("toy_car")  # movers, area lights, mirrors
    technique = made(scene, lighting=lighting, **params)
    for k in range(3):
        at = view(scene, k)
        wanted = vanilla_frame(scene, at, lighting=lighting)
        frame = technique.render(at)
        np.testing.assert_array_equal(frame.color, wanted.color)
        assert dict(frame.rays) == dict(wanted.rays)


def test_sampling_density_follows_the_foveal_function() -> None:
    """Chi-square over rings of eccentricity, samples that are not of the support image, many frames."""
    scene = wall()
    technique = made(scene, r0_deg=5, r1_deg=30, p_min=0.1, **NO_MARKS)
    gaze = (9.0, -4.0)
    plane = eye_plane(SIZE, 1.0, DISPLAY, gaze)
    e = picture_eccentricity_deg(plane, SIZE)
    p = sampling_probability(e, technique.params)
    own = np.ones(SIZE[0] * SIZE[1], bool)
    own[technique.grid.texel_pixels()] = False
    free = own.reshape(e.shape)
    frames, counts = 60, np.zeros(e.shape)
    for k in range(frames + 1):
        technique.render(view(scene, k, gaze=gaze))
        sampled = technique.show(view(scene, k))["sampled"]
        if k:
            counts += sampled
    assert (counts[e <= 5] == frames).all()
    statistic, rings = 0.0, 0
    for low in np.arange(5, 60, 2.5):
        ring = free & (e > low) & (e <= low + 2.5)
        expected, variance = p[ring].sum() * frames, (p[ring] * (1 - p[ring])).sum() * frames
        statistic += (counts[ring].sum() - expected) ** 2 / variance
        rings += 1
    assert statistic < chi2.ppf(0.999, rings)
    assert counts[free & (e > 30)].mean() / frames == pytest.approx(0.1, rel=0.05)
    # drawn anew for every pixel and frame: the counts of equal pixels scatter as a binomial's
    outer = counts[free & (e > 30)]
    assert outer.var() == pytest.approx(frames * 0.1 * 0.9, rel=0.1)


@pytest.mark.parametrize("gaze", [None, (0.0, 0.0), (60.0, 50.0), (-170.0, 10.0)])
def test_the_support_image_is_complete_whatever_the_gaze(gaze: Gaze | None) -> None:
    scene = wall()
    technique = made(scene, **NO_MARKS, p_min=0.0)
    for k in range(2):
        frame = technique.render(view(scene, k, gaze=gaze))
    sampled = technique.show(view(scene, 1))["sampled"].ravel()
    assert sampled[technique.grid.texel_pixels()].all()
    if gaze is not None and abs(gaze[0]) > 50:  # outside the picture: nothing else is traced
        assert frame.rays["primary"] == technique.grid.texels == sampled.sum()


def test_p_min_of_one_traces_every_pixel_and_a_cut_does() -> None:
    scene = wall()
    everywhere, sparse = made(scene, p_min=1.0), made(scene, p_min=0.0, **NO_MARKS)
    pixels = SIZE[0] * SIZE[1]
    assert [everywhere.render(view(scene, k)).rays["primary"] for k in range(3)] == [pixels] * 3
    counts = [sparse.render(view(scene, k, cut=k in (0, 3))).rays["primary"] for k in range(5)]
    assert counts[0] == counts[3] == pixels
    assert max(counts[1], counts[2], counts[4]) < pixels / 4
    np.testing.assert_array_equal(
        sparse.render(view(scene, 5, cut=True)).color, vanilla_frame(scene, view(scene, 5)).color
    )


def test_the_gaze_may_jump_across_the_picture_in_one_frame() -> None:
    scene = wall(SlidingCamera((0.4, 0.0, 0.0)))
    technique = made(scene, **NO_MARKS)
    for k, gaze in enumerate([(-35.0, 0.0)] * 3 + [(35.0, 10.0)]):
        frame = technique.render(view(scene, k, gaze=gaze))
    inside = picture_eccentricity_deg(eye_plane(SIZE, 1.0, DISPLAY, gaze), SIZE) < 9.99
    assert inside.sum() > 200
    wanted = vanilla_frame(scene, view(scene, 3)).color
    np.testing.assert_array_equal(frame.color[inside], wanted[inside])
    assert not np.array_equal(frame.color[~inside], wanted[~inside])


def test_nothing_blurs_or_drifts_while_nothing_moves() -> None:
    scene = wall()
    technique = made(scene, **NO_MARKS)
    for k in range(30):
        frame = technique.render(view(scene, k))
    np.testing.assert_allclose(frame.color, vanilla_frame(scene, view(scene, 29)).color, atol=1e-5)
    ages = technique.show(view(scene, 29))["age"]
    assert 15 < ages.max() <= 29  # p_min is 0.05


def test_a_flat_wall_is_not_marked_and_a_disocclusion_is() -> None:
    flat = scene_of(quad((-9, -9, -2), (18, 0, 0), (0, 18, 0), unlit()), camera=SlidingCamera((2.0, 0, 0)))
    technique = made(flat)
    for k in range(3):
        technique.render(view(flat, k))
    assert technique.show(view(flat, 2))["marks"].sum() == 0
    # a panel before the wall, of the same colour: only its depth tells
    panel = quad((-0.2, -0.2, -1), (0.4, 0, 0), (0, 0.4, 0), unlit(), "panel")
    stepped = scene_of(*flat.static, panel, camera=flat.camera)
    technique = made(stepped)
    for k in range(3):
        technique.render(view(stepped, k))
    marks = technique.show(view(stepped, 2))["marks"]
    depth = Engine(stepped)
    z = reference_depth(depth, view(stepped, 2))
    uncovered = np.abs(np.diff(z, axis=1, append=z[:, -1:])) > 0.5
    assert uncovered.sum() > 20
    assert marks[uncovered].mean() > 0.9
    assert marks.mean() < 0.35


def reference_depth(engine: Engine, at: View) -> np.ndarray:
    """(H, W) distance along the axis."""
    width, height = at.size_px
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    tangent = 2 * np.tan(at.camera.yfov_rad / 2) / height
    own = np.stack([(x - width / 2) * tangent, (height / 2 - y) * tangent, -np.ones_like(x)], -1).reshape(-1, 3)
    pose = at.camera.pose(np.array([float(at.t1)]))[0]
    length = np.linalg.norm(own, axis=1)
    hits = engine.tracer.trace(np.broadcast_to(pose[:3, 3], own.shape), (own / length[:, None]) @ pose[:3, :3].T)
    return (hits.t / length).reshape(height, width)


def test_grazing_surfaces_are_marked_by_the_direction_to_the_eye() -> None:
    """A floor seen flatly far away; with the camera's forward instead, all of a facing wall's edge would be."""
    floor = quad((-50, -1, 50), (100, 0, 0), (0, 0, -100), unlit(), "floor")
    scene = scene_of(floor, camera=SlidingCamera((0.5, 0, 0)))
    technique = made(scene, eps_depth=1e6, eps_lum=1e6, eps_edge=0.2)
    for k in range(3):
        technique.render(view(scene, k))
    marks = technique.show(view(scene, 2))["marks"] > 0
    width, height = SIZE
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, height / 2 - np.arange(height)[:, None] - 0.5)
    down = -y * 2 * np.tan(np.pi / 6) / height
    cosine = down / np.sqrt(1 + down**2 + (x * 2 * np.tan(np.pi / 6) / height) ** 2)
    assert marks[(cosine > 0.07) & (cosine < 0.16)].all()
    assert not marks[cosine > 0.28].any()


def test_marked_pixels_show_their_own_sample() -> None:
    """The overwrite flag of the cache is set for marks and fovea alike."""
    scene = load_scene("tunnel_geom")
    technique = made(scene, (160, 120), k_max=0.05)
    for k in range(6):
        frame = technique.render(view(scene, k, (160, 120)))
    wanted = vanilla_frame(scene, view(scene, 5, (160, 120))).color
    marks = technique.show(view(scene, 5))["marks"] > 0
    assert marks.sum() > 100
    np.testing.assert_array_equal(frame.color[marks], wanted[marks])
    assert not np.array_equal(frame.color[~marks], wanted[~marks])


def lit_scene() -> Scene:
    """A wall under a large rectangle light, so that one sample is noisy; an edge in depth, so that there are marks."""
    material = Material("white", pbr(color=(0.7, 0.7, 0.7)))
    light = Light(
        "area", (6.0, 6.0, 6.0), corner=(-2, 2.5, -3), edge_u=(4, 0, 0), edge_v=(0, 0, 4), direction=(0, -1, 0)
    )
    parts = (
        quad((-9, -9, -4), (18, 0, 0), (0, 18, 0), material, "wall"),
        quad((-0.4, -0.6, -2.5), (0.8, 0, 0), (0, 1.2, 0), material, "panel"),
    )
    return scene_of(*parts, lights=(light,), camera=SlidingCamera((0.15, 0, 0)))


def test_the_post_filter_lowers_the_variance_of_resampled_regions_only() -> None:
    scene = lit_scene()
    errors = {}
    truth = vanilla_frame(scene, view(scene, 15), light_samples=256).color
    for taps in (0, 8):
        technique = made(scene, post_filter=taps, r0_deg=2.0, r1_deg=4.0, p_min=0.6, eps_lum=1e6)
        for k in range(16):
            frame = technique.render(view(scene, k))
        shown = technique.show(view(scene, 15))
        fovea = picture_eccentricity_deg(eye_plane(SIZE, 1.0, DISPLAY, None), SIZE) <= 2.0
        marked = (shown["marks"] > 0) & ~fovea
        errors[taps] = (frame.color, ((frame.color - truth)[marked] ** 2).mean())
        assert marked.sum() > 200
    assert errors[8][1] < 0.7 * errors[0][1]
    np.testing.assert_array_equal(errors[8][0][~marked], errors[0][0][~marked])


def test_the_post_filter_takes_no_light_from_the_background() -> None:
    """A white panel before the empty sky under ambient occlusion: nothing near it is dark."""
    white = pbr(color=(0.8, 0.8, 0.8))
    panel = quad((-0.7, -0.5, -2), (1.4, 0, 0), (0, 1, 0), Material("white", white), "panel")
    scene = scene_of(panel, camera=SlidingCamera((0.3, 0, 0)), background=(0.2, 0.4, 0.9))
    technique = made(scene, lighting="ambient_occlusion", r0_deg=0.0, r1_deg=0.0)
    for k in range(6):
        frame = technique.render(view(scene, k))
    wanted = vanilla_frame(scene, view(scene, 5), lighting="ambient_occlusion").color
    marks = technique.show(view(scene, 5))["marks"] > 0
    assert marks.sum() > 300
    np.testing.assert_allclose(frame.color[marks], wanted[marks], atol=0.02)


def test_no_post_filter_and_one_cache_with_point_lights() -> None:
    scene = load_scene("tunnel_geom")
    technique = Foveated(Engine(scene), SIZE, Parameters(), 1, "stages")
    for k in range(2):
        frame = technique.render(view(scene, k))
    assert not technique.noisy
    assert "post filter" not in frame.seconds
    assert {"raster", "marks", "trace", "compose"} <= set(frame.seconds)
    lit = Foveated(Engine(lit_scene()), SIZE, Parameters(), 1, "stages")
    for k in range(2):
        frame = lit.render(view(lit_scene(), k))
    assert lit.noisy
    assert "post filter" in frame.seconds


def test_caching_lowers_the_noise_of_sampled_light() -> None:
    scene = lit_scene()
    truth = vanilla_frame(scene, view(scene, 24), light_samples=256).color
    technique = made(scene, post_filter=0, p_min=1.0, r0_deg=0.0, r1_deg=0.0, k_max=0.05, **NO_MARKS, light_k_max=0.05)
    for k in range(25):
        frame = technique.render(view(scene, k))
    cached = technique.show(view(scene, 24))["samples"] > 10
    assert cached.mean() > 0.7
    one = vanilla_frame(scene, view(scene, 24)).color
    assert ((frame.color - truth)[cached] ** 2).mean() < 0.35 * ((one - truth)[cached] ** 2).mean()


@pytest.mark.parametrize(
    "params", [{"t_max": 1}, {"k_min": 0.3, "k_max": 0.3}, {"r0_deg": 10, "r1_deg": 10}, {"n_fp": 1}]
)
@pytest.mark.parametrize("size_px", [(31, 17), (3, 2)])
def test_extremes_stay_close_to_full_ray_tracing(params: dict, size_px: tuple[int, int]) -> None:
    scene = wall(SlidingCamera((0.2, 0.1, 0.0)), block=64)
    technique = made(scene, size_px, **params)
    for k in range(4):
        frame = technique.render(view(scene, k, size_px))
    wanted = vanilla_frame(scene, view(scene, 3, size_px)).color
    assert np.isfinite(frame.color).all()
    assert np.abs(frame.color - wanted).mean() < 0.1


def test_kernels_are_recorded_once_for_every_number_of_samples_and_gaze() -> None:
    gc.collect()  # a mesh of another test that is freed on the way is a new recording
    scene = wall(SlidingCamera((0.4, 0.0, 0.0)))
    technique = made(scene)
    for k in range(12):
        technique.render(view(scene, k, gaze=(3.0 * k - 15, k * 1.0), exposure=1 + k / 100))
    assert max(kernel.recordings for kernel in technique._kernels.values()) <= 3


def test_the_scene_of_the_study_stays_free_of_holes_under_fast_rotation() -> None:
    """A white room all around: any hole would be the black background."""
    low, wide, high = (-2, -2, -2), (4, 0, 0), (0, 4, 0)
    deep = (0, 0, 4)
    walls = {
        "front": (low, wide, high), "back": ((-2, -2, 2), wide, high), "left": (low, deep, high),
        "right": ((2, -2, -2), deep, high), "floor": (low, wide, deep), "top": ((-2, 2, -2), wide, deep),
    }  # fmt: skip
    sides = [quad(*where, unlit(), name) for name, where in walls.items()]
    scene = scene_of(*sides, camera=Turning(20.0))
    technique = made(scene, p_min=0.0)
    filled = 0
    for k in range(5):
        frame = technique.render(view(scene, k))
        np.testing.assert_allclose(frame.color, 1, atol=1e-5)
        filled += int((technique.show(view(scene, k))["samples"] == 0).sum())
    assert filled > 1000  # the support image was needed


class Turning:
    """Turns about +y by ``step_deg`` a frame; looks down -z at second 1."""

    name = "turning"
    yfov_rad = np.pi / 3

    def __init__(self, step_deg: float) -> None:
        self.step_deg = step_deg

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        angle = np.radians((np.atleast_1d(np.asarray(time_s, float)) - 1) * self.step_deg * float(RATE))
        poses = np.tile(np.eye(4), (len(angle), 1, 1))
        poses[:, 0, 0] = poses[:, 2, 2] = np.cos(angle)
        poses[:, 0, 2], poses[:, 2, 0] = np.sin(angle), -np.sin(angle)
        return poses


def test_a_different_seed_draws_other_pixels_and_the_same_the_same() -> None:
    scene = wall(StillCamera(np.eye(4), 1.0))
    first, again, other = (made(scene, seed=seed, **NO_MARKS) for seed in (3, 3, 4))
    for technique in (first, again, other):
        for k in range(2):
            technique.render(view(scene, k))
    pictures = [t.show(view(scene, 1))["sampled"] for t in (first, again, other)]
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])
