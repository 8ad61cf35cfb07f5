"""The reconstructor: the newest samples, moved to where they are seen now, splatted with space-time Gaussians.

Dayal et al. 2005, sections 5 and 6.2. Each pixel's filter is sized by its tile's gradients and density; the size of the
splats follows the coverage of the picture before. Bands of rows run side by side; each pixel adds its samples in the
order of the stream, so that the picture does not depend on how many threads there are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import get_num_threads, njit, prange

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers
from renderers.adaptive_frameless.crosshair import moved, projected
from renderers.adaptive_frameless.tiling import tile_area

EXPONENT = 4.5
"""exp(-4.5 q): three standard deviations at the extent, where q = 1."""
MOST_SIZE_PX = 32.0
FEW, MANY, GROW, SHRINK = 4, 32, 4.0, 0.7
"""Section 6.2: pixels that fewer (more) samples reach ask for larger (smaller) splats."""


class Filter(NamedTuple):
    """How filters are sized; see `renderers.parameters.AdaptiveFrameless`."""

    samples_per_s: float
    volume: float
    least_spatial: float
    least_temporal: float
    most_extent_s: float
    refresh_s: float
    tail: float
    depth_tolerance: float
    reproject: bool


@njit(cache=True)
def extents(
    gx: float, gy: float, gt: float, volume: float, most_px: float, least_s: float, most_s: float
) -> tuple[float, float, float]:
    """e_x, e_y (px), e_t (s) that span equal colour changes and the volume e_x e_y e_t = V (section 5.1).

    e_t is held within [least_s, most_s] first, and e_x, e_y then share what volume is left; they stay within
    [1, most_px]. Gradients must be above 0.
    """
    et = (volume * gx * gy / (gt * gt)) ** (1.0 / 3.0)
    et = min(max(et, least_s), most_s)
    area = volume / et
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
            f.refresh_s, f.most_extent_s,
        )  # fmt: skip
        for y in range(n[c.Y0], n[c.Y1]):
            for x in range(n[c.X0], n[c.X1]):
                o = out[y * width + x]
                o[0], o[1], o[2] = 1.0 / (ex * ex), 1.0 / (ey * ey), 1.0 / (et * et)


@njit(cache=True, parallel=True)
def place_samples(
    b: Buffers, width: int, height: int, camera: np.ndarray, movers: np.ndarray, window: np.ndarray, lens: np.ndarray,
    now_s: float, f: Filter, sizes: np.ndarray, placed: np.ndarray,
) -> None:  # fmt: skip
    """Where the stream's samples are now: ``placed`` (N, 5) float32 gets x, y, age (s), half splat size, depth.

    ``camera`` (3, 4), ``movers`` (M + 1, 3, 4), ``window`` (M + 1, 2) at t1. Age -1: not in the picture.
    ``sizes`` (W * H,): the splat size that each pixel asks for. Rows are in order of time, the oldest first.
    """
    kept, room = b.number[c.KEPT], len(b.stream_t)
    oldest = (b.number[c.NEXT] - kept) % room
    for i in prange(kept):
        k = (oldest + i) % room
        v, mover, out = b.stream_f[k], b.stream_i[k], placed[i]
        out[2] = -1.0
        x, y, z = float(v[3]), float(v[4]), float(v[5])
        if mover > 0:
            if not window[mover, 0] <= 0 <= window[mover, 1]:
                continue
            x, y, z = moved(movers[mover], x, y, z)
        px, py, depth = projected(camera, lens, x, y, z)
        if not f.reproject:
            px, py = float(v[6]), float(v[7])
        if depth <= 0 or not (-1 <= px < width + 1 and -1 <= py < height + 1):
            continue
        column, row = min(max(int(px), 0), width - 1), min(max(int(py), 0), height - 1)
        out[0], out[1], out[2] = px, py, max(now_s - b.stream_t[k], 0.0)
        out[3] = 0.5 * sizes[row * width + column]
        out[4] = depth


@njit(cache=True)
def nearest_depths(width: int, height: int, placed: np.ndarray, nearest: np.ndarray, age_s: np.ndarray) -> None:
    """Each pixel's least depth among the samples that fall into it, and how old that sample is; inf where none does."""
    nearest[:] = np.inf
    for i in range(len(placed)):
        out = placed[i]
        if out[2] < 0:
            continue
        x, y = math.floor(out[0]), math.floor(out[1])
        if 0 <= x < width and 0 <= y < height:
            pixel = y * width + x
            if out[4] < nearest[pixel]:
                nearest[pixel] = out[4]
                age_s[pixel] = out[2]


