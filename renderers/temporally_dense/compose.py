"""From a quarter of the pixels to a whole frame (Andersson et al. 2019, section 3.2), one Dr.Jit kernel over 2x2 tiles.

Buffers, all flat `mi.Float`: ``picture`` H * W * 4 (RGB, spare); ``samples`` tiles * 4 (RGB of the pixel traced this
frame, and the tile's order: 1 hourglass, 0 bowtie); ``motion`` tiles * 2 (x, y, pixels a frame); ``window`` H * W * 16
(four own samples of each pixel, RGB and the bits of the frame number they were taken in).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from renderers.backend import dr, mi
from renderers.image import bilinear, fetch, from_ycocg, longest, mean_and_deviation, rgb, store, to_ycocg
from renderers.temporally_dense.pixel_order import pixel_in_tile

STATIC_PX = 1 / 1024
"""A longest motion below this many pixels a frame is none."""


@dataclass(frozen=True)
class Settings:
    """What is fixed while a kernel is recorded; sizes in pixels. See `renderers.parameters.TemporallyDense`."""

    width: int
    height: int
    neighbourhood: str
    reproject: bool
    box_sigmas: float
    least_sigma: float

    @property
    def tiles_x(self) -> int:
        """Tiles a row, a half one at the edge included."""
        return (self.width + 1) // 2

    @property
    def tiles_y(self) -> int:
        """Rows of tiles."""
        return (self.height + 1) // 2


def tile_motion(motion: Any, tile_x: Any, tile_y: Any, s: Settings) -> tuple[Any, Any]:
    """The longest of the 3x3 motion vectors around each tile (one vector a tile)."""
    candidates = []
    for oy in (0, -1, 1):
        for ox in (0, -1, 1):
            x, y = mi.Int32(tile_x) + ox, mi.Int32(tile_y) + oy
            inside = (x >= 0) & (x < s.tiles_x) & (y >= 0) & (y < s.tiles_y)
            index = mi.UInt32(dr.clip(y, 0, s.tiles_y - 1) * s.tiles_x + dr.clip(x, 0, s.tiles_x - 1))
            vector = dr.gather(mi.Vector2f, motion, index)
            candidates.append((vector.x, vector.y, inside))
    return longest(candidates)


def _new_samples(samples: Any, tile_x: Any, tile_y: Any, subframe: Any, s: Settings) -> dict[tuple[int, int], Any]:
    """For the 3x3 tiles: (colour in YCoCg, is inside, pixel column, pixel row) of the pixel traced this frame."""
    found = {}
    for oy in (-1, 0, 1):
        for ox in (-1, 0, 1):
            x, y = mi.Int32(tile_x) + ox, mi.Int32(tile_y) + oy
            inside = (x >= 0) & (x < s.tiles_x) & (y >= 0) & (y < s.tiles_y)
            texel = fetch(samples, mi.UInt32(dr.clip(y, 0, s.tiles_y - 1) * s.tiles_x + dr.clip(x, 0, s.tiles_x - 1)))
            column, row = pixel_in_tile(texel.w > 0.5, subframe)
            # at an odd edge the traced pixel is the nearest inside one
            px = dr.minimum(mi.Int32(column) + 2 * x, s.width - 1)
            py = dr.minimum(mi.Int32(row) + 2 * y, s.height - 1)
            found[ox, oy] = (to_ycocg(rgb(texel)), inside, px, py)
    return found


def _recent_immediate(new: dict, px: Any, py: Any, dx: int, dy: int) -> list[tuple[Any, Any]]:
    """Fig. 7, right: the new ones among the eight immediate neighbours (at most one in each of four tiles)."""
    chosen = []
    for ox in (0, 2 * dx - 1):
        for oy in (0, 2 * dy - 1):
            colour, inside, nx, ny = new[ox, oy]
            chosen.append((colour, inside & (dr.abs(nx - px) <= 1) & (dr.abs(ny - py) <= 1)))
    return chosen


def _all_immediate(picture: Any, new: dict, px: Any, py: Any, dx: int, dy: int, s: Settings) -> list[tuple[Any, Any]]:
    """Fig. 7, left: all eight immediate neighbours and the pixel itself; old ones as the last frame had them."""
    chosen = []
    recent = [new[ox, oy] for ox in (0, 2 * dx - 1) for oy in (0, 2 * dy - 1)]
    for ny in (-1, 0, 1):
        for nx in (-1, 0, 1):
            x, y = px + nx, py + ny
            inside = (x >= 0) & (x < s.width) & (y >= 0) & (y < s.height)
            index = mi.UInt32(dr.clip(y, 0, s.height - 1) * s.width + dr.clip(x, 0, s.width - 1))
            colour = to_ycocg(rgb(fetch(picture, index)))
            for new_colour, valid, qx, qy in recent:
                colour = dr.select(valid & (qx == x) & (qy == y), new_colour, colour)
            chosen.append((colour, inside))
    return chosen


def _box(picture: Any, new: dict, px: Any, py: Any, dx: int, dy: int, s: Settings) -> tuple[Any, Any]:
    """Mean and half width of the colour box an old pixel is clamped to, in YCoCg."""
    if s.neighbourhood == "recent_immediate":
        samples = _recent_immediate(new, px, py, dx, dy)
    elif s.neighbourhood == "recent_3x3":
        samples = [(colour, inside) for colour, inside, _, _ in new.values()]
    else:
        samples = _all_immediate(picture, new, px, py, dx, dy, s)
    mean, sigma, _ = mean_and_deviation(samples)
    return mean, dr.maximum(sigma, s.least_sigma) * s.box_sigmas


def _window_mean(window: Any, pixel: Any, sample: Any, slot: Any, frame: Any, last_dynamic: Any) -> Any:
    """Put a static pixel's new sample into its slot and average those taken since it became static, in slot order."""
    total, count = mi.Color3f(0), mi.Float(0)
    for k in range(4):
        texel = fetch(window, pixel * 4 + k)
        taken = dr.reinterpret_array(mi.UInt32, texel.w)
        this = slot == k
        valid = this | ((taken > last_dynamic) & (taken <= frame))
        total += dr.select(valid, dr.select(this, sample, rgb(texel)), 0)
        count += dr.select(valid, mi.Float(1), 0)
    return total / count


