"""Queues, crosshairs and their gradients."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.budget import SampleClock
from renderers.adaptive_frameless.buffers import make_buffers
from renderers.adaptive_frameless.crosshair import moved_gradients, temporal_gradient
from renderers.adaptive_frameless.deep_buffer import make_room, new_entry, push_back, push_front, put_in_stream
from renderers.adaptive_frameless.technique import sampler_settings
from renderers.parameters import AdaptiveFrameless
from tests.renderers.adaptive_frameless.fake_rays import FakeRun, found_at, still_poses


@pytest.fixture
def empty():
    settings = sampler_settings((4, 4), AdaptiveFrameless(depth=3, least_tiles=1), 1.0)
    return make_buffers(settings, 5), settings


def made(b, time_s: float) -> int:
    entry = new_entry(b)
    b.entry_f[entry] = 0.5
    b.entry_t[entry] = time_s
    return entry


def times(b, pixel: int) -> list[float]:
    return [float(b.entry_t[b.queue[pixel, k]]) for k in range(b.fill[pixel])]


def test_new_crosshairs_enter_in_front_and_push_the_last_out(empty) -> None:
    b, s = empty
    for time_s in (1.0, 2.0, 3.0, 4.0):
        make_room(b, s, 5)
        push_front(b, s, made(b, time_s), 5)
    assert times(b, 5) == [4.0, 3.0, 2.0]
    assert b.number[c.ENTRIES] == 3
    assert b.number[c.FREE] == 16 * 3 - 3


def test_moved_crosshairs_enter_at_the_back_unless_older_than_a_full_queues_last(empty) -> None:
    b, s = empty
    push_front(b, s, made(b, 5.0), 2)
    push_back(b, s, made(b, 1.0), 2)
    push_back(b, s, made(b, 2.0), 2)
    assert times(b, 2) == [5.0, 1.0, 2.0]
    push_back(b, s, made(b, 3.0), 2)
    assert times(b, 2) == [5.0, 1.0, 3.0]
    push_back(b, s, made(b, 0.5), 2)
    assert times(b, 2) == [5.0, 1.0, 3.0]
    assert b.number[c.FREE] == 16 * 3 - 3


def test_the_stream_keeps_the_newest(empty) -> None:
    b, _ = empty
    for k in range(7):
        put_in_stream(b, float(k), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, 0.0)
    assert b.number[c.KEPT] == 5
    oldest = b.number[c.NEXT]
    assert [b.stream_t[(oldest + k) % 5] for k in range(5)] == [2.0, 3.0, 4.0, 5.0, 6.0]


def test_gradients_of_a_moving_ramp_are_its_slopes() -> None:
    a, b_, v = 0.004, -0.003, 0.05

    def ramp(x, y, t):
        return 0.4 + a * x + b_ * y + v * t

    run = FakeRun((32, 32), ramp, temporal_gradient="fixed", reprojected=0)
    run.run(3000)
    b = run.sampler.buffers
    entries = [b.queue[p, k] for p in range(32 * 32) for k in range(b.fill[p]) if b.entry_t[b.queue[p, k]] > 0]
    e = b.entry_f[entries]
    np.testing.assert_allclose(e[:, c.GX], abs(a), atol=2e-6)
    np.testing.assert_allclose(e[:, c.GY], abs(b_), atol=2e-6)
    known = e[:, c.GT] >= 0
    assert known.mean() > 0.6  # a tile drawn twice in a chunk starts afresh
    np.testing.assert_allclose(e[known, c.GT], v, rtol=2e-2)
    assert b.total[c.GGT] / b.total[c.GTW] == pytest.approx(v, rel=2e-3)


def test_moved_gradients_use_the_new_distances(empty) -> None:
    b, _ = empty
    entry = new_entry(b)
    b.entry_f[entry, :5] = 0.5, 0.3, 0.7, 0.4, 0.6
    x, y = np.array([0.0, -2.0, 2.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, -0.5, 0.5])
    moved_gradients(b, entry, x, y)
    assert b.entry_f[entry, c.GX] == pytest.approx(0.1, rel=1e-6)
    assert b.entry_f[entry, c.GY] == pytest.approx(0.2, rel=1e-6)
    # turned by 90 degrees the arms change axes; all in one point stays finite
    moved_gradients(b, entry, y, x)
    assert b.entry_f[entry, c.GX] == pytest.approx(0.2, rel=1e-6)
    moved_gradients(b, entry, np.zeros(5), np.zeros(5))
    assert np.isfinite(b.entry_f[entry, c.GX])


def test_simultaneous_samples_show_no_gradient_over_time() -> None:
    assert temporal_gradient(0.2, 1.0, 0.9, 1.0) == -1.0
    assert temporal_gradient(0.2, 1.5, 0.7, 1.0) == pytest.approx(1.0)


def test_tiles_are_drawn_evenly_and_places_within_them_evenly() -> None:
    run = FakeRun((32, 32), lambda x, y, t: np.where(x < 16, 0.2, 0.5 + 0.4 * np.sin(3 * x)), least_tiles=8,
                  least_mean_tile_px=64, reprojected=0)  # fmt: skip
    run.run(1500)
    b = run.sampler.buffers
    boxes = b.node_i[b.leaves[: b.number[c.LEAVES]], :4].copy()
    run.rows.clear()
    run.run(6000, adjust=False)
    rows = np.concatenate(run.rows)
    begun = rows[5::6]  # the begun crosshairs' places
    counts = np.array([((begun[:, 0] >= x0) & (begun[:, 0] < x1) & (begun[:, 1] >= y0) & (begun[:, 1] < y1)).sum()
                       for x0, y0, x1, y1 in boxes])  # fmt: skip
    wanted = len(begun) / len(boxes)
    # chi-squared with tiles - 1 degrees of freedom: mean n - 1, deviation sqrt(2 (n - 1))
    chi2 = float(((counts - wanted) ** 2 / wanted).sum())
    assert abs(chi2 - (len(boxes) - 1)) < 4 * np.sqrt(2 * (len(boxes) - 1))
    area = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    assert area.max() >= 4 * area.min()  # so density really is as 1 / area


def test_a_visit_takes_five_samples_around_the_earlier_place_and_begins_another() -> None:
    run = FakeRun(
        (32, 32), lambda x, y, t: 0.5 + 0 * x, temporal_gradient="fixed", least_tiles=4, least_mean_tile_px=256
    )
    run.run(500, adjust=False)
    rows = np.concatenate(run.rows).reshape(-1, 6, 8)
    offsets = rows[:, 1:5, :2] - rows[:, :1, :2]
    np.testing.assert_allclose(offsets, np.tile([[-1, 0], [1, 0], [0, -1], [0, 1]], (500, 1, 1)), atol=1e-5)
    begun = {tuple(place) for place in rows[:-50, 5, :2].tolist()}
    used = [tuple(place) in begun for place in rows[25:, 0, :2].tolist()]
    assert np.mean(used) == pytest.approx(4 / 25, abs=0.03)  # once a tile and chunk: there are 4 tiles
    assert len(set(rows[:25, 0, 2].tolist())) == 25  # every visit has its own time


def test_hidden_crosshairs_are_made_anew_at_their_place_and_counted() -> None:
    run = FakeRun((16, 16), lambda x, y, t: 0.5 + 0 * x, least_tiles=1, least_mean_tile_px=256)
    s, b = run.settings, run.sampler.buffers
    poses = still_poses(run.size_px, 0.1)
    chunk = run.sampler.plan(poses, np.array([-0.01, 0.0]))
    hidden = np.arange(len(chunk.rows)) < 3
    places = {tuple(np.round(b.entry_f[chunk.job_i.ravel()[k] % (1 << 30), 5:7], 4)) for k in range(3)}
    asked = run.sampler.take_in(poses, chunk, found_at(chunk.rows, poses, run.shown, hidden))
    assert asked == (chunk.job_i >= 0).sum()
    assert b.number[c.WAITING] == 3
    chunk = run.sampler.plan(still_poses(run.size_px, 0.2), np.linspace(-0.05, 0, 8))
    anew = {tuple(np.round(place, 4)) for place in chunk.job_f[:3, :2].astype(np.float32)}
    assert anew == places
    run.sampler.take_in(poses, chunk, found_at(chunk.rows, poses, run.shown))
    assert b.node_f[b.leaves[0], c.HIDDEN] == 3
    assert s.lam > 0


def test_crosshairs_follow_the_camera_and_leave_at_the_edge() -> None:
    run = FakeRun((16, 16), lambda x, y, t: 0.5 + 0 * x, least_tiles=1, least_mean_tile_px=256)
    b = run.sampler.buffers
    poses = still_poses(run.size_px, 0.1, shift_px=4.0)
    times_s = np.zeros(40)
    chunk = run.sampler.plan(poses, times_s)
    chosen = [k for k in chunk.job_i.ravel() if k >= 0]
    before = {k % (1 << 30): b.entry_f[k % (1 << 30), 5:7].copy() for k in chosen}
    run.sampler.take_in(poses, chunk, found_at(chunk.rows, poses, run.shown))
    moved = gone = 0
    for k, (x, y) in before.items():
        if x + 4 >= 16:
            gone += 1
            continue
        if b.entry_i[k, c.PIXEL] >= 0 and b.entry_t[k] == 0.0:
            np.testing.assert_allclose(b.entry_f[k, 5:7], (x + 4, y), atol=1e-4)
            assert b.entry_i[k, c.PIXEL] == int(y) * 16 + int(x + 4)
            moved += 1
    assert moved > 40
    assert gone > 5


@pytest.mark.parametrize("rate", [0.25, 7.0, 66_666.6667])
def test_the_clock_loses_no_visit_and_keeps_times_in_their_interval(rate: float) -> None:
    clock, interval, seen = SampleClock(rate), Fraction(1, 60), []
    for k in range(240):
        times_s = clock.take(interval)
        assert (times_s <= 0).all()
        assert (times_s >= -float(interval) - 1e-12).all()
        seen.append(times_s + (k + 1) / 60)
    seen = np.concatenate(seen)
    assert len(seen) == int(Fraction(rate) * 4)
    np.testing.assert_allclose(np.diff(seen), 1 / rate, atol=1e-9)
