"""Splats: the newest samples where they are seen now, each added to the pixels that it covers (Dayal et al. 2005, 5.2).

`Splats` is the one seam: `NumbaSplats` in row bands on CPUs, `gl_splats.GlSplats` by moderngl. Each pixel adds its
samples in the order of the stream, so that the bands' picture does not depend on how many threads there are.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numba import get_num_threads, njit, prange

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers
from renderers.adaptive_frameless.crosshair import moved, projected

SAME_PLACE_PX = 0.5
"""A sample that has moved less than this since it was made is where it was."""
EXPONENT = 4.5
"""exp(-4.5 q): three standard deviations at the extent, where q = 1."""


class Filter(NamedTuple):
    """How filters are sized; see `renderers.parameters.AdaptiveFrameless`. ``fill_age_s``: of the first fill's samples,
    infinite when the stream has begun to lose them."""

    samples_per_s: float
    volume: float
    least_spatial: float
    least_temporal: float
    most_extent_s: float
    refresh_s: float
    tail: float
    depth_tolerance: float
    reproject: bool
    fill_age_s: float = math.inf


class Scenery(NamedTuple):
    """Where everything is at t1 (tracer space): ``camera`` (3, 4), ``movers`` (M + 1, 3, 4), ``window`` (M + 1, 2):
    seconds after t1 in which each exists, ``lens`` as in `rays.HostPoses`, ``now_s`` scene seconds."""

    camera: np.ndarray
    movers: np.ndarray
    window: np.ndarray
    lens: np.ndarray
    now_s: float


class Splats(Protocol):
    """Adds the samples up. `close` frees what it holds."""

    name: str

    def draw(
        self, b: Buffers, scenery: Scenery, f: Filter, filters: np.ndarray, sizes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(``sums`` (W * H, 4): weighted colour and weight, ``coverage`` (W * H, 2): number of samples and sum of
        their sizes), valid until the next call. ``filters`` (W * H, 3), ``sizes`` (W * H,): see `reconstructor`."""
        ...

    def close(self) -> None:
        """Free what is held outside Python."""
        ...


@njit(cache=True, parallel=True)
def place_samples(
    b: Buffers, width: int, height: int, camera: np.ndarray, movers: np.ndarray, window: np.ndarray, lens: np.ndarray,
    now_s: float, f: Filter, sizes: np.ndarray, placed: np.ndarray,
) -> None:  # fmt: skip
    """Where the stream's samples are now: ``placed`` (N, 6) float32 gets x, y, age (s), half splat size, depth, and how
    far it has moved in the picture since it was made (px; -1 minus that for a mover's).

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
        far = abs(px - v[6]) + abs(py - v[7])
        if depth <= 0 or not (-1 <= px < width + 1 and -1 <= py < height + 1):
            continue
        column, row = min(max(int(px), 0), width - 1), min(max(int(py), 0), height - 1)
        out[0], out[1], out[2] = px, py, max(now_s - b.stream_t[k], 0.0)
        out[3] = 0.5 * sizes[row * width + column]
        out[4] = depth
        out[5] = -1.0 - far if mover > 0 else far


@njit(cache=True)
def nearest_samples(width: int, height: int, placed: np.ndarray, nearest: np.ndarray) -> None:
    """``nearest`` (W * H, 3): the least depth among the samples that fall into a pixel (inf where none does), how old
    the newest of that depth is, and whether one of that depth is a mover's (1 or 0)."""
    nearest[:, 0], nearest[:, 1], nearest[:, 2] = np.inf, np.inf, 0.0
    for i in range(len(placed)):
        out = placed[i]
        if out[2] < 0:
            continue
        x, y = math.floor(out[0]), math.floor(out[1])
        if 0 <= x < width and 0 <= y < height:
            least = nearest[y * width + x]
            if out[4] < least[0]:
                least[0], least[1], least[2] = out[4], out[2], 0.0
            if out[4] == least[0]:
                least[1] = min(least[1], out[2])
                if out[5] < 0:
                    least[2] = 1.0


