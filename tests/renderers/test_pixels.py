"""Orders hold every pixel once, along a Z curve or a Hilbert curve."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.pixels import hilbert_order, inverse_order, pixel_centres, tile_order


@pytest.mark.parametrize("size", [(1, 1), (8, 8), (9, 7), (64, 16), (31, 17)])
def test_every_pixel_once_and_the_inverse_undoes_it(size: tuple[int, int]) -> None:
    order = tile_order(*size)
    np.testing.assert_array_equal(np.sort(order), np.arange(size[0] * size[1]))
    np.testing.assert_array_equal(order[inverse_order(order)], np.arange(order.size))


def test_the_first_64_lanes_are_the_first_tile() -> None:
    order = tile_order(20, 20)[:64]
    assert (order % 20).max() == 7
    assert (order // 20).max() == 7


def test_packets_are_blocks() -> None:
    """Eight lanes are 4x2 pixels, sixteen 4x4: what one packet of rays covers."""
    order = tile_order(64, 32)
    np.testing.assert_array_equal(order[:4], [0, 1, 64, 65])
    for lanes, extent in ((8, (4, 2)), (16, (4, 4)), (64, (8, 8)), (256, (16, 16))):
        packets = order.reshape(-1, lanes)
        for values, most in ((packets % 64, extent[0]), (packets // 64, extent[1])):
            np.testing.assert_array_equal(np.ptp(values.astype(int), axis=1), most - 1)


def test_centres_are_at_a_half() -> None:
    x, y = pixel_centres(np.array([0, 19, 20]), 20)
    np.testing.assert_array_equal(x, [0.5, 19.5, 0.5])
    np.testing.assert_array_equal(y, [0.5, 0.5, 1.5])


@pytest.mark.parametrize("size_px", [(1, 1), (1, 7), (5, 1), (31, 17), (64, 64), (120, 90)])
def test_along_a_hilbert_curve_every_pixel_occurs_once(size_px: tuple[int, int]) -> None:
    order = hilbert_order(*size_px)
    assert order.dtype == np.uint32
    np.testing.assert_array_equal(np.sort(order), np.arange(size_px[0] * size_px[1]))


@pytest.mark.parametrize("side", [2, 16, 64])
def test_in_a_square_of_a_power_of_two_each_step_goes_to_a_neighbour(side: int) -> None:
    y, x = np.divmod(hilbert_order(side, side).astype(int), side)
    np.testing.assert_array_equal(np.abs(np.diff(x)) + np.abs(np.diff(y)), 1)


def test_packets_of_sparse_pixels_are_more_compact_than_along_a_z_curve() -> None:
    """Mean extent of 16 pixels that follow one another, a twentieth of all."""
    width, height = 300, 200
    chosen = np.random.default_rng(1).random(width * height) < 0.05
    extents = []
    for order in (hilbert_order(width, height), tile_order(width, height)):
        lanes = order[chosen[order]].astype(int)
        y, x = np.divmod(lanes[: len(lanes) // 16 * 16].reshape(-1, 16), width)
        extents.append(np.mean(np.ptp(x, axis=1) + np.ptp(y, axis=1)))
    assert extents[0] < 0.85 * extents[1]
