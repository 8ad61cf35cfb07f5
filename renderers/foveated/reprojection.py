"""From the last picture to this one (Weier et al. 2016, 3.2 and 3.3): footprint filter, holes, marks for resampling.

Pictures are flat `mi.Float`, H * W * 4 (see `renderers.image`). ``place`` (H * W * 2) says where each pixel was in the
last picture, in pixels (nan: nowhere), ``depth`` (H * W) is window depth; both come from the rasterised depth mesh.
"""

from __future__ import annotations

import math
from typing import Any

from renderers.backend import dr, mi
from renderers.foveated.support import FAR, SupportGrid
from renderers.gl.context import NEAR
from renderers.image import bilinear, fetch, rgb
from renderers.parameters import Foveated
from renderers.rng import combined, mixed

JUMP_PX = 4.0
"""Neighbours that were further apart than this lie on different surfaces."""
BACKGROUND = 0.1 * FAR
"""Tracer units: everything further away counts as background."""
AT_REST_PX = 1 / 256
"""A pixel that comes from so near a pixel's centre, at the same scale, takes that pixel alone."""


def normal_pair(bits: Any) -> Any:
    """Two nearly normal deviates (Vector2f) from 32 random bits and a hash of them: sums of four bytes (Irwin, Hall).

    Mean 0, variance 1, none beyond 3.5. A table of exact ones (128 KB, fetched at random) made a frame's `resolve` take
    1.7 times as long.
    """

    def total(word: Any) -> Any:
        return (word & 255) + ((word >> 8) & 255) + ((word >> 16) & 255) + (word >> 24)

    scale = 1 / math.sqrt(4 * (256**2 - 1) / 12)
    return mi.Vector2f((mi.Float(total(bits)) - 510) * scale, (mi.Float(total(mixed(bits))) - 510) * scale)


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


def _step(place: Any, neighbour: Any, sign: Any, unit: Any) -> Any:
    """How far ``place`` moves to a neighbour's; ``unit`` where the two do not lie on one surface."""
    step = (neighbour - place) * sign
    return dr.select(dr.squared_norm(step) < JUMP_PX**2, step, unit)  # false for nan


