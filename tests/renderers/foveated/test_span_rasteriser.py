"""The depth mesh drawn in numba: every pixel once, projective values, the nearer surface, near plane, OpenGL too."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.backend import activate, dr, mi
from renderers.engine import Engine
from renderers.foveated import span_rasteriser
from renderers.foveated.span_rasteriser import SpanRasteriser, make_rasteriser
from renderers.foveated.technique import Foveated
from renderers.gl.context import NEAR, MeshRasteriser
from renderers.parameters import Foveated as Parameters
from tests.renderers.foveated.test_technique import made, view, wall

activate()
SIZE = (67, 41)


def grid(columns: int, rows: int) -> np.ndarray:
    """Two triangles a cell, uint32."""
    i, j = np.meshgrid(np.arange(columns - 1), np.arange(rows - 1))
    a = (j * columns + i).ravel()
    return np.stack([a, a + columns, a + 1, a + columns, a + 1, a + columns + 1], axis=1).astype(np.uint32).ravel()


def mesh(x: np.ndarray, y: np.ndarray, w: np.ndarray, was: np.ndarray) -> np.ndarray:
    """(V, 8) float32: vertices at picture places ``x``, ``y`` (px), depth ``w``; ``was`` (V, 2) px at that depth."""
    at = [(2 * x / SIZE[0] - 1) * w, (2 * y / SIZE[1] - 1) * w, w - 2 * NEAR, w]
    return np.stack([*at, was[:, 0] * w, was[:, 1] * w, w, 0 * w], axis=1).astype(np.float32)


def drawn(kind: type, vertices: np.ndarray, indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rasteriser = kind(SIZE, len(vertices), 1) if kind is SpanRasteriser else kind(SIZE, 40, 40)
    place, depth = rasteriser.draw(mi.Float(vertices.ravel()), indices)
    found = place.numpy().reshape(SIZE[1], SIZE[0], 2).copy(), depth.numpy().reshape(SIZE[1], SIZE[0]).copy()
    rasteriser.close()
    return found


def shaken(seed: int, columns: int = 9, rows: int = 8) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A mesh over the picture and a little more: x, y of its vertices, shaken by less than half a cell, and w."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-4, SIZE[0] + 4, columns), np.linspace(-4, SIZE[1] + 4, rows))
    step = np.array([(SIZE[0] + 8) / (columns - 1), (SIZE[1] + 8) / (rows - 1)])
    x, y = (v.ravel() + rng.uniform(-0.3, 0.3, v.size) * s for v, s in zip((x, y), step, strict=True))
    return x, y, rng.uniform(1, 5, x.size)


@pytest.mark.parametrize("seed", range(5))
def test_triangles_that_share_edges_leave_no_gap(seed: int) -> None:
    x, y, w = shaken(seed)
    x[20:30], y[20:30] = np.round(x[20:30] * 2) / 2, np.round(y[20:30] * 2) / 2  # edges through pixel centres
    inside = (x > 0) & (x < SIZE[0])
    assert inside.any()
    place, depth = drawn(SpanRasteriser, mesh(x, y, w, np.stack([x, y], axis=1)), grid(9, 8))
    assert np.isfinite(place[8:-8, 8:-8]).all()
    assert (depth[8:-8, 8:-8] < 1).all()


def test_values_are_projective() -> None:
    """A plane seen at an angle: what was at (x, y) then is told at every pixel to float32's digits."""
    x, y, _ = shaken(3)
    w = 1 / (0.2 + 0.005 * x + 0.003 * y)  # 1 / w is linear in the picture
    was = np.stack([3 + 2 * x - y, 1 + 0.5 * x + y], axis=1)  # linear in the picture, too: the same plane again
    place, depth = drawn(SpanRasteriser, mesh(x, y, w, was), grid(9, 8))
    cx, cy = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    seen = np.isfinite(place[..., 0])
    assert seen[8:-8, 8:-8].all()
    np.testing.assert_allclose(depth[seen], (1 - NEAR * (0.2 + 0.005 * cx + 0.003 * cy))[seen], atol=1e-7)
    # was * w over w, both interpolated projectively: exact where was is linear in 1 / w's plane
    np.testing.assert_allclose(place[..., 0][seen], (3 + 2 * cx - cy)[seen], atol=2e-3)
    np.testing.assert_allclose(place[..., 1][seen], (1 + 0.5 * cx + cy)[seen], atol=2e-3)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_surface_is_seen_whatever_the_order(order: tuple[int, int]) -> None:
    squares = [
        mesh(np.array([0.0, 67, 0, 67]), np.array([0.0, 0, 41, 41]), np.full(4, 4.0), np.full((4, 2), 10.0)),
        mesh(np.array([20.0, 40, 20, 40]), np.array([10.0, 10, 30, 30]), np.full(4, 2.0), np.full((4, 2), 20.0)),
    ]
    vertices = np.concatenate([squares[k] for k in order])
    indices = np.concatenate([grid(2, 2), grid(2, 2) + 4])
    place, depth = drawn(SpanRasteriser, vertices, indices)
    wanted = np.full((SIZE[1], SIZE[0]), 10.0)
    wanted[10:30, 20:40] = 20
    np.testing.assert_allclose(place[..., 0], wanted, rtol=1e-6)
    np.testing.assert_allclose(depth, 1 - NEAR / np.where(wanted > 15, 2, 4), atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_it_draws_what_opengl_draws(seed: int) -> None:
    """Also through the eye's plane and behind it: some vertices have a w of 0 or less."""
    x, y, w = shaken(seed)
    rng = np.random.default_rng(seed)
    was = rng.uniform(0, 60, (x.size, 2))
    vertices = mesh(x, y, w, was)
    if seed % 2:
        behind = rng.choice(x.size, 9, replace=False)
        vertices[behind, 3] -= 5.0  # the same x and y in the eye's space, another w
        vertices[behind, 2] = vertices[behind, 3] - 2 * NEAR
    ours, theirs = (drawn(kind, vertices, grid(9, 8)) for kind in (SpanRasteriser, MeshRasteriser))
    both = np.isfinite(ours[0][..., 0]) & np.isfinite(theirs[0][..., 0])
    # OpenGL places vertices on 1/256 of a pixel: single pixels at edges differ.
    assert (np.isfinite(ours[0]) != np.isfinite(theirs[0])).mean() < 0.01
    assert both.mean() > 0.5
    away = np.abs(ours[0] - theirs[0]).max(axis=2)[both]
    assert np.quantile(away, 0.97) < 0.3
    assert np.median(away) < 0.02
    assert np.quantile(np.abs(ours[1] - theirs[1])[both], 0.97) < 1e-5


def test_nothing_ahead_and_no_triangle_leave_an_empty_picture() -> None:
    x, y, w = shaken(0)
    for vertices, indices in ((mesh(x, y, -w, np.zeros((x.size, 2))), grid(9, 8)),
                              (mesh(x, y, w, np.zeros((x.size, 2))), np.zeros(0, np.uint32))):  # fmt: skip
        place, depth = drawn(SpanRasteriser, vertices, indices)
        assert np.isnan(place).all()
        assert (depth == 1).all()


def test_the_parameter_chooses() -> None:
    assert isinstance(make_rasteriser("auto", False, SIZE, 2, 2), SpanRasteriser)
    assert isinstance(make_rasteriser("numba", True, SIZE, 2, 2), SpanRasteriser)
    for choice, on_gpu in (("auto", True), ("moderngl", False)):
        rasteriser = make_rasteriser(choice, on_gpu, SIZE, 2, 2)  # type: ignore[arg-type]
        assert isinstance(rasteriser, MeshRasteriser)
        rasteriser.close()


def test_both_give_the_same_pictures_of_a_scene() -> None:
    scene = wall()
    found = {}
    for choice in ("numba", "moderngl"):
        technique: Foveated = made(scene, rasteriser=choice)
        for k in range(4):
            frame = technique.render(view(scene, k))
        found[choice] = frame.color.copy()
        technique.close()
    assert Parameters().rasteriser == "auto"
    away = np.abs(found["numba"] - found["moderngl"])
    assert np.quantile(away, 0.99) < 0.02


@pytest.mark.parametrize("choice", ["numba", "moderngl"])
def test_what_crossing_to_opengl_costs_is_measured(choice: str) -> None:
    scene = wall()
    technique = Foveated(Engine(scene), (600, 450), Parameters(rasteriser=choice), 1, "stages")
    for k in range(3):
        frame = technique.render(view(scene, k, (600, 450)))
    technique.close()
    seconds = dict(frame.seconds)
    total = seconds.pop("total")
    assert seconds["raster"] > 0
    assert ("crossing" in seconds) == (choice == "moderngl")
    assert seconds.get("crossing", 1.0) > 1e-5
    assert 0.5 * total < sum(seconds.values()) <= total


def test_drjits_threads_make_way_for_the_rasteriser_and_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    before, seen, draw = dr.thread_count(), [], span_rasteriser._draw

    def watched(*arguments: object) -> None:
        seen.append(dr.thread_count())
        draw(*arguments)

    monkeypatch.setattr(span_rasteriser, "_draw", watched)
    x, y, w = shaken(0)
    vertices = mesh(x, y, w, np.zeros((x.size, 2)))
    try:
        for threads in (3, 1):
            dr.set_thread_count(threads)
            drawn(SpanRasteriser, vertices, grid(9, 8))
            assert dr.thread_count() == threads
        monkeypatch.setattr(span_rasteriser, "_draw", None)
        dr.set_thread_count(3)
        with pytest.raises(TypeError):
            drawn(SpanRasteriser, vertices, grid(9, 8))
        assert dr.thread_count() == 3
    finally:
        dr.set_thread_count(before)
    assert seen == [1, 1]
