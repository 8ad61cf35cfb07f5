"""Reprojection against ground truth: where each pixel was, its colour, movers, holes; marks and look by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from renderers.backend import activate, mi
from renderers.engine import Engine
from renderers.foveated.post_filter import SEARCH_TEXELS, nearest_unmarked_px
from renderers.foveated.reprojection import DEVIATION, look, mark, normal_taps, world_depth
from renderers.foveated.support import IS_TEXEL, SupportGrid
from renderers.foveated.technique import Foveated
from renderers.frozen import frozen
from renderers.parameters import Foveated as Parameters
from renderers.vanilla import frame_lanes
from stimuli import load_scene
from stimuli.encode import srgb_from_linear
from stimuli.scene import Mover, Scene
from tests.renderers.foveated.test_technique import (
    NO_MARKS,
    RATE,
    SIZE,
    Turning,
    reference_depth,
    vanilla_frame,
    view,
    wall,
)
from tests.renderers.scenes import SlidingCamera, quad, scene_of, unlit, velocity_for

activate()


def true_motion(engine: Engine, at: object) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 2) motion of the surfaces between t0 and t1, from the engine's own local points; and what was hit."""
    width, height = at.size_px
    pixel, x, y = frame_lanes(at.size_px)

    def kernel(state: object, x: object, y: object) -> tuple:
        sample = engine.sample(state, engine.camera_ray(state, x, y), want_motion=True)
        return engine.motion(state, sample, reflected=False), sample.hit

    motion, hit = frozen(kernel)(width * height, engine.state(at), x, y)
    order = pixel.numpy()
    found, seen = np.zeros((width * height, 2)), np.zeros(width * height, bool)
    found[order], seen[order] = np.stack([motion.x.numpy(), motion.y.numpy()], 1), hit.numpy()
    return found.reshape(height, width, 2), seen.reshape(height, width)


def places(scene: Scene, frames: int, **params: object) -> tuple[np.ndarray, np.ndarray, Foveated]:
    """(H, W, 2) places and (H, W) depth of the last of ``frames`` frames."""
    technique = Foveated(Engine(scene), SIZE, Parameters(**params), 1, "total")
    kept = {}
    draw = technique._rasteriser.draw

    def watched(vertices: object, indices: object) -> object:
        kept["place"], kept["depth"] = draw(vertices, indices)
        return kept["place"], kept["depth"]

    technique._rasteriser.draw = watched
    for k in range(frames):
        technique.render(view(scene, k))
    width, height = SIZE
    return (
        kept["place"].numpy().reshape(height, width, 2).copy(),
        kept["depth"].numpy().reshape(height, width),
        technique,
    )


def centres() -> np.ndarray:
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    return np.stack([x, y], -1)


@pytest.mark.parametrize("motion_px", [(3.0, 0.0), (-2.25, 1.5), (0.0, -7.0)])
def test_a_camera_that_slides_along_a_wall(motion_px: tuple[float, float]) -> None:
    scene = wall(SlidingCamera(velocity_for(motion_px, 2.0, SIZE[1], float(RATE))))
    place, _, _ = places(scene, 2)
    wanted = centres() - np.array(motion_px)
    inside = ~np.isnan(place[..., 0])
    np.testing.assert_allclose(place[inside], wanted[inside], atol=2e-3)
    stays = (wanted > 0).all(-1) & (wanted < np.array(SIZE)).all(-1)
    assert inside[stays].mean() > 0.99


@pytest.mark.parametrize("camera", [SlidingCamera((0.3, 0.1, -0.4)), Turning(1.5)])
def test_places_agree_with_the_engines_motion_vectors(camera: object) -> None:
    """Sliding towards a wall, and turning: ground truth is the motion of each pixel's own surface point."""
    scene = wall(camera)
    place, _, _ = places(scene, 3)
    motion, hit = true_motion(Engine(scene), view(scene, 2))
    inside = hit & ~np.isnan(place[..., 0])
    assert inside.mean() > 0.8
    np.testing.assert_allclose((centres() - place)[inside], motion[inside], atol=5e-3)


