"""The tiling against direct sums, its equalisation, its gain."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.balance import calmest_pair, summed_error, wanted_tiles, worst_tile
from renderers.adaptive_frameless.buffers import make_buffers
from renderers.adaptive_frameless.technique import sampler_settings
from renderers.adaptive_frameless.tiling import (
    can_split,
    merge,
    split,
    tile_error,
    tile_rectangles,
    undersampling,
    variation,
)
from renderers.parameters import AdaptiveFrameless
from tests.renderers.adaptive_frameless.fake_rays import FakeRun

DECAY = 3.47


def direct_sums(run: FakeRun, leaf: int, now_s: float) -> np.ndarray:
    """Columns W .. HIDDEN of a tile by float64 numpy from the queues themselves, weights at ``now_s``."""
    b, s = run.sampler.buffers, run.settings
    x0, y0, x1, y1 = b.node_i[leaf, :4]
    entries = [
        b.queue[y * s.width + x, k]
        for y in range(y0, y1)
        for x in range(x0, x1)
        for k in range(b.fill[y * s.width + x])
    ]
    e, i = b.entry_f[entries].astype(np.float64), b.entry_i[entries]
    weight = np.exp(-DECAY * (now_s - b.entry_t[entries]))
    luma, known = e[:, :5], e[:, c.GT] >= 0
    return np.array(
        [
            5 * weight.sum(), (weight * luma.sum(1)).sum(), (weight * (luma**2).sum(1)).sum(), weight.sum(),
            (weight * e[:, c.GX]).sum(), (weight * e[:, c.GY]).sum(), weight[known].sum(),
            (weight * e[:, c.GT])[known].sum(), len(entries), i[:, c.OCCLUDED].sum(),
        ]
    )  # fmt: skip


def largest_difference(run: FakeRun) -> float:
    """Of every tile's running sums and variance from direct ones, the largest, relative to the weight."""
    b = run.sampler.buffers
    worst = 0.0
    for leaf in b.leaves[: b.number[c.LEAVES]]:
        wanted = direct_sums(run, leaf, b.total[c.EPOCH])
        scale = max(wanted[0], 1.0)
        worst = max(worst, float(np.max(np.abs(b.node_f[leaf] - wanted))) / scale)
        if wanted[0] > 0:
            direct = wanted[2] / wanted[0] - (wanted[1] / wanted[0]) ** 2
            worst = max(worst, abs(variation(b, leaf) - direct))
    return worst


def check_partition(run: FakeRun) -> None:
    """Tiles cover every pixel once, and the map of pixels, places and pairs agree with the tree."""
    b, s = run.sampler.buffers, run.settings
    owner = np.full((s.height, s.width), -1)
    for place, leaf in enumerate(b.leaves[: b.number[c.LEAVES]]):
        x0, y0, x1, y1 = b.node_i[leaf, :4]
        assert (owner[y0:y1, x0:x1] == -1).all()
        owner[y0:y1, x0:x1] = leaf
        assert b.node_i[leaf, c.PLACE] == place
        assert b.node_i[leaf, c.LEFT] == -1
    np.testing.assert_array_equal(owner.ravel(), b.leaf_of)
    leaves = set(b.leaves[: b.number[c.LEAVES]].tolist())
    parents = [b.node_i[leaf, c.PARENT] for leaf in leaves]
    wanted = {p for p in parents if p >= 0 and {b.node_i[p, c.LEFT], b.node_i[p, c.RIGHT]} <= leaves}
    assert set(b.pairs[: b.number[c.PAIRS]].tolist()) == wanted
    assert b.number[c.FREE_NODES] + 2 * len(leaves) - 1 == len(b.free_nodes)


def busy(x, y, t):
    return 0.5 + 0.25 * np.sin(0.8 * x + 9 * t) + 0.25 * np.cos(0.5 * y - 5 * t)


