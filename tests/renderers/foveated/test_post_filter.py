"""Which cached pixel lends its light to a marked one: near ones on all sides, the closest of the taps."""

from __future__ import annotations

import numpy as np

from renderers.backend import activate, mi
from renderers.foveated.compose import Picture
from renderers.foveated.post_filter import filter_light, nearest_unmarked_px
from renderers.foveated.support import IS_TEXEL, SupportGrid
from renderers.foveated.words import float_pair, packed

activate()
WIDTH, HEIGHT = 92, 69
GRID = SupportGrid.of((WIDTH, HEIGHT), 4.6)


def lenders(taps: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of each marked pixel that found one: its place and the lender's (x, y), the window's radius; and the marks.

    Light tells its pixel's number: red its column, green its row; albedo is 1.
    """
    marks = (np.random.default_rng(3).random(GRID.texels) < 0.2).astype(np.uint32)
    marked = marks[GRID.texel_of_pixels() & (IS_TEXEL - 1)] > 0
    y, x = (v.ravel().astype(np.float32) for v in np.mgrid[:HEIGHT, :WIDTH])
    one, none = mi.Float(np.ones_like(x)), mi.Float(np.zeros_like(x))
    light = mi.Color3f(mi.Float(x + 1), mi.Float(y + 1), one)
    words = packed("light", {"surface": mi.Color3f(none), "albedo": mi.Color3f(one), "light": light})
    age = mi.Float(np.where(marked, -1, 1).astype(np.float32))  # marked pixels lend nothing
    picture = Picture(none, words, float_pair(one, age), None, none)
    pixels = np.flatnonzero(marked)
    asked = mi.UInt32(pixels.astype(np.uint32))
    shown, found = filter_light(taps, GRID, "light", mi.UInt32(marks), asked, mi.UInt32(seed), picture)
    radius = nearest_unmarked_px(GRID, mi.UInt32(marks), asked).numpy()
    hit = found.numpy().astype(bool)
    at = np.stack([pixels % WIDTH, pixels // WIDTH], -1)[hit]
    return at, np.rint(shown.numpy()[:2].T - 1)[hit].astype(int), radius[hit], marked.reshape(HEIGHT, WIDTH)


def test_lenders_are_cached_pixels_in_the_window_on_all_sides() -> None:
    at, lender, radius, marked = lenders(8, 1)
    assert len(at) > 500
    assert not marked[lender[:, 1], lender[:, 0]].any()
    off = lender - at
    assert (np.abs(off) <= np.ceil(radius)[:, None]).all()
    for axis in (0, 1):
        before, after = (off[:, axis] < 0).mean(), (off[:, axis] > 0).mean()
        assert min(before, after) > 0.25
        assert abs(before - after) < 0.12


def test_the_closest_of_the_taps_lends() -> None:
    """With many taps that is nearly always the nearest of all in the window."""
    at, lender, radius, marked = lenders(64, 2)
    y, x = np.nonzero(~marked)
    excess = []
    for place, found, reach in zip(at, lender, radius, strict=True):
        inside = (np.abs(x - place[0]) <= reach) & (np.abs(y - place[1]) <= reach)
        least = np.hypot(x[inside] - place[0], y[inside] - place[1]).min()
        excess.append(np.linalg.norm(found - place) - least)
    assert min(excess) >= 0
    assert np.mean(excess) < 0.2
    assert np.mean(np.array(excess) == 0) > 0.8
