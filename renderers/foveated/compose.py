"""The new picture in one pass (Weier et al. 2016, 3.2 and 3.4): last frame's pixels, holes, and this frame's samples.

A pass for what is carried over and another for the samples took 1.3 (area light) to 1.4 times as long (point light).
Nothing is written into a buffer that was there before: a recording copies such a buffer first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from renderers.backend import dr, mi
from renderers.foveated.cache import blend
from renderers.foveated.reprojection import (
    BACKGROUND,
    DEVIATION,
    JUMP_PX,
    next_bits,
    normal_taps,
    pixel_at,
    was_seen,
    world_depth,
)
from renderers.foveated.support import SupportGrid
from renderers.foveated.words import COLORS, LEAST, SCALE, Layout, float_pair, floats, gathered, gathered_small, packed
from renderers.parameters import Foveated
from renderers.rng import combined

AT_REST_PX = 1 / 256
"""A pixel that comes from so near a pixel's centre, at the same scale, takes that pixel alone."""
NO_SAMPLE = 0xFFFFFFFF
OVERWRITES = 1 << 31
"""Set beside a sample's lane number where the cache is not asked: the fovea, marked pixels."""


@dataclass
class Samples:
    """A PyTree, a lane each: ``color`` as it is and z beside it (two words), the cache's ``words``, and the G-buffer:
    ``z`` (world units, inf: background), ``normal`` (tracer space), ``mover``."""

    color: tuple[Any, Any]
    words: tuple[Any, ...]
    z: Any
    normal: Any
    mover: Any


@dataclass
class Picture:
    """A PyTree, a pixel each: ``shown`` (Float, 4 a pixel, the last is spare), the cache's ``words``, ``info`` (rho and
    age, Floats in a word; age has a minus where there is no light to lend), ``rho_light`` where light has a recursion
    of its own, and ``alpha`` (0: no sample)."""

    shown: Any
    words: tuple[Any, ...]
    info: Any
    rho_light: Any
    alpha: Any


def _step(place: Any, neighbour: Any, sign: Any, unit: Any) -> Any:
    """How far ``place`` moves to a neighbour's; ``unit`` where the two do not lie on one surface."""
    step = (neighbour - place) * sign
    return dr.select(dr.squared_norm(step) < JUMP_PX**2, step, unit)  # false for nan


def _from_support(grid: SupportGrid, layout: Layout, words: Any, lanes: Any, x: Any, y: Any) -> list[Any]:
    """The support image's `COLORS` at ``x``, ``y`` (texels), bilinear; ``lanes``: of each texel's sample."""
    gx, gy = dr.clip(x - 0.5, 0, grid.columns - 1), dr.clip(y - 0.5, 0, grid.rows - 1)
    x0, y0 = (dr.minimum(mi.UInt32(g), max(n - 2, 0)) for g, n in ((gx, grid.columns), (gy, grid.rows)))
    right, down = (1 if grid.columns > 1 else 0), (grid.columns if grid.rows > 1 else 0)
    corner = y0 * grid.columns + x0
    fx, fy = gx - mi.Float(x0), gy - mi.Float(y0)
    shares = ((0, (1 - fx) * (1 - fy)), (right, fx * (1 - fy)), (down, (1 - fx) * fy), (down + right, fx * fy))
    totals = {name: mi.Color3f(0) for name in COLORS[layout]}
    for offset, share in shares:
        found = gathered(layout, words, dr.gather(mi.UInt32, lanes, corner + offset))
        for name, value in found.items():
            totals[name] += value * share
    return list(totals.values())


def cacheable(sample: dict[str, Any], white: Any) -> dict[str, Any]:
    """``shown``, or ``surface``, ``albedo`` and ``light``, so that what they show is no more than the display's
    ``white``: a mean of colours beyond it would be white however few of them were bright."""
    found = dict(sample)
    for name in ("shown", "surface"):
        if name in found:
            found[name] = dr.minimum(found[name], white)
    if "albedo" in found:  # light stays as it is: neighbours borrow it
        left = dr.maximum(white - found["surface"], 0)
        found["albedo"] = dr.minimum(found["albedo"], left * dr.rcp(dr.maximum(found["light"], LEAST)))
    return found


