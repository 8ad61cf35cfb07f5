"""What the rasterised depth mesh tells (Weier et al. 2016, 3.2 and 3.3): places, depth, marks for resampling.

Pictures are flat `mi.Float`, H * W * 4 (see `renderers.image`). ``place`` (H * W * 2) says where each pixel was in the
last picture, in pixels (nan: nowhere), ``depth`` (H * W) is window depth; both come from the rasterised depth mesh.
"""

from __future__ import annotations

import math
from typing import Any

from renderers.backend import dr, mi
from renderers.foveated.support import FAR, SupportGrid
from renderers.gl.context import NEAR
from renderers.image import display_encoded, fetch, rgb
from renderers.parameters import Foveated

JUMP_PX = 4.0
"""Neighbours that were further apart than this lie on different surfaces."""
BACKGROUND = 0.1 * FAR
"""Tracer units: everything further away counts as background."""


def next_bits(bits: Any) -> Any:
    """32 random bits from 32 others: one round of a multiply-xorshift hash, a third of the work of `rng.mixed`."""
    bits = (bits ^ (bits >> 15)) * mi.UInt32(0x2C1B3C6D)
    return bits ^ (bits >> 13)


DEVIATION = math.sqrt(4 * (256**2 - 1) / 12)
"""The standard deviation of what `normal_taps` returns."""


def normal_taps(bits: Any) -> tuple[Any, Any]:
    """Two taps (Vector2f each) of four nearly normal deviates from 32 random bits: sums of four bytes (Irwin, Hall).

    Mean 0, variance `DEVIATION` squared, none beyond 3.5 of them; no two correlate: the bytes' signs are the rows of a
    Hadamard matrix. A table of exact ones (128 KB, fetched at random) made a frame's `compose` take 1.7 times as long,
    four bytes of their own for each deviate 1.2 times.
    """
    even, odd = bits & 0x00FF00FF, (bits >> 8) & 0x00FF00FF
    sums, differences = even + odd, even + (0x01000100 - odd)
    (a, b), (c, d) = ((mi.Float(both & 0xFFFF), mi.Float(both >> 16)) for both in (sums, differences))
    return mi.Vector2f(a + b - 510, c + d - 512), mi.Vector2f(a - b, c - d)


def world_depth(window_depth: Any, to_world: Any) -> Any:
    """Distance along the camera's axis in world units from window depth (1: nothing there)."""
    return NEAR * to_world / dr.maximum(1 - window_depth, 1e-8)


def was_seen(place: Any, width: int, height: int) -> Any:
    """Whether a place (Vector2f) lies in the last picture; nan does not."""
    return (place.x >= 0) & (place.x < width) & (place.y >= 0) & (place.y < height)


def pixel_at(place: Any, width: int, height: int) -> Any:
    """The number of the pixel in which a place (Vector2f, inside or not) lies."""
    x = mi.UInt32(dr.clip(place.x, 0, width - 1))
    return mi.UInt32(dr.clip(place.y, 0, height - 1)) * width + x


def display_luma(color: Any, exposure: Any) -> Any:
    """Rec.709 luma of a linear colour as the display shows it: sRGB-encoded, in [0, 1]."""
    c = display_encoded(color, exposure)
    return 0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z


def look(
    grid: SupportGrid, place: Any, depth: Any, shown: Any, edge: Any, mover: Any, to_world: Any, exposure: Any,
    texel_pixel: Any,
) -> Any:  # fmt: skip
    """The reprojected picture at support resolution: (world depth, luma, edge, 1 where there is something), packed.

    Luma is that of the texel's mean colour as it is displayed, the coarse picture's filter: 3x3 taps of the last
    picture around its place there. Background is as far as `BACKGROUND`, where window depth still resolves 1 %.
    ``mover`` of each vertex (None: nothing moves): the mesh between vertices of different bodies is no surface,
    whatever their depths: edge is -1.
    """
    here = dr.gather(mi.Vector2f, place, texel_pixel)
    seen = was_seen(here, grid.width, grid.height)
    z = dr.minimum(world_depth(dr.gather(mi.Float, depth, texel_pixel), to_world), BACKGROUND * to_world)
    x, y = (mi.Int32(dr.clip(v, 0, 1e6)) for v in (here.x, here.y))  # clipped: nan is no integer
    total, white = mi.Color3f(0), 1 / exposure
    for oy in (-1, 0, 1):
        row = dr.clip(y + round(oy * grid.height / grid.rows / 3), 0, grid.height - 1) * grid.width
        for ox in (-1, 0, 1):
            column = dr.clip(x + round(ox * grid.width / grid.columns / 3), 0, grid.width - 1)
            total += dr.minimum(rgb(fetch(shown, mi.UInt32(row + column), seen)), white)
    luma = display_luma(total * (1 / 9), exposure)
    column = mi.UInt32(dr.clip(here.x * (grid.columns / grid.width), 0, grid.columns - 1))
    row = mi.UInt32(dr.clip(here.y * (grid.rows / grid.height), 0, grid.rows - 1))
    across = grid.columns + 2
    vertex = (row + 1) * across + column + 1
    facing = dr.gather(mi.Float, edge, vertex, seen)
    if mover is not None:
        own = dr.gather(mi.UInt32, mover, vertex, seen)
        for near in (vertex - 1, vertex + 1, vertex - across, vertex + across):
            facing = dr.select(dr.gather(mi.UInt32, mover, near, seen) == own, facing, -1)
    packed = dr.empty(mi.Float, grid.texels * 4)
    value = mi.Vector4f(z, luma, facing, dr.select(seen, mi.Float(1), mi.Float(0)))
    dr.scatter(packed, value, dr.arange(mi.UInt32, grid.texels))
    return packed


def mark(p: Foveated, grid: SupportGrid, looks: Any) -> Any:
    """1 (UInt32) for each texel whose block is traced anew: depth or luma unlike a direct neighbour's, or grazing."""
    index = dr.arange(mi.UInt32, grid.texels)
    row = index // grid.columns
    column = index - row * grid.columns
    own = fetch(looks, index)
    marked = own.z < p.eps_edge
    for inside, other in (
        (column > 0, index - 1), (column + 1 < grid.columns, index + 1),
        (row > 0, index - grid.columns), (row + 1 < grid.rows, index + grid.columns),
    ):  # fmt: skip
        near = fetch(looks, other, inside)
        differs = (dr.abs(own.x - near.x) > p.eps_depth * own.x) | (dr.abs(own.y - near.y) > p.eps_lum)
        marked |= inside & (near.w > 0) & differs
    return dr.select(marked & (own.w > 0), mi.UInt32(1), mi.UInt32(0))
