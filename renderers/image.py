"""Operations on pictures inside Dr.Jit kernels: packed fetches, bilinear filtering, YCoCg, variance boxes.

A picture is a flat `mi.Float` of H * W * 4 floats (RGB and one spare channel), row 0 at the top.
"""

from __future__ import annotations

from typing import Any

from renderers.backend import dr, mi


def fetch(picture: Any, index: Any, active: Any = True) -> Any:
    """The four channels at pixel ``index`` (mi.UInt32), one packed load: `mi.Vector4f`."""
    return dr.gather(mi.Vector4f, picture, index, active)


def rgb(texel: Any) -> Any:
    """The first three channels of a `mi.Vector4f` as `mi.Color3f`."""
    return mi.Color3f(texel.x, texel.y, texel.z)


def store(picture: Any, value: Any, spare: Any, index: Any, active: Any = True) -> None:
    """Write a colour and the spare channel at pixel ``index``, one packed store."""
    dr.scatter(picture, mi.Vector4f(value[0], value[1], value[2], spare), index, active)


def display_encoded(color: Any, exposure: Any) -> Any:
    """A linear `mi.Color3f` as the display shows it: sRGB-encoded, in [0, 1]."""
    c = dr.clip(color * exposure, 0, 1)
    return dr.select(c <= 0.0031308, 12.92 * c, 1.055 * dr.power(dr.maximum(c, 0.0031308), 1 / 2.4) - 0.055)


def bilinear(picture: Any, x_px: Any, y_px: Any, width: int, height: int, active: Any = True) -> Any:
    """`mi.Color3f` at continuous (x, y) in pixels (centre of the first pixel: 0.5), clamped to the edge."""
    gx = dr.clip(x_px - 0.5, 0, width - 1)
    gy = dr.clip(y_px - 0.5, 0, height - 1)
    x0 = dr.minimum(mi.UInt32(gx), max(width - 2, 0))
    y0 = dr.minimum(mi.UInt32(gy), max(height - 2, 0))
    fx, fy = gx - mi.Float(x0), gy - mi.Float(y0)
    right, down = (1 if width > 1 else 0), (width if height > 1 else 0)
    corner = y0 * width + x0
    c00 = rgb(fetch(picture, corner, active))
    c10 = rgb(fetch(picture, corner + right, active))
    c01 = rgb(fetch(picture, corner + down, active))
    c11 = rgb(fetch(picture, corner + down + right, active))
    top = dr.fma(c10 - c00, fx, c00)
    bottom = dr.fma(c11 - c01, fx, c01)
    return dr.fma(bottom - top, fy, top)


def to_ycocg(c: Any) -> Any:
    """RGB -> (Y, Cg, Co) as a `mi.Color3f` (Y = R/4 + G/2 + B/4)."""
    return mi.Color3f(0.25 * c.x + 0.5 * c.y + 0.25 * c.z, -0.25 * c.x + 0.5 * c.y - 0.25 * c.z, 0.5 * c.x - 0.5 * c.z)


def from_ycocg(c: Any) -> Any:
    """The inverse of `to_ycocg`."""
    t = c.x - c.y
    return mi.Color3f(t + c.z, c.x + c.y, t - c.z)


def mean_and_deviation(samples: list[tuple[Any, Any]]) -> tuple[Any, Any, Any]:
    """Mean, population standard deviation and number of the active ones of (`mi.Color3f`, active) pairs.

    Two passes over registers: the one-pass form E[c^2] - mean^2 cancels for bright flat neighbourhoods.
    """
    total, count = mi.Color3f(0), mi.Float(0)
    for value, active in samples:
        total += dr.select(active, value, 0)
        count += dr.select(active, mi.Float(1), 0)
    mean = total / dr.maximum(count, 1)
    squares = mi.Color3f(0)
    for value, active in samples:
        squares += dr.select(active, dr.square(value - mean), 0)
    return mean, dr.sqrt(squares / dr.maximum(count, 1)), count


