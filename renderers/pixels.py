"""The order in which pixels are traced: 8x8 tiles, so that neighbouring lanes are neighbouring rays."""

from __future__ import annotations

import numpy as np

TILE_PX = 8


def tile_order(width_px: int, height_px: int) -> np.ndarray:
    """(W*H,) uint32 scanline indices ``y * W + x`` in the order of 8x8 tiles (tiles and their pixels row by row).

    Tiles at the right and lower edge are cut; every pixel occurs exactly once.
    """
    x, y = np.meshgrid(np.arange(width_px, dtype=np.int64), np.arange(height_px, dtype=np.int64))
    tile = (y // TILE_PX) * (-(-width_px // TILE_PX)) + x // TILE_PX
    within = (y % TILE_PX) * TILE_PX + x % TILE_PX
    return np.argsort((tile * TILE_PX * TILE_PX + within).ravel(), kind="stable").astype(np.uint32)


def inverse_order(order: np.ndarray) -> np.ndarray:
    """(N,) uint32: where each scanline index stands in ``order`` (``order[inverse[i]] == i``)."""
    inverse = np.empty_like(order)
    inverse[order] = np.arange(order.size, dtype=order.dtype)
    return inverse


def pixel_centres(indices: np.ndarray, width_px: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y (float32) of the centres of the pixels with these scanline indices; the first pixel's is (0.5, 0.5)."""
    return (indices % width_px + 0.5).astype(np.float32), (indices // width_px + 0.5).astype(np.float32)
