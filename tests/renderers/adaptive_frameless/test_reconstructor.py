"""The reconstructor against float64 numpy, and its rules."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.reconstructor import Reconstructor, extents
from renderers.adaptive_frameless.splats import Choice, Filter, Scenery, make_splats
from tests.renderers.adaptive_frameless.fake_rays import FakeRun, still_poses

FILTER = Filter(6000.0, 4.0, 1 / 255, 0.01, 0.3, 1 / 60, 1e-2, np.inf, True)


def shown(x, y, t):
    return 0.5 + 0.25 * np.sin(0.8 * x + 3 * t) + 0.2 * np.cos(0.5 * y)


def scenery_of(run: FakeRun, now_s: float, shift_px: float = 0.0) -> Scenery:
    """The plane seen by a camera that slid by ``shift_px``; mover 1 has moved, mover 2 is gone."""
    poses = still_poses(run.size_px, now_s, shift_px)
    movers = np.tile(np.eye(3, 4), (3, 1, 1))
    movers[1, :, 3] = 1.5, -2.25, -0.5
    window = np.array([[-np.inf, np.inf], [-1.0, 0.5], [-1.0, -0.1]])
    return Scenery(poses.camera[1], movers, window, poses.lens, now_s)


def reconstructor_of(run: FakeRun, kind: Choice = "numba") -> Reconstructor:
    splats = make_splats(kind, False, run.size_px, len(run.sampler.buffers.stream_t))
    assert splats.name == kind
    return Reconstructor(run.size_px, splats, 2.0)


def by_numpy(run: FakeRun, r: Reconstructor, f: Filter, sizes: np.ndarray, at: Scenery) -> tuple[np.ndarray, ...]:
    """The weighted mean of every sample at every pixel and how many reach it, slowly and in float64."""
    b, (width, height) = run.sampler.buffers, run.size_px
    kept = b.number[c.KEPT]
    v, mover = b.stream_f[:kept].astype(np.float64), b.stream_i[:kept]
    point = v[:, 3:6] + at.movers[mover, :, 3] - at.camera[:, 3]
    px, py, depth = point[:, 0] / -point[:, 2] + width / 2, height / 2 + point[:, 1] / point[:, 2], -point[:, 2]
    far = np.abs(px - v[:, 6]) + np.abs(py - v[:, 7])
    age = np.maximum(at.now_s - b.stream_t[:kept], 0)
    column, row = np.clip(px.astype(int), 0, width - 1), np.clip(py.astype(int), 0, height - 1)
    inside = (px >= -1) & (px < width + 1) & (py >= -1) & (py < height + 1) & (mover < 2)
    half = 0.5 * sizes.reshape(height, width)[row, column].astype(np.float64)
    picture, reached = np.zeros((height, width, 3)), np.zeros((height, width))
    for y in range(height):
        for x in range(width):
            fx, fy, ft = r.filters[y * width + x].astype(np.float64)
            dx, dy = x + 0.5 - px, y + 0.5 - py
            on = inside & (np.abs(dx) <= half) & (np.abs(dy) <= half)
            own = inside & (np.floor(px) == x) & (np.floor(py) == y)
            if f.depth_tolerance < np.inf and own.any():
                least = depth[own].min()
                front = own & (depth <= least * 1.000001)  # float32 may order equal depths anyhow
                behind = (depth > least * f.depth_tolerance) & (age > age[front].min())
                on &= ~(behind & ((far > 0.5) | (mover[front] > 0).any()))
            q = dx**2 * fx + dy**2 * fy + age**2 * ft
            w = on * (f.tail / (1 + q) ** 2 + np.where(q < 4, np.exp(-4.5 * q), 0))
            picture[y, x] = (w[:, None] * v[:, :3]).sum(0) / max(w.sum(), 1e-300)
            reached[y, x] = on.sum()
    return picture, reached


KINDS = ("numba", "moderngl")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("shift_px", "depth_tolerance"), [(0.0, np.inf), (2.4, np.inf), (0.0, 1.1), (2.4, 1.1)])
def test_splats_are_those_of_float64_numpy(kind: Choice, shift_px: float, depth_tolerance: float) -> None:
    run = FakeRun((24, 18), shown)
    r, rng, f = reconstructor_of(run, kind), np.random.default_rng(1), FILTER._replace(depth_tolerance=depth_tolerance)
    b = run.sampler.buffers
    for _ in range(2):  # the second time most of the stream is known
        run.run(400)
        b.stream_f[:, 5] = rng.choice([-1.0, -1.3], len(b.stream_f))
        b.stream_i[:] = rng.choice(3, len(b.stream_i), p=(0.7, 0.2, 0.1))
        r.sizes[:] = rng.uniform(2.5, 6.3, r.sizes.shape)
        sizes, at = r.sizes.copy(), scenery_of(run, run.now_s, shift_px)
        if kind == "moderngl":
            r.splats._known = None  # the stream was changed behind its back
        picture = r.reconstruct(b, at, f)
        wanted, reached = by_numpy(run, r, f, sizes, at)
        np.testing.assert_allclose(picture[reached > 0], wanted[reached > 0], atol=2e-5)
        np.testing.assert_array_equal(r.coverage[:, 0].reshape(reached.shape), reached)
        assert picture.std() > 0.05
    r.splats.close()


def test_the_card_follows_the_stream_round_its_ring() -> None:
    run = FakeRun((24, 18), shown)
    card, bands = reconstructor_of(run, "moderngl"), reconstructor_of(run)
    room = len(run.sampler.buffers.stream_t)
    for visits, rate in ((20, 1000.0), (room // 12, 1000.0), (room // 12, 1000.0), (room // 3, 1000.0), (30, 0.3)):
        run.run(visits, visits_per_s=rate)  # within the ring, across its end twice, all of it, and past the time base
        at = scenery_of(run, run.now_s)
        a, wanted = (
            card.reconstruct(run.sampler.buffers, at, FILTER),
            bands.reconstruct(run.sampler.buffers, at, FILTER),
        )
        np.testing.assert_allclose(a, wanted, atol=1e-4)
    card.splats.close()


def test_splats_are_drawn_by_the_card_where_rays_are_traced_on_one() -> None:
    assert make_splats("auto", False, (4, 4), 8).name == "numba"
    card = make_splats("auto", True, (4, 4), 8)
    assert card.name == "moderngl"
    card.close()


def test_the_picture_does_not_depend_on_the_number_of_threads() -> None:
    from numba import get_num_threads, set_num_threads

    run = FakeRun((24, 18), shown)
    run.run(300)
    before, pictures = get_num_threads(), []
    try:
        for threads in {1, before}:
            set_num_threads(threads)
            r = reconstructor_of(run)
            pictures += [splats(run, r, run.now_s) for _ in range(3)]
    finally:
        set_num_threads(before)
    np.testing.assert_array_equal(pictures[2], pictures[-1])


def test_extents_span_equal_changes_and_keep_the_volume() -> None:
    ex, ey, et = extents(0.02, 0.05, 0.3, 20.0, 1e9, 0.0, 1e9)
    assert ex * ey * et == pytest.approx(20.0)
    assert ex * 0.02 == pytest.approx(ey * 0.05)
    assert ex * 0.02 == pytest.approx(et * 0.3)


def test_the_first_fill_counts_as_a_sample_a_pixel_while_it_is_young() -> None:
    rate = 1e-3  # samples a pixel and second: a filter's four samples would take an hour, or all of a tile
    alone = extents(0.02, 0.02, 0.01, 4.0 / rate, 64.0, 1 / 60, 10.0)
    beside = extents(0.02, 0.02, 0.01, 4.0 / rate, 64.0, 1 / 60, 10.0, 1.0 / rate, 0.1)
    old = extents(0.02, 0.02, 0.01, 4.0 / rate, 64.0, 1 / 60, 10.0, 1.0 / rate, 40.0)
    assert alone[0] * alone[1] == pytest.approx(4.0 / rate / 10.0)
    assert beside[0] * beside[1] == pytest.approx(4.0, rel=0.02)
    assert old == pytest.approx(alone)


@pytest.mark.parametrize("gradients", [(1 / 255, 1 / 255, 0.01), (10.0, 1e-3, 100.0), (1e-3, 10.0, 1e-2)])
def test_extents_stay_within_their_limits(gradients) -> None:
    ex, ey, et = extents(*gradients, 0.65, 8.0, 1 / 60, 1.0)
    assert 1 <= ex <= 8
    assert 1 <= ey <= 8
    assert 1 / 60 <= et <= 1


def test_change_over_time_shortens_filters_and_edges_narrow_them() -> None:
    calm = extents(0.02, 0.02, 0.1, 4.0, 64.0, 1 / 60, 10.0)
    fast = extents(0.02, 0.02, 2.0, 4.0, 64.0, 1 / 60, 10.0)
    edge = extents(0.2, 0.02, 0.1, 4.0, 64.0, 1 / 60, 10.0)
    assert fast[2] < calm[2]
    assert fast[0] > calm[0]
    assert edge[0] < calm[0]


def splats(run: FakeRun, r: Reconstructor, now_s: float) -> np.ndarray:
    return r.reconstruct(run.sampler.buffers, scenery_of(run, now_s), FILTER).copy()


def test_splats_grow_where_few_samples_reach_and_shrink_where_many_do() -> None:
    run = FakeRun((16, 16), shown)
    r = reconstructor_of(run)
    r.sizes[:] = 2.0
    splats(run, r, 0.1)  # one sample at the middle of each pixel: each reaches its own and the neighbours' edge
    few = r.coverage[:, 0] < 4
    if few.any():
        np.testing.assert_allclose(r.sizes[few], 8.0)
    r.sizes[:] = 12.0
    splats(run, r, 0.1)
    many = r.coverage[:, 0] > 32
    assert many.any()
    np.testing.assert_allclose(r.sizes[many], 12.0 * 0.7, rtol=1e-6)
    for _ in range(60):
        splats(run, r, 0.1)
    inner = r.coverage[:, 0].reshape(16, 16)[3:-3, 3:-3]
    assert inner.min() >= 1
    assert inner.max() <= 81


def test_a_pixel_that_no_sample_reaches_keeps_what_it_showed() -> None:
    run = FakeRun((16, 16), shown)
    b = run.sampler.buffers
    r = reconstructor_of(run)
    first = splats(run, r, 0.1)
    b.stream_f[: b.number[c.KEPT], 5] = 1.0  # all behind the eye
    np.testing.assert_array_equal(splats(run, r, 0.2), first)


def test_an_empty_tile_and_zero_gradients_give_finite_filters() -> None:
    run = FakeRun((16, 16), lambda x, y, t: np.zeros_like(x))
    b = run.sampler.buffers
    b.node_f[b.leaves[0]] = 0.0
    r = reconstructor_of(run)
    picture = splats(run, r, 0.1)
    assert np.isfinite(r.filters).all()
    assert (r.filters > 0).all()
    np.testing.assert_array_equal(picture, 0.0)
