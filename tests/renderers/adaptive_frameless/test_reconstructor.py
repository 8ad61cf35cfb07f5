"""The reconstructor against float64 numpy, and its rules."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.reconstructor import Filter, Reconstructor, extents
from tests.renderers.adaptive_frameless.fake_rays import FakeRun, still_poses

FILTER = Filter(6000.0, 4.0, 1 / 255, 0.01, 0.3, 1 / 60, 1e-2, np.inf, True)


def shown(x, y, t):
    return 0.5 + 0.25 * np.sin(0.8 * x + 3 * t) + 0.2 * np.cos(0.5 * y)


def by_numpy(run: FakeRun, r: Reconstructor, f: Filter, sizes: np.ndarray, now_s: float, shift_px: float) -> np.ndarray:
    """The weighted mean of every sample at every pixel, slowly and in float64 (a camera that slid by ``shift_px``)."""
    b, (width, height) = run.sampler.buffers, run.size_px
    kept = b.number[c.KEPT]
    v = b.stream_f[:kept].astype(np.float64)
    px, py = v[:, 3] + width / 2 + shift_px, height / 2 - v[:, 4]
    age = np.maximum(now_s - b.stream_t[:kept], 0)
    column, row = np.clip(px.astype(int), 0, width - 1), np.clip(py.astype(int), 0, height - 1)
    inside = (px >= -1) & (px < width + 1) & (py >= -1) & (py < height + 1)
    half = 0.5 * sizes.reshape(height, width)[row, column].astype(np.float64)
    picture = np.zeros((height, width, 3))
    for y in range(height):
        for x in range(width):
            fx, fy, ft = r.filters[y * width + x].astype(np.float64)
            dx, dy = x + 0.5 - px, y + 0.5 - py
            on = inside & (np.abs(dx) <= half) & (np.abs(dy) <= half)
            q = dx**2 * fx + dy**2 * fy + age**2 * ft
            w = on * (f.tail / (1 + q) ** 2 + np.where(q < 4, np.exp(-4.5 * q), 0))
            picture[y, x] = (w[:, None] * v[:, :3]).sum(0) / w.sum() if w.sum() > 0 else 0
    return picture


@pytest.mark.parametrize("shift_px", [0.0, 2.4])
def test_splats_are_those_of_float64_numpy(shift_px: float) -> None:
    run = FakeRun((24, 18), shown)
    run.run(600)
    poses = still_poses(run.size_px, run.now_s, shift_px)
    r = Reconstructor(run.size_px, len(run.sampler.buffers.stream_t), 2.0)
    r.sizes[:] = np.random.default_rng(1).uniform(2.5, 6.3, r.sizes.shape)
    sizes = r.sizes.copy()
    camera, movers = poses.camera[1], np.ascontiguousarray(poses.movers[:, 1])
    picture = r.reconstruct(run.sampler.buffers, FILTER, camera, movers, poses.window, poses.lens, run.now_s)
    wanted = by_numpy(run, r, FILTER, sizes, run.now_s, shift_px)
    np.testing.assert_allclose(picture, wanted, atol=2e-5)
    assert picture.std() > 0.05


def test_the_picture_does_not_depend_on_the_number_of_threads() -> None:
    from numba import get_num_threads, set_num_threads

    run = FakeRun((24, 18), shown)
    run.run(300)
    poses, before, pictures = still_poses(run.size_px, run.now_s), get_num_threads(), []
    try:
        for threads in {1, before}:
            set_num_threads(threads)
            r = Reconstructor(run.size_px, len(run.sampler.buffers.stream_t), 2.0)
            for _ in range(3):
                pictures.append(
                    r.reconstruct(
                        run.sampler.buffers, FILTER, poses.camera[1], np.ascontiguousarray(poses.movers[:, 1]),
                        poses.window, poses.lens, run.now_s,
                    ).copy()
                )  # fmt: skip
    finally:
        set_num_threads(before)
    np.testing.assert_array_equal(pictures[2], pictures[-1])


def test_extents_span_equal_changes_and_keep_the_volume() -> None:
    ex, ey, et = extents(0.02, 0.05, 0.3, 20.0, 1e9, 0.0, 1e9)
    assert ex * ey * et == pytest.approx(20.0)
    assert ex * 0.02 == pytest.approx(ey * 0.05)
    assert ex * 0.02 == pytest.approx(et * 0.3)


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
    poses = still_poses(run.size_px, now_s)
    movers = np.ascontiguousarray(poses.movers[:, 1])
    return r.reconstruct(run.sampler.buffers, FILTER, poses.camera[1], movers, poses.window, poses.lens, now_s).copy()


def test_splats_grow_where_few_samples_reach_and_shrink_where_many_do() -> None:
    run = FakeRun((16, 16), shown)
    b = run.sampler.buffers
    r = Reconstructor(run.size_px, len(b.stream_t), 2.0)
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
    r = Reconstructor(run.size_px, len(b.stream_t), 2.0)
    first = splats(run, r, 0.1)
    b.stream_f[: b.number[c.KEPT], 5] = 1.0  # all behind the eye
    np.testing.assert_array_equal(splats(run, r, 0.2), first)


def test_an_empty_tile_and_zero_gradients_give_finite_filters() -> None:
    run = FakeRun((16, 16), lambda x, y, t: np.zeros_like(x))
    b = run.sampler.buffers
    b.node_f[b.leaves[0]] = 0.0
    r = Reconstructor(run.size_px, len(b.stream_t), 2.0)
    picture = splats(run, r, 0.1)
    assert np.isfinite(r.filters).all()
    assert (r.filters > 0).all()
    np.testing.assert_array_equal(picture, 0.0)