def test_mesh_vertices_move_with_a_mover_unless_told_not_to() -> None:
    scene = load_scene("toy_car")
    motion, hit = true_motion(Engine(scene), view(scene, 2))
    moving = hit & (np.hypot(*np.moveaxis(motion, -1, 0)) > 0.3)
    assert moving.sum() > 50
    errors = {}
    for follow in (True, False):
        place, _, _ = places(scene, 3, reproject_movers=follow)
        difference = np.linalg.norm(centres() - place - motion, axis=-1)[moving]
        errors[follow] = np.nanpercentile(difference, [25, 50])
    # the mesh is coarse (4.6 px) and the car small: at its outline triangles reach to the floor
    assert errors[True][0] < 0.03
    assert errors[True][1] < 0.4 * errors[False][1]
    assert errors[False][0] > 0.3


def test_depth_of_the_mesh_is_the_depth_of_the_scene() -> None:

    scene = wall(SlidingCamera((0.3, 0.1, -0.4)))
    _, depth, technique = places(scene, 2)
    at = view(scene, 1)
    to_world = technique.engine.state(at).to_world
    found = world_depth(mi.Float(depth.ravel().astype(np.float32)), to_world).numpy().reshape(depth.shape)
    there = depth < 1
    np.testing.assert_allclose(found[there], reference_depth(technique.engine, at)[there], rtol=2e-3)


def test_colour_agrees_with_the_truth_where_nothing_was_disoccluded() -> None:
    """Whole pixels of motion: what is carried over is the old pixel itself."""
    scene = wall(SlidingCamera(velocity_for((4.0, -2.0), 2.0, SIZE[1], float(RATE))))
    technique = Foveated(Engine(scene), SIZE, Parameters(p_min=0.0, r0_deg=0.0, r1_deg=0.0, **NO_MARKS), 1, "total")
    for k in range(4):
        frame = technique.render(view(scene, k))
    wanted = vanilla_frame(scene, view(scene, 3)).color
    carried = technique.show(view(scene, 3))["samples"] > 0
    assert carried.mean() > 0.8
    wrong = np.abs(frame.color - wanted).max(-1)[carried] > 0.02
    assert wrong.mean() < 0.01
    sampled = technique.show(view(scene, 3))["sampled"] > 0
    assert sampled.mean() < 0.08


def test_what_moved_in_is_filled_from_the_support_image() -> None:
    scene = wall(SlidingCamera(velocity_for((40.0, 0.0), 2.0, SIZE[1], float(RATE))), block=64)
    technique = Foveated(Engine(scene), SIZE, Parameters(p_min=0.0, r0_deg=0.0, r1_deg=0.0, **NO_MARKS), 1, "total")
    for k in range(3):
        frame = technique.render(view(scene, k))
    empty = technique.show(view(scene, 2))["samples"] == 0
    assert empty[:, :38].mean() > 0.9
    wanted = vanilla_frame(scene, view(scene, 2)).color
    assert np.abs(frame.color - wanted)[empty].mean() < 0.05
    assert (frame.color[empty].max(-1) > 0).all()


@pytest.mark.parametrize("size_px", [(1182, 1464), (120, 90), (7, 5), (1, 1), (1, 9), (3, 1)])
def test_support_texels_are_pixels_of_the_picture(size_px: tuple[int, int]) -> None:
    grid = SupportGrid.of(size_px, 4.6)
    if size_px == (1182, 1464):
        assert (grid.columns, grid.rows) == (256, 318)  # the paper's
    pixels = grid.texel_pixels().astype(int)
    assert len(set(pixels)) == grid.texels
    i = np.arange(grid.columns)
    x = np.array([int(np.floor((k + 0.5) * grid.width / grid.columns)) for k in i])
    np.testing.assert_array_equal(pixels[: grid.columns] % grid.width, x)
    of = grid.texel_of_pixels()
    np.testing.assert_array_equal(np.flatnonzero(of >= IS_TEXEL), np.sort(pixels))
    np.testing.assert_array_equal(of[pixels] & (IS_TEXEL - 1), np.arange(grid.texels))
    vx, vy, texel = grid.vertices()
    assert (vx.min(), vx.max(), vy.min(), vy.max()) == (0, grid.width, 0, grid.height)
    assert len(texel) == (grid.columns + 2) * (grid.rows + 2)


