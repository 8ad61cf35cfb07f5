"""The new picture in one pass (Weier et al. 2016, 3.2 and 3.4): last frame's pixels, holes, and this frame's samples.

A pass for what is carried over and another for the samples took 1.3 (area light) to 1.4 times as long (point light): a
sample's pixel has its own cache lines in every buffer. Samples packed like the cache saved nothing.
"""

from __future__ import annotations

from typing import Any

from renderers.backend import dr, mi
from renderers.foveated import light_cache
from renderers.foveated.cache import blend
from renderers.foveated.reprojection import BACKGROUND, JUMP_PX, next_bits, normal_pair, pixel_at, was_seen, world_depth
from renderers.foveated.support import SupportGrid
from renderers.image import bilinear, fetch, rgb
from renderers.parameters import Foveated
from renderers.rng import combined

AT_REST_PX = 1 / 256
"""A pixel that comes from so near a pixel's centre, at the same scale, takes that pixel alone."""
NO_SAMPLE = 0xFFFFFFFF
OVERWRITES = 1 << 31
"""Set beside a sample's lane number where the cache is not asked: the fovea, marked pixels."""


def _step(place: Any, neighbour: Any, sign: Any, unit: Any) -> Any:
    """How far ``place`` moves to a neighbour's; ``unit`` where the two do not lie on one surface."""
    step = (neighbour - place) * sign
    return dr.select(dr.squared_norm(step) < JUMP_PX**2, step, unit)  # false for nan


def carried_over(
    p: Foveated, grid: SupportGrid, names: tuple[str, ...], place: Any, index: Any, wanted: Any, old: dict[str, Any],
    support: dict[str, Any], seed: Any,
) -> dict[str, Any]:  # fmt: skip
    """What the last picture has for the pixels ``index``, or the support image where it has nothing; where ``wanted``.

    ``names``: the pictures, filtered by ``n_fp`` normal taps in the pixel's footprint. Cache info is fetched nearest,
    never averaged, and its age grows by 1 (rho 0: filled from the support image).
    """
    width, height = grid.width, grid.height
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
        pair = normal_pair(next_bits(start + tap * 0x9E3779B9 % (1 << 32)))
        at = pixel_at(here + across * (sigma * pair.x) + along * (sigma * pair.y), width, height)
        if "cache" in old:
            found = light_cache.colors(old["cache"], at, seen & wanted)
        else:
            found = {"shown": rgb(fetch(old["shown"], at, seen & wanted))}
        for name in names:
            totals[name] += found[name]
    empty = ~seen
    sx = (mi.Float(x) + 0.5) * (grid.columns / width)
    sy = (mi.Float(y) + 0.5) * (grid.rows / height)
    mean = [totals[name] * (1 / p.n_fp) for name in names]

    def filled(pictures: list[Any], x: Any, y: Any, _: list[Any]) -> list[Any]:
        return [bilinear(picture, x, y, grid.columns, grid.rows) for picture in pictures]

    # A branch that packets without a hole jump over: 0.9 of the pass's time.
    pictures = [support[name] for name in names]
    mean = dr.if_stmt((pictures, sx, sy, mean), empty & wanted, filled, lambda pictures, x, y, mean: mean)
    values: dict[str, Any] = dict(zip(names, mean, strict=True))
    nearest = pixel_at(here, width, height)
    if "cache" in old:
        values |= light_cache.info(old["cache"], nearest, seen)
        values["shown"] = values["surface"] + values["albedo"] * values["light"]
    else:
        info = dr.gather(mi.Vector2f, old["info"], nearest, seen)
        values |= {"rho": info.x, "age": info.y}
    values["age"] = values["age"] + 1
    return values


def store(buffers: dict[str, Any], pixel: Any, values: dict[str, Any]) -> None:
    """Write what is shown and the cache of ``pixel``."""
    c = values["shown"]
    dr.scatter(buffers["shown"], mi.Vector4f(c.x, c.y, c.z, 0), pixel)
    if "cache" in buffers:
        light_cache.write(buffers["cache"], pixel, values)
    else:
        dr.scatter(buffers["info"], mi.Vector2f(values["rho"], values["age"]), pixel)


def first_samples(pixel: Any, samples: dict[str, Any], buffers: dict[str, Any]) -> dict[str, Any]:
    """Write the samples (packed, a lane each) where there is no history: each is one of one."""
    lane = dr.arange(mi.UInt32, dr.width(pixel))
    values = {"shown" if name == "color" else name: rgb(fetch(packed, lane)) for name, packed in samples.items()}
    store(buffers, pixel, values | {"rho": mi.Float(1), "age": mi.Float(0), "rho_light": mi.Float(1)})
    return buffers


def compose(
    p: Foveated, grid: SupportGrid, names: tuple[str, ...], place: Any, depth: Any, slot: Any, samples: dict[str, Any],
    old: dict[str, Any], support: dict[str, Any], to_world: Any, t_max: Any, seed: Any, new: dict[str, Any],
    weight: Any,
) -> tuple[dict[str, Any], Any]:  # fmt: skip
    """Every pixel of ``new``: carried over, and blended with its sample where it has one; ``weight``: alpha by lane.

    ``slot`` (a pixel each): the lane of its sample with `OVERWRITES`, or `NO_SAMPLE`. ``samples``: packed, a lane each
    (color has z beside it). Lanes in scanline order: in tile order this takes 1.4 times as long.
    """
    index = dr.arange(mi.UInt32, grid.width * grid.height)
    traced = slot != NO_SAMPLE
    overwrite = traced & (slot >= OVERWRITES)
    values = carried_over(p, grid, names, place, index, ~overwrite, old, support, seed)
    lane = slot & (OVERWRITES - 1)
    fetched = {name: fetch(packed, lane, traced) for name, packed in samples.items()}
    sample = {name: rgb(value) for name, value in fetched.items()} | {"z": fetched["color"].w}
    z_cache = world_depth(depth, to_world)
    blended, alpha = blend(p, sample, values, overwrite, z_cache, to_world * BACKGROUND, t_max)
    values = {name: dr.select(traced, value, values[name]) for name, value in blended.items()}
    store(new, index, values)
    dr.scatter(weight, alpha, lane, traced)
    return new, weight