@njit(cache=True, parallel=True)
def splat(
    b: Buffers, width: int, height: int, placed: np.ndarray, filters: np.ndarray, nearest: np.ndarray,
    nearest_age: np.ndarray, f: Filter, bands: int, sums: np.ndarray, coverage: np.ndarray,
) -> None:  # fmt: skip
    """Add every sample to the pixels its splat covers: ``sums`` (W * H, 4) colour and weight, ``coverage`` (W * H, 2)
    number of samples and sum of their sizes.

    A weight is exp(-4.5 q) with q = (dx/e_x)^2 + (dy/e_y)^2 + (age/e_t)^2 of the *pixel's* filter, and a little more
    that falls slowly (``tail``), so that a pixel out of reach of all shows the nearest instead of nothing.
    """
    kept, room = b.number[c.KEPT], len(b.stream_t)
    oldest = (b.number[c.NEXT] - kept) % room
    for band in prange(bands):
        top, bottom = height * band // bands, height * (band + 1) // bands
        sums[top * width : bottom * width] = 0.0
        coverage[top * width : bottom * width] = 0.0
        for i in range(kept):
            px, py, age, half, depth = placed[i, 0], placed[i, 1], placed[i, 2], placed[i, 3], placed[i, 4]
            if age < 0 or py + half < top or py - half > bottom:
                continue
            v = b.stream_f[(oldest + i) % room]
            # pixels whose centres lie under the splat
            x0, x1 = max(math.ceil(px - half - 0.5), 0), min(math.floor(px + half - 0.5), width - 1)
            y0, y1 = max(math.ceil(py - half - 0.5), top), min(math.floor(py + half - 0.5), bottom - 1)
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    pixel = y * width + x
                    if depth > nearest[pixel] * f.depth_tolerance and age > nearest_age[pixel]:
                        continue
                    dx, dy = x + 0.5 - px, y + 0.5 - py
                    q = dx * dx * filters[pixel, 0] + dy * dy * filters[pixel, 1] + age * age * filters[pixel, 2]
                    weight = f.tail / ((1.0 + q) * (1.0 + q))
                    if q < 4.0:
                        weight += math.exp(-EXPONENT * q)
                    a = sums[pixel]
                    a[0] += weight * v[0]
                    a[1] += weight * v[1]
                    a[2] += weight * v[2]
                    a[3] += weight
                    coverage[pixel, 0] += 1.0
                    coverage[pixel, 1] += 2.0 * half


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
    """Pictures from the stream. It remembers the last picture and its coverage."""

    def __init__(self, size_px: tuple[int, int], kept: int, least_size_px: float) -> None:
        self.size_px, self.least_size_px = size_px, least_size_px
        pixels = size_px[0] * size_px[1]
        self.picture = np.zeros((pixels, 3), np.float32)
        self.filters = np.ones((pixels, 3), np.float32)
        self.sizes = np.full(pixels, 2.0, np.float32)
        self.sums = np.zeros((pixels, 4))
        self.coverage = np.zeros((pixels, 2), np.float32)
        self.nearest = np.full(pixels, np.inf, np.float32)
        self.nearest_age = np.zeros(pixels, np.float32)
        self.placed = np.full((kept, 5), -1.0, np.float32)

    def reconstruct(
        self, b: Buffers, f: Filter, camera: np.ndarray, movers: np.ndarray, window: np.ndarray, lens: np.ndarray,
        now_s: float,
    ) -> np.ndarray:  # fmt: skip
        """The picture (H, W, 3) float32, linear, as the camera (3, 4) and movers (M + 1, 3, 4) at t1 see it."""
        width, height = self.size_px
        placed = self.placed[: b.number[c.KEPT]]
        filter_map(b, width, f, self.filters)
        place_samples(b, width, height, camera, movers, window, lens, now_s, f, self.sizes, placed)
        if f.depth_tolerance > 0:
            nearest_depths(width, height, placed, self.nearest, self.nearest_age)
        bands = max(1, min(height, get_num_threads()))
        splat(
            b, width, height, placed, self.filters, self.nearest, self.nearest_age, f, bands, self.sums, self.coverage
        )
        finish(self.sums, self.coverage, self.least_size_px, self.picture, self.sizes)
        return self.picture.reshape(height, width, 3)