@njit(cache=True, parallel=True)
def splat(
    b: Buffers, width: int, height: int, placed: np.ndarray, filters: np.ndarray, nearest: np.ndarray, f: Filter,
    bands: int, sums: np.ndarray, coverage: np.ndarray,
) -> None:  # fmt: skip
    """Add every sample to the pixels its splat covers: ``sums`` (W * H, 4) colour and weight, ``coverage`` (W * H, 2)
    number of samples and sum of their sizes.

    An older sample behind a newer one is left out (`Filter.depth_tolerance`), unless neither can have moved against the
    other: it is where it was made, and the nearer one is no mover's. A weight is exp(-4.5 q) with q = (dx/e_x)^2 +
    (dy/e_y)^2 + (age/e_t)^2 of the *pixel's* filter, and a little more that falls slowly (``tail``), so that a pixel
    out of reach of all shows the nearest instead of nothing.
    """
    kept, room = b.number[c.KEPT], len(b.stream_t)
    oldest = (b.number[c.NEXT] - kept) % room
    for band in prange(bands):
        top, bottom = height * band // bands, height * (band + 1) // bands
        sums[top * width : bottom * width] = 0.0
        coverage[top * width : bottom * width] = 0.0
        for i in range(kept):
            px, py, age, half, depth = placed[i, 0], placed[i, 1], placed[i, 2], placed[i, 3], placed[i, 4]
            far = placed[i, 5] if placed[i, 5] >= 0 else -1.0 - placed[i, 5]
            if age < 0 or py + half < top or py - half > bottom:
                continue
            v = b.stream_f[(oldest + i) % room]
            # pixels whose centres lie under the splat
            x0, x1 = max(math.ceil(px - half - 0.5), 0), min(math.floor(px + half - 0.5), width - 1)
            y0, y1 = max(math.ceil(py - half - 0.5), top), min(math.floor(py + half - 0.5), bottom - 1)
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    pixel = y * width + x
                    least = nearest[pixel]
                    hides = depth > least[0] * f.depth_tolerance and age > least[1]
                    if hides and (far > SAME_PLACE_PX or least[2] > 0):
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


class NumbaSplats:
    """On the CPU, a band of rows a thread."""

    name = "numba"

    def __init__(self, size_px: tuple[int, int], kept: int) -> None:
        self.size_px = size_px
        pixels = size_px[0] * size_px[1]
        self._sums = np.zeros((pixels, 4))
        self._coverage = np.zeros((pixels, 2), np.float32)
        self._nearest = np.full((pixels, 3), np.inf, np.float32)
        self._placed = np.full((kept, 6), -1.0, np.float32)

    def draw(
        self, b: Buffers, scenery: Scenery, f: Filter, filters: np.ndarray, sizes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `Splats`."""
        width, height = self.size_px
        placed = self._placed[: b.number[c.KEPT]]
        place_samples(b, width, height, *scenery, f, sizes, placed)
        if f.depth_tolerance < np.inf:
            nearest_samples(width, height, placed, self._nearest)
        bands = max(1, min(height, get_num_threads()))
        splat(b, width, height, placed, filters, self._nearest, f, bands, self._sums, self._coverage)
        return self._sums, self._coverage

    def close(self) -> None:
        """Nothing is held."""


Choice = Literal["auto", "numba", "moderngl"]


def make_splats(choice: Choice, on_gpu: bool, size_px: tuple[int, int], kept: int) -> Splats:
    """``choice`` 'auto' is moderngl where rays are traced on a GPU (``on_gpu``), else numba.

    Raises InputError where moderngl is chosen and there is no OpenGL without a window.
    """
    if choice == "numba" or (choice == "auto" and not on_gpu):
        return NumbaSplats(size_px, kept)
    from renderers.adaptive_frameless.gl_splats import GlSplats

    return GlSplats(size_px, kept)
