"""The order in which sparse pixels are traced: along a Hilbert curve, whose steps never leap as a Z curve's do.

A packet's 16 rays are then nearer to one another where most pixels are missing: at 1182x1464, medium, tracing took 24.5
ms in the order of `renderers.pixels.tile_order` and 22.6 in this one (tunnel_geom, point light), 97.9 and 91.8 (area
light), 49.0 and 45.4 (voxel_city, area light).
"""

from __future__ import annotations

import numpy as np


def hilbert_order(width_px: int, height_px: int) -> np.ndarray:
    """(W*H,) uint32 scanline indices ``y * W + x`` along a Hilbert curve; every pixel occurs once.

    The curve is that of the smallest square of a power of two that holds the picture, what is outside of it left out.
    """
    bits = (max(width_px, height_px) - 1).bit_length()
    y, x = (axis.ravel() for axis in np.indices((height_px, width_px), np.int32))
    along = np.zeros(x.size, np.int64)
    for bit in reversed(range(bits)):
        right, down = (x >> bit) & 1, (y >> bit) & 1
        along = (along << 2) | ((3 * right) ^ down)
        # Into the quadrant's own frame: mirrored in the upper right one, transposed in both upper ones.
        mask = (1 << bit) - 1
        mirror = -(right & (1 - down)) & mask
        x, y = (x & mask) ^ mirror, (y & mask) ^ mirror
        x, y = np.where(down, x, y), np.where(down, y, x)
    return np.argsort(along, kind="stable").astype(np.uint32)
