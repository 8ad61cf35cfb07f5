"""Less noise where pixels were traced anew (Weier et al. 2016, 3.5): such a pixel takes a near cached one's light.

Only light that is sampled (area lights, ambient occlusion) is copied; nothing runs where there is none. What is
filtered is shown, not cached, and pixels of the fovea are left as they were traced.
"""

from __future__ import annotations

from typing import Any

from renderers.backend import dr, mi
from renderers.foveated.compose import Picture, lends_light
from renderers.foveated.reprojection import next_bits
from renderers.foveated.support import SupportGrid
from renderers.foveated.words import Layout, gathered
from renderers.rng import combined

SEARCH_TEXELS = 8
"""How far along each axis a block that is not marked is searched; beyond, the pixel stays as it is."""
_NONE = 1 << 20


def nearest_unmarked_px(grid: SupportGrid, marks: Any, pixel: Any) -> Any:
    """Distance (Float, pixels; inf: none found) along +-x and +-y to the nearest pixel whose block is not marked."""
    y = mi.Int32(pixel // grid.width)
    x = mi.Int32(pixel) - y * grid.width
    column, row = x * grid.columns // grid.width, y * grid.rows // grid.height
    sides = ((-1, 0), (1, 0), (0, -1), (0, 1))

    def further(step: Any, last: Any, marks: Any, column: Any, row: Any, *found: Any) -> tuple[Any, ...]:
        after = []
        for (dx, dy), far in zip(sides, found, strict=True):
            i, j = column + step * dx, row + step * dy
            inside = (i >= 0) & (i < grid.columns) & (j >= 0) & (j < grid.rows) & (far == _NONE)
            free = inside & (dr.gather(mi.UInt32, marks, mi.UInt32(j * grid.columns + i), inside) == 0)
            # blocks are not all of one size: one step further on another side may be nearer
            last = dr.select(free, dr.minimum(last, step + 1), last)
            after.append(dr.select(free, step, far))
        return step + 1, last, marks, column, row, *after

    none = (mi.Int32(_NONE),) * len(sides)
    start = (mi.Int32(1), mi.Int32(SEARCH_TEXELS), marks, column, row, *none)
    found = dr.while_loop(start, lambda step, last, *_: step <= last, further, label="nearest unmarked")[-len(sides) :]
    best = mi.Int32(_NONE)
    for (dx, dy), far in zip(sides, found, strict=True):
        # to the nearest pixel of that block: its last one towards the left or up, its first towards the right, down
        own, at, texels, pixels = (x, column, grid.columns, grid.width) if dx else (y, row, grid.rows, grid.height)
        edge = at + far if dx + dy > 0 else at - far + 1
        distance = dr.abs((edge * pixels + texels - 1) // texels - (0 if dx + dy > 0 else 1) - own)
        best = dr.select(far != _NONE, dr.minimum(best, distance), best)
    return dr.select(best != _NONE, mi.Float(best), dr.inf)


def filter_light(
    taps: int, grid: SupportGrid, layout: Layout, marks: Any, pixel: Any, seed: Any, picture: Picture
) -> tuple[Any, Any]:
    """What the marked pixels ``pixel`` are to show (Vector4f, the last is spare), with the light of the closest of
    ``taps`` random cached pixels around them, and which of them found one."""
    radius = nearest_unmarked_px(grid, marks, pixel)
    reach = dr.select(radius < dr.inf, radius, 0)
    y = mi.Int32(pixel // grid.width)
    x = mi.Int32(pixel) - y * grid.width
    best, closest = mi.Int32(_NONE), pixel
    bits = combined(seed, pixel)
    for _ in range(taps):
        bits = next_bits(bits + 0x9E3779B9)
        # -reach to reach along both axes
        dx, dy = (
            mi.Int32(dr.round((mi.Float(half) * (2 / 65535) - 1) * reach)) for half in (bits & 0xFFFF, bits >> 16)
        )
        i, j = x + dx, y + dy
        distance = dx * dx + dy * dy
        cached = (reach > 0) & (i >= 0) & (i < grid.width) & (j >= 0) & (j < grid.height) & (distance < best)
        other = mi.UInt32(j * grid.width + i)
        cached &= lends_light(dr.gather(mi.UInt64, picture.info, other, cached))
        closest, best = dr.select(cached, other, closest), dr.select(cached, distance, best)
    here = gathered(layout, picture.words, pixel)
    light = gathered(layout, picture.words, closest)["light"]
    value = here["surface"] + here["albedo"] * light
    return mi.Vector4f(value.x, value.y, value.z, 0), best != _NONE