def clip_towards_centre(value: Any, low: Any, high: Any) -> Any:
    """Pull ``value`` along the line to the box's centre until it is inside (Karis 2014)."""
    centre, extent = (low + high) * 0.5, (high - low) * 0.5 + 1e-7
    offset = value - centre
    ratio = dr.maximum(
        dr.maximum(dr.abs(offset.x / extent.x), dr.abs(offset.y / extent.y)), dr.abs(offset.z / extent.z)
    )
    return dr.select(ratio > 1, centre + offset / ratio, value)


def longest(candidates: list[tuple[Any, Any, Any]]) -> tuple[Any, Any]:
    """Of (x, y, active) vectors the longest active one (the first of equals); (0, 0) where none is active."""
    best_x, best_y, best = mi.Float(0), mi.Float(0), mi.Float(-1)
    for x, y, active in candidates:
        squared = x * x + y * y
        better = active & (squared > best)
        best_x, best_y, best = (
            dr.select(better, x, best_x),
            dr.select(better, y, best_y),
            dr.select(better, squared, best),
        )
    return best_x, best_y


def catmull_rom(picture: Any, x_px: Any, y_px: Any, width: int, height: int, active: Any = True) -> Any:
    """`mi.Color3f` at continuous (x, y) by the separable Catmull-Rom cubic over 4x4 pixels, clamped to the edge.

    The same weights as the usual nine bilinear taps; the result may overshoot the pixels' range.
    """
    gx, gy = x_px - 0.5, y_px - 0.5
    x0, y0 = dr.floor(gx), dr.floor(gy)
    columns, rows = _cubic_weights(gx - x0), _cubic_weights(gy - y0)
    total = mi.Color3f(0)
    for j in range(4):
        row = mi.UInt32(dr.clip(y0 + (j - 1), 0, height - 1)) * width
        line = mi.Color3f(0)
        for i in range(4):
            column = mi.UInt32(dr.clip(x0 + (i - 1), 0, width - 1))
            line = dr.fma(rgb(fetch(picture, row + column, active)), columns[i], line)
        total = dr.fma(line, rows[j], total)
    return total


def _cubic_weights(f: Any) -> tuple[Any, Any, Any, Any]:
    """Catmull-Rom weights of the four pixels around a fraction f in [0, 1)."""
    f2, f3 = f * f, f * f * f
    return (
        -0.5 * f3 + f2 - 0.5 * f,
        1.5 * f3 - 2.5 * f2 + 1.0,
        -1.5 * f3 + 2.0 * f2 + 0.5 * f,
        0.5 * f3 - 0.5 * f2,
    )


def neighbours(picture: Any, x: Any, y: Any, width: int, height: int) -> list[Any]:
    """The colours of the 3x3 pixels around integer (x, y), row by row (the fifth is the centre), edges clamped."""
    found = []
    for oy in (-1, 0, 1):
        row = mi.UInt32(dr.clip(y + oy, 0, height - 1)) * width
        found += [rgb(fetch(picture, row + mi.UInt32(dr.clip(x + ox, 0, width - 1)))) for ox in (-1, 0, 1)]
    return found


def longest_of_3x3(motion: Any, x: Any, y: Any, width: int, height: int) -> tuple[Any, Any]:
    """The longest motion vector (flat x, y pairs, one a pixel) of the 3x3 pixels around integer (x, y)."""
    candidates = []
    for oy in (0, -1, 1):
        for ox in (0, -1, 1):
            inside = (x + ox >= 0) & (x + ox < width) & (y + oy >= 0) & (y + oy < height)
            index = mi.UInt32(dr.clip(y + oy, 0, height - 1) * width + dr.clip(x + ox, 0, width - 1))
            vector = dr.gather(mi.Vector2f, motion, index)
            candidates.append((vector.x, vector.y, inside))
    return longest(candidates)
