"""Less noise where pixels were traced anew (Weier et al. 2016, 3.5): such a pixel takes a near cached one's light.

Only light that is sampled (area lights, ambient occlusion) is copied; nothing runs where there is none. What is
filtered is shown, not cached, and pixels of the fovea are left as they were traced.
"""

from __future__ import annotations

from typing import Any

from renderers.backend import dr, mi
from renderers.foveated.compose import Picture
from renderers.foveated.support import SupportGrid
from renderers.foveated.words import Layout, floats, gathered
from renderers.rng import uniform

SEARCH_TEXELS = 8
"""How far along each axis a block that is not marked is searched; beyond, the pixel stays as it is."""


def nearest_unmarked_px(grid: SupportGrid, marks: Any, pixel: Any) -> Any:
    """Distance (Float, pixels; inf: none found) along +-x and +-y to the nearest pixel whose block is not marked."""
    y = mi.Int32(pixel // grid.width)
    x = mi.Int32(pixel) - y * grid.width
    column, row = x * grid.columns // grid.width, y * grid.rows // grid.height
    best = mi.Float(dr.inf)
    for step in range(1, SEARCH_TEXELS + 1):
        for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            i, j = column + dx * step, row + dy * step
            inside = (i >= 0) & (i < grid.columns) & (j >= 0) & (j < grid.rows)
            free = inside & (dr.gather(mi.UInt32, marks, mi.UInt32(j * grid.columns + i), inside) == 0)
            # to the nearest pixel of that block: its last one towards the left or up, its first towards the right, down
            if dx:
                edge = i if dx > 0 else i + 1
                at = (edge * grid.width + grid.columns - 1) // grid.columns - (0 if dx > 0 else 1)
                distance = dr.abs(at - x)
            else:
                edge = j if dy > 0 else j + 1
                at = (edge * grid.height + grid.rows - 1) // grid.rows - (0 if dy > 0 else 1)
                distance = dr.abs(at - y)
            best = dr.select(free & (mi.Float(distance) < best), mi.Float(distance), best)
    return best


def filter_light(
    taps: int, grid: SupportGrid, layout: Layout, marks: Any, probability: Any, pixel: Any, seed: Any, picture: Picture
) -> Any:
    """Show the marked pixels ``pixel`` with the light of the closest of ``taps`` random cached pixels around them."""
    radius = nearest_unmarked_px(grid, marks, pixel)
    found = radius < dr.inf
    y = mi.Int32(pixel // grid.width)
    x = mi.Int32(pixel) - y * grid.width
    best, closest = mi.Float(dr.inf), pixel
    for tap in range(taps):
        own = seed ^ (pixel * mi.UInt32(0x85EBCA6B))
        dx = mi.Int32(dr.round((uniform(own, 2 * tap) * 2 - 1) * dr.select(found, radius, 0)))
        dy = mi.Int32(dr.round((uniform(own, 2 * tap + 1) * 2 - 1) * dr.select(found, radius, 0)))
        i, j = x + dx, y + dy
        inside = found & (i >= 0) & (i < grid.width) & (j >= 0) & (j < grid.height)
        distance = mi.Float(dx * dx + dy * dy)
        cached = inside & (distance < best)
        other = mi.UInt32(j * grid.width + i)
        texel = mi.UInt32(j * grid.rows // grid.height * grid.columns + i * grid.columns // grid.width)
        cached &= dr.gather(mi.UInt32, marks, texel, cached) == 0
        cached &= dr.gather(mi.Float, probability, other, cached) <= 1
        there = gathered(layout, picture.words, other, cached)
        if picture.rho_light is None:
            rho = floats(dr.gather(mi.UInt64, picture.info, other, cached))[0]
        else:
            rho = dr.gather(mi.Float, picture.rho_light, other, cached)
        cached &= rho > 0
        # background and what only glows hold no light to copy
        cached &= dr.max(there["albedo"]) > 0
        closest, best = dr.select(cached, other, closest), dr.select(cached, distance, best)
    here = gathered(layout, picture.words, pixel)
    light = gathered(layout, picture.words, closest)["light"]
    value = here["surface"] + here["albedo"] * light
    shown, packet = picture.shown, mi.Vector4f(value.x, value.y, value.z, 0)
    dr.scatter(shown, packet, pixel, best < dr.inf, mode=dr.ReduceMode.NoConflicts)
    return shown