def resolve(
    p: Foveated, grid: SupportGrid, names: tuple[str, ...], place: Any, old: dict[str, Any], support: dict[str, Any],
    seed: Any, new: dict[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """Every pixel from the last picture, or from the support image where that has nothing. Lanes in scanline order: in
    tile order this takes 1.4 times as long.

    ``names``: the pictures to carry over (``old`` and ``support`` have them), filtered by ``n_fp`` normal taps in the
    pixel's footprint; ``info`` is fetched nearest, and its age grows by 1 (rho 0: filled from the support image).
    """
    width, height = grid.width, grid.height
    index = dr.arange(mi.UInt32, width * height)
    y = index // width
    x = index - y * width
    here = dr.gather(mi.Vector2f, place, index)
    seen = was_seen(here, width, height)
    # The footprint: how the place changes towards the right (left at the edge) and down.
    right, down = x + 1 < width, y + 1 < height
    beside = dr.gather(mi.Vector2f, place, dr.select(right, index + 1, index - min(1, width - 1)))
    below = dr.gather(mi.Vector2f, place, dr.select(down, index + width, index - (width if height > 1 else 0)))
    across = _step(here, beside, dr.select(right, mi.Float(1), mi.Float(-1)), mi.Vector2f(1, 0))
    along = _step(here, below, dr.select(down, mi.Float(1), mi.Float(-1)), mi.Vector2f(0, 1))
    off = dr.abs(here - dr.floor(here) - 0.5)
    unlike = dr.maximum(dr.max(dr.abs(across - mi.Vector2f(1, 0))), dr.max(dr.abs(along - mi.Vector2f(0, 1))))
    moved = dr.maximum(dr.max(off), unlike) > AT_REST_PX
    sigma = dr.select(moved, mi.Float(0.5 * p.footprint_sigma), mi.Float(0))
    totals = {name: mi.Color3f(0) for name in names}
    start = combined(seed, index)
    for tap in range(p.n_fp):
        pair = normal_pair(mixed(start + tap))
        at = pixel_at(here + across * (sigma * pair.x) + along * (sigma * pair.y), width, height)
        for name in names:
            totals[name] += rgb(fetch(old[name], at, seen))
    empty = ~seen
    sx = (mi.Float(x) + 0.5) * (grid.columns / width)
    sy = (mi.Float(y) + 0.5) * (grid.rows / height)
    values = {}
    for name in names:
        value = totals[name] * (1 / p.n_fp)
        filled = bilinear(support[name], sx, sy, grid.columns, grid.rows, empty)
        value = values[name] = dr.select(empty, filled, value)
        dr.scatter(new[name], mi.Vector4f(value.x, value.y, value.z, 0), index)
    if "light" in names:
        value = values["surface"] + values["albedo"] * values["light"]
        dr.scatter(new["shown"], mi.Vector4f(value.x, value.y, value.z, 0), index)
    # Cache info is never averaged.
    nearest = pixel_at(here, width, height)
    info = dr.gather(mi.Vector2f, old["info"], nearest, seen)
    dr.scatter(new["info"], mi.Vector2f(info.x, info.y + 1), index)
    if "light" in names:
        dr.scatter(new["rho_light"], dr.gather(mi.Float, old["rho_light"], nearest, seen), index)
    return new


def display_luma(color: Any, exposure: Any) -> Any:
    """Rec.709 luma of a linear colour as the display shows it: sRGB-encoded, in [0, 1]."""
    c = dr.clip(color * exposure, 0, 1)
    c = dr.select(c <= 0.0031308, 12.92 * c, 1.055 * dr.power(dr.maximum(c, 0.0031308), 1 / 2.4) - 0.055)
    return 0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z


def look(
    grid: SupportGrid, place: Any, depth: Any, shown: Any, edge: Any, to_world: Any, exposure: Any, texel_pixel: Any
) -> Any:
    """The reprojected picture at support resolution: (world depth, luma, edge, 1 where there is something), packed.

    Luma is that of the texel's mean colour: 3x3 taps over its footprint, the coarse picture's filter. Background is as
    far as `BACKGROUND`, where window depth still resolves 1 %.
    """
    here = dr.gather(mi.Vector2f, place, texel_pixel)
    seen = was_seen(here, grid.width, grid.height)
    z = dr.minimum(world_depth(dr.gather(mi.Float, depth, texel_pixel), to_world), BACKGROUND * to_world)
    y = mi.Int32(texel_pixel // grid.width)
    x = mi.Int32(texel_pixel) - y * grid.width
    total, count = mi.Color3f(0), mi.Float(0)
    for oy in (-1, 0, 1):
        row = dr.clip(y + round(oy * grid.height / grid.rows / 3), 0, grid.height - 1) * grid.width
        for ox in (-1, 0, 1):
            column = dr.clip(x + round(ox * grid.width / grid.columns / 3), 0, grid.width - 1)
            at = dr.gather(mi.Vector2f, place, mi.UInt32(row + column))
            there = was_seen(at, grid.width, grid.height)
            total += rgb(fetch(shown, pixel_at(at, grid.width, grid.height), there))
            count += dr.select(there, mi.Float(1), 0)
    luma = display_luma(total / dr.maximum(count, 1), exposure)
    column = mi.UInt32(dr.clip(here.x * (grid.columns / grid.width), 0, grid.columns - 1))
    row = mi.UInt32(dr.clip(here.y * (grid.rows / grid.height), 0, grid.rows - 1))
    vertex = (row + 1) * (grid.columns + 2) + column + 1
    packed = dr.empty(mi.Float, grid.texels * 4)
    value = mi.Vector4f(z, luma, dr.gather(mi.Float, edge, vertex, seen), dr.select(seen, mi.Float(1), mi.Float(0)))
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