def marks_of(z: np.ndarray, luma: np.ndarray, edge: np.ndarray, seen: np.ndarray, **params: float) -> np.ndarray:
    height, width = z.shape
    looks = mi.Float(np.stack([z, luma, edge, seen], -1).astype(np.float32).ravel())
    grid = SupportGrid(width * 5, height * 5, width, height)
    return mark(Parameters(**params), grid, looks).numpy().reshape(z.shape)


def marks_by_hand(z: np.ndarray, luma: np.ndarray, edge: np.ndarray, seen: np.ndarray, p: Parameters) -> np.ndarray:
    out = np.zeros(z.shape, np.uint32)
    for (j, i), own in np.ndenumerate(z):
        if not seen[j, i]:
            continue
        out[j, i] = edge[j, i] < p.eps_edge
        for b, a in ((j - 1, i), (j + 1, i), (j, i - 1), (j, i + 1)):
            if 0 <= b < z.shape[0] and 0 <= a < z.shape[1] and seen[b, a]:
                out[j, i] |= abs(own - z[b, a]) > p.eps_depth * own
                out[j, i] |= abs(luma[j, i] - luma[b, a]) > p.eps_lum
    return out


def test_marks_agree_with_the_definition() -> None:
    rng = np.random.default_rng(2)
    for _ in range(5):
        z, luma = 1 + (rng.random((9, 13)) < 0.1) * 0.2, 0.5 * (rng.random((9, 13)) < 0.1)
        edge, seen = rng.random((9, 13)), rng.random((9, 13)) < 0.9
        wanted = marks_by_hand(z, luma, edge, seen, Parameters())
        np.testing.assert_array_equal(marks_of(z, luma, edge, seen), wanted)
        assert 0 < wanted.mean() < 1


def test_distance_to_the_nearest_unmarked_block_is_that_of_a_search_along_both_axes() -> None:
    rng = np.random.default_rng(4)
    grid = SupportGrid.of((61, 47), 4.6)
    marks = (rng.random(grid.texels) < 0.85).astype(np.uint32)
    pixels = np.flatnonzero(marks[grid.texel_of_pixels() & (IS_TEXEL - 1)])
    found = nearest_unmarked_px(grid, mi.UInt32(marks), mi.UInt32(pixels.astype(np.uint32))).numpy()
    marked = marks[grid.texel_of_pixels() & (IS_TEXEL - 1)].reshape(47, 61) > 0
    for pixel, distance in zip(pixels, found, strict=True):
        y, x = divmod(int(pixel), 61)
        row, column = np.flatnonzero(~marked[y]), np.flatnonzero(~marked[:, x])
        wanted = min([abs(row - x).min() if len(row) else np.inf, abs(column - y).min() if len(column) else np.inf])
        if wanted < 4 * SEARCH_TEXELS:  # within reach
            assert distance == wanted
        else:
            assert distance >= 4 * SEARCH_TEXELS


def test_a_mesh_behind_the_eye_or_at_the_edge_of_time_is_no_trouble() -> None:
    """The camera leaps through the wall: all that was seen is behind it."""
    scene = wall(SlidingCamera((0.0, 0.0, -4 * float(RATE))))
    technique = Foveated(Engine(scene), SIZE, Parameters(), 1, "total")
    for k in range(3):
        frame = technique.render(view(scene, k, cut=k == 0))
        assert np.isfinite(frame.color).all()


def test_the_taps_are_nearly_normal() -> None:
    bits = np.random.default_rng(1).integers(0, 2**32, 200_000, np.uint32)
    taps = normal_taps(mi.UInt32(bits))
    values = np.concatenate([(tap.x.numpy(), tap.y.numpy()) for tap in taps]) / DEVIATION
    np.testing.assert_allclose(values.mean(axis=1), 0, atol=0.01)
    np.testing.assert_allclose(np.cov(values), np.eye(4), atol=0.01)
    # a sum of four has 6/5 / 4 less kurtosis than the normal's 3
    np.testing.assert_allclose((values**4).mean(axis=1), 2.7, atol=0.05)
    assert np.abs(values).max() < 3.5


