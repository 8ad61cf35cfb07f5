"""The reconstructor: the newest samples, moved to where they are seen now, splatted with space-time Gaussians.

Dayal et al. 2005, sections 5 and 6.2. Each pixel's filter is sized by its tile's gradients and density; the size of the
splats follows the coverage of the picture before.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers
from renderers.adaptive_frameless.splats import EXPONENT, Filter, Scenery, Splats
from renderers.adaptive_frameless.tiling import tile_area

MOST_SIZE_PX = 32.0
FEW, MANY, GROW, SHRINK = 4, 32, 4.0, 0.7
"""Section 6.2: pixels that fewer (more) samples reach ask for larger (smaller) splats."""


@njit(cache=True)
def extents(
    gx: float,
    gy: float,
    gt: float,
    volume: float,
    most_px: float,
    least_s: float,
    most_s: float,
    fill_s: float = 0.0,
    fill_age_s: float = math.inf,
) -> tuple[float, float, float]:
    """e_x, e_y (px), e_t (s) that span equal colour changes and the volume e_x e_y e_t = V (section 5.1).

    e_t is held within [least_s, most_s] first, and e_x, e_y then share what volume is left; they stay within
    [1, most_px]. Gradients must be above 0. ``fill_s``: the seconds of sampling that the first fill is worth; it
    counts by the weight that its age has.
    """
    et = (volume * gx * gy / (gt * gt)) ** (1.0 / 3.0)
    et = min(max(et, least_s), most_s)
    area = volume / (et + fill_s * math.exp(-EXPONENT * (fill_age_s / et) ** 2))
    ex = min(max(math.sqrt(area * gy / gx), 1.0), most_px)
    ey = min(max(math.sqrt(area * gx / gy), 1.0), most_px)
    return ex, ey, et


@njit(cache=True)
def filter_map(b: Buffers, width: int, f: Filter, out: np.ndarray) -> None:
    """Write every pixel's (1 / e_x^2, 1 / e_y^2, 1 / e_t^2) to ``out`` (W * H, 3) from its tile."""
    tiles = b.number[c.LEAVES]
    for k in range(tiles):
        node = b.leaves[k]
        n, sums = b.node_i[node], b.node_f[node]
        gx = sums[c.GGX] / sums[c.G] if sums[c.G] > 0 else 0.0
        gy = sums[c.GGY] / sums[c.G] if sums[c.G] > 0 else 0.0
        gt = sums[c.GGT] / sums[c.GTW] if sums[c.GTW] > 0 else 0.0
        # tiles are drawn evenly, so a tile of s pixels has R / (tiles * s) samples a pixel and second
        volume = f.volume * tiles * tile_area(b, node) / f.samples_per_s
        widest = float(max(n[c.X1] - n[c.X0], n[c.Y1] - n[c.Y0], 1))
        ex, ey, et = extents(
            max(gx, f.least_spatial), max(gy, f.least_spatial), max(gt, f.least_temporal), volume, widest,
            f.refresh_s, f.most_extent_s, volume / f.volume, f.fill_age_s,
        )  # fmt: skip
        for y in range(n[c.Y0], n[c.Y1]):
            for x in range(n[c.X0], n[c.X1]):
                o = out[y * width + x]
                o[0], o[1], o[2] = 1.0 / (ex * ex), 1.0 / (ey * ey), 1.0 / (et * et)


@njit(cache=True, parallel=True)
def finish(sums: np.ndarray, coverage: np.ndarray, least_size: float, picture: np.ndarray, sizes: np.ndarray) -> None:
    """The weighted mean at each pixel (what it showed before where no sample reached it), and its next splat size."""
    for pixel in prange(len(sums)):
        a = sums[pixel]
        if a[3] > 0:
            for k in range(3):
                picture[pixel, k] = a[k] / a[3]
        reached = coverage[pixel, 0]
        size = coverage[pixel, 1] / reached if reached > 0 else float(sizes[pixel])
        if reached < FEW:
            size *= GROW
        elif reached > MANY:
            size *= SHRINK
        sizes[pixel] = min(max(size, least_size), MOST_SIZE_PX)


class Reconstructor:
    """Pictures from the stream, drawn by ``splats``. It remembers the last picture and its coverage."""

    def __init__(self, size_px: tuple[int, int], splats: Splats, least_size_px: float) -> None:
        self.size_px, self.splats, self.least_size_px = size_px, splats, least_size_px
        pixels = size_px[0] * size_px[1]
        self.picture = np.zeros((pixels, 3), np.float32)
        self.filters = np.ones((pixels, 3), np.float32)
        self.sizes = np.full(pixels, 2.0, np.float32)
        self.coverage = np.zeros((pixels, 2), np.float32)

    def reconstruct(self, b: Buffers, scenery: Scenery, f: Filter) -> np.ndarray:
        """The picture (H, W, 3) float32, linear, as ``scenery`` has camera and movers; valid until the next call."""
        width, height = self.size_px
        filter_map(b, width, f, self.filters)
        sums, self.coverage = self.splats.draw(b, scenery, f, self.filters, self.sizes)
        finish(sums, self.coverage, self.least_size_px, self.picture, self.sizes)
        return self.picture.reshape(height, width, 3)
