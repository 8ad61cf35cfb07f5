"""The Hilbert order: every pixel once, and neighbours stay together."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.foveated.hilbert import hilbert_order
from renderers.pixels import tile_order


@pytest.mark.parametrize("size_px", [(1, 1), (1, 7), (5, 1), (31, 17), (64, 64), (120, 90)])
def test_every_pixel_occurs_once(size_px: tuple[int, int]) -> None:
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