@pytest.mark.parametrize("pace", [1.0, 10.0])
def test_what_a_mover_uncovers_is_traced_anew_though_its_depth_is_nearly_the_same(pace: float) -> None:
    """A red panel slides a hundredth of its distance before a grey wall, ``pace`` px a frame: it leaves no trail."""
    wide = scene_of(
        quad((-9, -9, -2), (18, 0, 0), (0, 18, 0), unlit(color=(0.3, 0.3, 0.3)), "wall"),
        camera=SlidingCamera((0.0, 0.0, 0.0)),
    )
    speed = velocity_for((pace, 0.0), 1.98, SIZE[1], float(RATE))[0]
    panel = quad((0.6, -0.3, -1.98), (0.4, 0, 0), (0, 0.6, 0), unlit(color=(0.9, 0.05, 0.05)), "panel")
    slide = SlidingCamera((-abs(speed), 0.0, 0.0))  # its poses are a track as good as any
    scene = replace(wide, movers=(Mover("panel", (panel,), slide),))
    technique = Foveated(Engine(scene), SIZE, Parameters(p_min=0.0, r0_deg=0.0, r1_deg=0.0, **NO_MARKS), 1, "total")
    for k in range(7):
        frame = technique.render(view(scene, k))
    wanted = vanilla_frame(scene, view(scene, 6)).color
    still = vanilla_frame(scene, view(scene, 0)).color
    uncovered = (still[..., 1] < 0.1) & (wanted[..., 1] > 0.2)
    assert uncovered.sum() > min(5 * pace, 14) * 20
    wrong = np.abs(frame.color - wanted).max(-1) > 0.02  # single pixels of the corners
    assert wrong[uncovered].mean() < 0.03
    assert wrong.mean() < 0.002
    traced = technique.show(view(scene, 6))["sampled"]
    assert traced.mean() < 0.25


def test_the_coarse_picture_is_the_mean_of_what_is_displayed() -> None:
    """Random colours up to 20 times white, nothing moves: luma of the 3x3 taps' mean, each no more than white."""
    grid, exposure = SupportGrid.of((60, 45), 4.6), 4.0
    rng = np.random.default_rng(6)
    shown = (10 ** rng.uniform(-3, 0.7, (45, 60, 4))).astype(np.float32)
    y, x = np.mgrid[:45, :60] + 0.5
    place = mi.Float(np.stack([x, y], -1).astype(np.float32).ravel())
    depth, edge = mi.Float(np.full(45 * 60, 0.999, np.float32)), mi.Float(np.ones(grid.mesh[0] * grid.mesh[1]))
    pixels = grid.texel_pixels()
    found = look(
        grid, place, depth, mi.Float(shown.ravel()), edge, None, mi.Float(1.0), mi.Float(exposure), mi.UInt32(pixels)
    ).numpy().reshape(-1, 4)  # fmt: skip
    for texel, pixel in enumerate(pixels.astype(int)):
        row, column = divmod(pixel, 60)
        taps = [
            shown[np.clip(row + dy, 0, 44), np.clip(column + dx, 0, 59), :3]
            for dy in (-round(45 / grid.rows / 3), 0, round(45 / grid.rows / 3))
            for dx in (-round(60 / grid.columns / 3), 0, round(60 / grid.columns / 3))
        ]
        mean = np.minimum(np.array(taps) * exposure, 1).mean(axis=0)
        assert found[texel, 1] == pytest.approx(srgb_from_linear(mean) @ [0.2126, 0.7152, 0.0722], abs=1e-4)
    np.testing.assert_allclose(found[:, 0], 1e-3 / (1 - np.float32(0.999)), rtol=1e-4)
    assert (found[:, 3] == 1).all()