@pytest.mark.parametrize("size_px", [(32, 24), (22, 17), (1, 40), (1, 1)])
def test_running_sums_stay_those_of_the_queues(size_px) -> None:
    run = FakeRun(size_px, busy, samples_per_s=6000.0)
    run.run(6000)
    assert largest_difference(run) < 1e-6
    check_partition(run)
    b = run.sampler.buffers
    assert b.number[c.ENTRIES] == b.fill.sum() == len(b.free) - b.number[c.FREE]
    leaves = b.leaves[: b.number[c.LEAVES]]
    np.testing.assert_allclose(b.total[c.W + 3 : c.COUNT], b.node_f[leaves, 3 : c.COUNT].sum(0), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("size_px", [(64, 48), (33, 70)])
def test_the_remembered_worst_and_calmest_are_those_of_a_full_search(size_px) -> None:
    run = FakeRun(size_px, busy, least_mean_tile_px=8, least_tiles=16, i=0.01)
    s, b = run.settings, run.sampler.buffers
    most = 0
    for _ in range(60):
        run.run(25)
        tiles, pairs = b.leaves[: b.number[c.LEAVES]], b.pairs[: b.number[c.PAIRS]]
        most = max(most, len(tiles))
        errors = [b.error[k] for k, tile in enumerate(tiles) if can_split(b, s, tile)]
        found = worst_tile(b, s)
        assert b.error[b.node_i[found, c.PLACE]] == max(errors)
        assert summed_error(b, calmest_pair(b)) == min(summed_error(b, pair) for pair in pairs)
    assert most > 4 * c.BLOCK


def test_variance_is_weighted_by_age() -> None:
    run = FakeRun((8, 8), lambda x, y, t: 0.2 + 0.1 * np.floor(t), least_tiles=1, least_mean_tile_px=64)
    run.run(200, visits_per_s=50.0, adjust=False)
    b = run.sampler.buffers
    now_s = run.now_s
    entries = [b.queue[p, k] for p in range(64) for k in range(b.fill[p])]
    weight = np.exp(-DECAY * (now_s - b.entry_t[entries]))
    luma = b.entry_f[entries, 0].astype(np.float64)
    mean = np.average(luma, weights=weight)
    assert variation(b, b.leaves[0]) == pytest.approx(np.average((luma - mean) ** 2, weights=weight), rel=1e-9)


def test_split_and_merge_are_inverse() -> None:
    run = FakeRun((16, 16), busy, least_tiles=1)
    b, s = run.sampler.buffers, run.settings
    run.run(300, adjust=False)
    root = b.leaves[0]
    before = b.node_f[root].copy()
    split(b, s, root)
    check_partition(run)
    halves = b.node_f[b.leaves[:2]].sum(0)
    np.testing.assert_allclose(halves, before, rtol=1e-9, atol=1e-9)  # the halves are summed anew
    split(b, s, b.leaves[1])
    check_partition(run)
    merge(b, s, b.node_i[b.leaves[1], c.PARENT])
    merge(b, s, root)
    check_partition(run)
    np.testing.assert_allclose(b.node_f[root], before, rtol=1e-9, atol=1e-9)


def test_small_tiles_lie_on_an_edge_and_variation_becomes_even() -> None:
    edge = 41.3
    run = FakeRun((64, 64), lambda x, y, t: np.where(x < edge, 0.1, 0.9), least_tiles=64, least_mean_tile_px=32)
    b = run.sampler.buffers
    start = [variation(b, leaf) * 64 for leaf in b.leaves[: b.number[c.LEAVES]]]
    run.run(4000)
    boxes = tile_rectangles(b)
    area = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    on_edge = (boxes[:, 0] <= edge) & (edge <= boxes[:, 2])
    assert np.median(area[on_edge]) * 4 <= np.median(area[~on_edge])
    assert len(start) == 64
    # hardly any tile that shows the edge is still as large as the even tiling's
    assert (area[on_edge] >= 64).mean() < 0.2


def test_tiles_gather_where_the_picture_moves() -> None:
    def flicker(x, y, t):
        return np.where((x < 16) & (y < 16), 0.5 + 0.45 * np.sin(40 * t), 0.4)

    run = FakeRun((64, 64), flicker, least_mean_tile_px=32)
    run.run(3000)
    boxes = tile_rectangles(run.sampler.buffers)
    inside = (boxes[:, 2] <= 16) & (boxes[:, 3] <= 16)
    assert inside.sum() > 0.4 * len(boxes)  # a sixteenth of the picture


def test_gain_falls_when_all_moves_and_rises_when_all_is_still() -> None:
    still = FakeRun((64, 64), lambda x, y, t: 0.5 + 0.4 * np.sin(x), i=1.0)
    moving = FakeRun((64, 64), lambda x, y, t: 0.5 + 0.4 * np.sin(0.3 * x + 20 * t), i=1.0)
    for run in (still, moving):
        run.run(2000)
    most = still.settings.most_tiles
    assert still.sampler.buffers.number[c.TARGET] == most == 256
    assert moving.sampler.buffers.number[c.TARGET] == moving.settings.least_tiles == 64


def test_wanted_tiles_solve_the_papers_equation() -> None:
    run = FakeRun((128, 128), lambda x, y, t: 0.5 + 0.4 * np.sin(0.5 * x + 0.3 * t), i=3.0)
    run.run(1500)
    b, total = run.sampler.buffers, run.sampler.buffers.total
    over_space = (total[c.GGX] + total[c.GGY]) / 2 / total[c.G]
    over_time = total[c.GGT] / total[c.GTW]
    entries = [b.queue[p, k] for p in range(128 * 128) for k in range(b.fill[p])]
    age_s = run.now_s - b.entry_t[entries].mean()
    wide = 3.0 * over_time * age_s / over_space
    wanted = np.clip(128 * 128 / wide**2, 64, 1024)
    assert wanted_tiles(b, run.settings, run.now_s) == pytest.approx(wanted, abs=1)
    assert 64 < wanted < 1024


def test_an_empty_tile_is_undersampled_only_beyond_m_times_the_mean() -> None:
    settings = sampler_settings((8, 8), AdaptiveFrameless(least_tiles=1, m=2.0), 1.0)
    b = make_buffers(settings, 4)
    b.number[c.ENTRIES] = 192  # a quarter of 256 places empty
    for count, wanted in ((128, 0.0), (64, 0.25), (0, 0.5), (256, 0.0)):
        b.node_f[0, c.COUNT] = count
        assert undersampling(b, settings, 0) == pytest.approx(wanted)


@pytest.mark.parametrize(("area_power", "size"), [(0.0, 1.0), (0.5, 8.0), (1.0, 64.0)])
def test_the_error_is_the_weighted_sum_of_shares(area_power: float, size: float) -> None:
    p = AdaptiveFrameless(least_tiles=1, kappa=0.3, lambda_=0.1, m=2.0, area_power=area_power)
    settings = sampler_settings((8, 8), p, 1.0)
    b = make_buffers(settings, 4)
    b.node_f[0, c.W], b.node_f[0, c.WL], b.node_f[0, c.WLL] = 2.0, 1.0, 1.5  # variance 0.5
    b.node_f[0, c.HIDDEN] = 64  # a quarter of the places
    b.number[c.ENTRIES] = 256
    b.total[c.SUM_V], b.total[c.SUM_U], b.total[c.SUM_O] = 5.0 * size, 2.0 * size, 0.5 * size
    wanted = 0.6 * 0.5 / 5 + 0.3 * 1.0 / 2 + 0.1 * 0.25 / 0.5
    assert tile_error(b, settings, 0) == pytest.approx(wanted, abs=2e-6)
    b.total[c.SUM_V] = b.total[c.SUM_U] = b.total[c.SUM_O] = 0.0
    assert tile_error(b, settings, 0) < 2e-6


def test_tiles_are_shared_out_by_the_amount_of_variation() -> None:
    """Splitting texture never lowers its variance: without its area it takes every tile from a calmer half."""

    def two_textures(x, y, t):
        noise = np.sin(12.9 * np.floor(x) + 78.2 * np.floor(y))
        return 0.5 + np.where(x < 32, 0.45, 0.225) * noise

    share = {}
    for power in (0.0, 1.0):
        run = FakeRun((64, 64), two_textures, least_mean_tile_px=16, area_power=power, i=0.01, kappa=0.0)
        run.run(6000)
        share[power] = (tile_rectangles(run.sampler.buffers)[:, 0] >= 32).mean()
    assert share[0.0] < 0.1
    assert share[1.0] == pytest.approx(1 / 5, abs=0.06)  # a quarter of the variance


def test_a_black_picture_keeps_even_tiles_where_only_variation_counts() -> None:
    run = FakeRun((64, 64), lambda x, y, t: np.zeros_like(x), kappa=0.0)
    run.run(2000)
    boxes = tile_rectangles(run.sampler.buffers)
    area = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    assert area.max() <= 2 * area.min()


def test_a_black_picture_is_sampled_evenly() -> None:
    run = FakeRun((64, 64), lambda x, y, t: np.zeros_like(x))
    run.run(4000)
    begun = np.concatenate(run.rows)[5::6]
    counts = np.histogram2d(begun[:, 0], begun[:, 1], bins=4, range=((0, 64), (0, 64)))[0]
    assert np.abs(counts / counts.mean() - 1).max() < 0.35
    assert np.isfinite(run.sampler.buffers.error).all()
