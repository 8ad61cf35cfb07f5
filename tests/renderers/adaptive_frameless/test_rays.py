"""The frameless kernel: lanes in whatever order, one picture."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from renderers.adaptive_frameless.rays import IN, LUMA, OUT, PACKET, FramelessRays, coherent_order, hilbert_ranks
from renderers.clip_frames import view_at
from renderers.engine import Engine
from stimuli.encode import display_values
from tests.renderers.scenes import SlidingCamera, noise_pixels, quad, scene_of, unlit


def rows_at(count: int, size_px: tuple[int, int] = (256, 256), seed: int = 0) -> np.ndarray:
    rows = np.zeros((count, IN), np.float32)
    rows[:, :2] = np.random.default_rng(seed).uniform(-1.0, np.add(size_px, 1.0), (count, 2))
    return rows


def ordered(rows: np.ndarray) -> np.ndarray:
    order = np.full(len(rows), 1 << 30, np.uint32)
    coherent_order(rows, hilbert_ranks(), order)
    return order


@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 31, 32, 33, 48, 150, 1000, 6666])
def test_every_row_has_one_lane(count: int) -> None:
    np.testing.assert_array_equal(np.sort(ordered(rows_at(count))), np.arange(count))


def test_a_packet_of_lanes_sees_one_part_of_the_picture() -> None:
    rows = rows_at(6666)
    packets = ordered(rows)[: 6666 // PACKET * PACKET].reshape(-1, PACKET)
    # 16 of 6,666 samples fill a square of 12.6 px
    for axis in (0, 1):
        assert np.median(np.ptp(rows[packets, axis], axis=1)) < 20
        assert np.median(np.ptp(rows[np.arange(packets.size).reshape(packets.shape), axis], axis=1)) > 200


@pytest.mark.parametrize("size_px", [(1e-6, 1e-6), (1, 4000), (4000, 1), (1e7, 1e7)])
def test_rows_of_any_extent_are_ordered(size_px: tuple[float, float]) -> None:
    rows = np.zeros((100, IN), np.float32)
    rows[:, :2] = np.random.default_rng(0).uniform(0, size_px, (100, 2)) - np.divide(size_px, 2)
    np.testing.assert_array_equal(np.sort(ordered(rows)), np.arange(100))


def test_neighbouring_packets_are_dealt_out() -> None:
    rows = rows_at(6400)
    rows[:, 1] = np.arange(6400) // 25  # costs that rise down the picture
    packets = ordered(rows).reshape(-1, PACKET)
    means = [float(rows[run, 1].mean()) for run in np.array_split(packets, 8)]
    assert np.ptp(means) < 0.2 * 256


def test_luma_is_of_the_displayed_values() -> None:
    pixels = np.random.default_rng(0).uniform(0, 1, (32, 32, 3)).astype(np.float32)
    engine = Engine(scene_of(quad((-4, -4, -2), (8, 0, 0), (0, 8, 0), unlit(pixels), repeats=1.0)))
    state = engine.state(view_at(0, Fraction(60), Fraction(1), (32, 24), engine.scene.camera, cut=True), (32, 24))
    for exposure in (1e-3, 0.7, 30.0):
        found = FramelessRays(engine).trace(state, rows_at(300, (32, 24)), 7, exposure).astype(np.float64)
        shown = display_values(found[None, :, :3], exposure)[0]
        np.testing.assert_allclose(found[:, LUMA], shown @ [0.299, 0.587, 0.114], atol=1e-6)
    assert found[:, LUMA].max() == pytest.approx(1, abs=1e-6)


def test_the_order_of_lanes_changes_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = quad((-48, -48, -2), (96, 0, 0), (0, 96, 0), unlit(noise_pixels(3, block=2)), repeats=16.0)
    engine = Engine(scene_of(blocks, camera=SlidingCamera((3.0, 1.0, 0.0))))
    view = view_at(1, Fraction(60), Fraction(1), (32, 24), engine.scene.camera)
    rows = rows_at(500, (32, 24))
    rows[:, 2] = -np.linspace(1 / 60, 0, 500)
    rows[::3, 3:8] = 0.1, 0.2, -0.5, -0.01, 1.0
    found = []

    def backwards(rows: np.ndarray, ranks: np.ndarray, order: np.ndarray) -> None:
        order[:] = np.arange(len(rows))[::-1]

    for order in (coherent_order, backwards):
        monkeypatch.setattr("renderers.adaptive_frameless.rays.coherent_order", order)
        found.append(FramelessRays(engine).trace(engine.state(view, (32, 24)), rows, 7).copy())
    assert found[0].shape == (500, OUT)
    assert np.ptp(found[0][:, 0]) > 0.1
    np.testing.assert_array_equal(found[0], found[1])