def compose(
    s: Settings,
    moving_camera: bool,
    has_history: bool,
    previous: Any,
    samples: Any,
    motion: Any,
    window: Any,
    last_dynamic: Any,
    subframe: Any,
    slot: Any,
    frame: Any,
) -> tuple[Any, Any, Any, Any, Any]:
    """One frame from this frame's samples, their motion, and the last frame.

    Args:
        moving_camera: the camera moved since the last frame: every pixel is dynamic.
        has_history: False at frame 0 and after a cut: every old pixel becomes the mean of its box.
        subframe, slot, frame: n mod 4, (n div 4) mod 4, n + 1 (mi.UInt32, opaque).
        last_dynamic: tiles, mi.UInt32: the frame (as ``frame`` counts) in which each tile was last dynamic.

    Returns:
        (picture, window, last_dynamic, longest motion x, y a tile); ``window`` is written in place.
    """
    tile = dr.arange(mi.UInt32, s.tiles_x * s.tiles_y)
    tile_y = tile // s.tiles_x
    tile_x = tile - tile_y * s.tiles_x
    mx, my = tile_motion(motion, tile_x, tile_y, s)
    static = mi.Bool(False)
    if not moving_camera and has_history:
        static = mx * mx + my * my < STATIC_PX * STATIC_PX
    last_dynamic = dr.select(static, last_dynamic, frame)
    new = _new_samples(samples, tile_x, tile_y, subframe, s)
    own = fetch(samples, tile)
    _, _, new_x, new_y = new[0, 0]
    sample, order = rgb(own), own.w
    if not moving_camera and has_history:
        own_pixel = mi.UInt32(new_y * s.width + new_x)
        averaged = _window_mean(window, own_pixel, sample, slot, frame, last_dynamic)
        store(window, sample, dr.reinterpret_array(mi.Float, frame), own_pixel * 4 + slot, static)
        sample = dr.select(static, averaged, sample)

    picture = dr.zeros(mi.Float, s.width * s.height * 4)
    for dy in (0, 1):
        for dx in (0, 1):
            px, py = mi.Int32(tile_x) * 2 + dx, mi.Int32(tile_y) * 2 + dy
            exists = (px < s.width) & (py < s.height)
            is_new = (px == new_x) & (py == new_y)
            pixel = mi.UInt32(dr.minimum(py, s.height - 1) * s.width + dr.minimum(px, s.width - 1))
            if not has_history:
                mean, _ = _box(previous, new, px, py, dx, dy, s)
                old = from_ycocg(mean)
            elif not s.reproject:
                old = rgb(fetch(previous, pixel))
            else:
                mean, extent = _box(previous, new, px, py, dx, dy, s)
                from_x, from_y = mi.Float(px) + 0.5 - mx, mi.Float(py) + 0.5 - my
                inside = (from_x >= 0) & (from_x <= s.width) & (from_y >= 0) & (from_y <= s.height)
                history = to_ycocg(bilinear(previous, from_x, from_y, s.width, s.height, exists & ~is_new))
                clamped = dr.clip(history, mean - extent, mean + extent)
                old = dr.maximum(from_ycocg(dr.select(inside, clamped, mean)), 0)
                old = dr.select(static, rgb(fetch(previous, pixel, static)), old)
            store(picture, dr.select(is_new, sample, old), order, pixel, exists)
    return picture, window, last_dynamic, mx, my