def carried_over(
    p: Foveated, grid: SupportGrid, layout: Layout, place: Any, index: Any, wanted: Any, old: Picture, samples: Samples,
    texel_lanes: Any, seed: Any,
) -> dict[str, Any]:  # fmt: skip
    """What the last picture has for the pixels ``index``, or the support image where it has nothing; where ``wanted``.

    The layout's colours are filtered by ``n_fp`` normal taps in the pixel's footprint. Cache info is fetched nearest,
    never averaged, and its age grows by 1 (rho 0: filled from the support image).
    """
    width, height = grid.width, grid.height
    names = COLORS[layout]
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
    sigma = dr.select(moved, mi.Float(0.5 * p.footprint_sigma / DEVIATION), mi.Float(0))
    across, along = across * sigma, along * sigma
    totals = {name: mi.Color3f(0) for name in names}
    start = combined(seed, index)
    for tap in range(p.n_fp):
        if tap % 2 == 0:
            taps = normal_taps(next_bits(start + tap * 0x9E3779B9 % (1 << 32)))
        at = pixel_at(here + across * taps[tap % 2].x + along * taps[tap % 2].y, width, height)
        found = gathered_small(layout, old.words, at, seen & wanted)
        for name in names:
            totals[name] += found[name]
    mean = [totals[name] * (SCALE / p.n_fp) for name in names]

    def filled(words: Any, lanes: Any, x: Any, y: Any, _: list[Any]) -> list[Any]:
        sx, sy = (mi.Float(x) + 0.5) * (grid.columns / width), (mi.Float(y) + 0.5) * (grid.rows / height)
        return _from_support(grid, layout, words, lanes, sx, sy)

    # A branch that packets without a hole jump over: 0.9 of the pass's time.
    inputs = (samples.words, texel_lanes, x, y, mean)
    mean = dr.if_stmt(inputs, ~seen & wanted, filled, lambda words, lanes, x, y, mean: mean)
    values: dict[str, Any] = dict(zip(names, mean, strict=True))
    if layout != "shown":
        values["shown"] = values["surface"] + values["albedo"] * values["light"]
    nearest = pixel_at(here, width, height)
    values["rho"], age = floats(dr.gather(mi.UInt64, old.info, nearest, seen))
    values["age"] = dr.abs(age) + 1
    if old.rho_light is not None:
        values["rho_light"] = dr.gather(mi.Float, old.rho_light, nearest, seen)
    return values


def lends_light(info: Any) -> Any:
    """Whether the post filter may copy a pixel's light: not of fovea or marks, known, and no background."""
    return info >> 63 == 0


def _picture(layout: Layout, values: dict[str, Any], overwrite: Any, alpha: Any, white: Any, pixels: int) -> Picture:
    """What a frame leaves: a lane for each of the picture's pixels in scanline order."""
    shown, color = dr.empty(mi.Float, pixels * 4), values["shown"]
    dr.scatter(
        shown, mi.Vector4f(color.x, color.y, color.z, 0), dr.arange(mi.UInt32, pixels), mode=dr.ReduceMode.NoConflicts
    )
    age = values["age"]
    if layout == "shown":
        values = values | {"shown": dr.minimum(color, white)}
    else:  # background and what only glows hold no light
        age = dr.select(~overwrite & (values["rho"] > 0) & (dr.max(values["albedo"]) > LEAST), age, -age)
    info = float_pair(values["rho"], age)
    return Picture(shown, packed(layout, values), info, values.get("rho_light"), alpha)


def _sample(layout: Layout, samples: Samples, lane: Any, white: Any) -> dict[str, Any]:
    """``color`` and ``z`` of a lane's sample, and the layout's `COLORS` as they are cached."""
    rg, bz = (floats(dr.gather(mi.UInt64, word, lane)) for word in samples.color)
    color = mi.Color3f(*rg, bz[0])
    found = {"shown": dr.minimum(color, white)} if layout == "shown" else gathered(layout, samples.words, lane)
    return found | {"color": color, "z": bz[1]}


def first_picture(
    layout: Layout, grid: SupportGrid, lane: Any, samples: Samples, white: Any, own_light: bool
) -> Picture:
    """The samples alone, where there is no history: each is one of one. ``lane`` (a pixel each): its sample's."""
    found = _sample(layout, samples, lane, white)
    one = dr.select(lane != NO_SAMPLE, mi.Float(1), 0)  # a lane each: results of one value would be one value wide
    info = {"shown": found["color"], "rho": one, "age": 1 - one} | ({"rho_light": one} if own_light else {})
    return _picture(layout, found | info, mi.Bool(False), one, white, grid.width * grid.height)


def compose(
    p: Foveated, grid: SupportGrid, layout: Layout, place: Any, depth: Any, slot: Any, samples: Samples,
    texel_lanes: Any, old: Picture, to_world: Any, t_max: Any, white: Any, seed: Any,
) -> Picture:  # fmt: skip
    """Every pixel: carried over, and blended with its sample where it has one.

    ``slot`` (a pixel each): the lane of its sample with `OVERWRITES`, or `NO_SAMPLE`. Lanes in scanline order: in tile
    order this takes 1.4 times as long.
    """
    pixels = grid.width * grid.height
    index = dr.arange(mi.UInt32, pixels)
    traced = slot != NO_SAMPLE
    overwrite = traced & (slot >= OVERWRITES)
    values = carried_over(p, grid, layout, place, index, ~overwrite, old, samples, texel_lanes, seed)
    z_cache, far = world_depth(depth, to_world), to_world * BACKGROUND

    def merged(
        samples: Samples, slot: Any, overwrite: Any, z_cache: Any, far: Any, t_max: Any, white: Any,
        values: dict[str, Any], _: Any,
    ) -> tuple[dict[str, Any], Any]:  # fmt: skip
        sample = _sample(layout, samples, slot & (OVERWRITES - 1), white)
        blended, alpha = blend(p, sample, values, overwrite, z_cache, far, t_max)
        return {name: blended[name] for name in values}, alpha

    # Packets without a sample jump over it.
    inputs = (samples, slot, overwrite, z_cache, far, t_max, white, values, dr.zeros(mi.Float, pixels))
    values, alpha = dr.if_stmt(inputs, traced, merged, lambda *inputs: inputs[-2:])
    return _picture(layout, values, overwrite, alpha, white, pixels)
