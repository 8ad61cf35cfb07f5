"""Octahedral maps: directions on a square, with a border of one texel so that bilinear look-ups cross its folds.

After Majercik et al. 2019 (JCGT 8(2)), section 3. A map of n x n texels is stored as (n + 2) x (n + 2).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from renderers.backend import dr, mi


def _sign(x: Any) -> Any:
    return dr.select(x >= 0, mi.Float(1), mi.Float(-1))


def encode(d: Any) -> tuple[Any, Any]:
    """A direction (any length but 0) -> (x, y) in [-1, 1]."""
    inverse = dr.rcp(dr.abs(d.x) + dr.abs(d.y) + dr.abs(d.z))
    x, y = d.x * inverse, d.y * inverse
    folded = d.z < 0
    return (
        dr.select(folded, (1 - dr.abs(y)) * _sign(x), x),
        dr.select(folded, (1 - dr.abs(x)) * _sign(y), y),
    )


def decode(x: Any, y: Any) -> Any:
    """(x, y) in [-1, 1] -> unit direction."""
    z = 1 - dr.abs(x) - dr.abs(y)
    folded = z < 0
    return dr.normalize(
        mi.Vector3f(
            dr.select(folded, (1 - dr.abs(y)) * _sign(x), x), dr.select(folded, (1 - dr.abs(x)) * _sign(y), y), z
        )
    )


def texel_direction(texel: Any, n: int) -> Any:
    """Direction of the interior texel number ``texel`` (row * n + column)."""
    row = texel // n
    column = texel - row * n
    return decode((mi.Float(column) + 0.5) * (2 / n) - 1, (mi.Float(row) + 0.5) * (2 / n) - 1)


def padded_index(texel: Any, n: int) -> Any:
    """Where the interior texel ``texel`` stands in the stored map."""
    row = texel // n
    return (row + 1) * (n + 2) + (texel - row * n) + 1


def border_sources(n: int) -> tuple[np.ndarray, np.ndarray]:
    """(4 n + 4,) stored indices of the border texels, and of the interior texels that they repeat."""
    side = n + 2
    border, source = [], []
    for y in range(side):
        for x in range(side):
            if 0 < x <= n and 0 < y <= n:
                continue
            row_edge, column_edge = y in (0, n + 1), x in (0, n + 1)
            if row_edge and column_edge:
                sx, sy = (n if x == 0 else 1), (n if y == 0 else 1)
            elif row_edge:
                sx, sy = n + 1 - x, (1 if y == 0 else n)
            else:
                sx, sy = (1 if x == 0 else n), n + 1 - y
            border.append(y * side + x)
            source.append(sy * side + sx)
    return np.array(border, np.uint32), np.array(source, np.uint32)


def look_up(kind: Any, maps: Any, number: Any, d: Any, n: int, active: Any = True) -> Any:
    """The value (``kind``: a vector type) of map ``number`` in direction ``d``, bilinear."""
    x, y = encode(d)
    side = n + 2
    gx, gy = ((v * 0.5 + 0.5) * n + 0.5 for v in (x, y))
    x0, y0 = (dr.minimum(mi.UInt32(v), n) for v in (gx, gy))
    fx, fy = gx - mi.Float(x0), gy - mi.Float(y0)
    corner = number * (side * side) + y0 * side + x0
    c00, c10, c01, c11 = (dr.gather(kind, maps, corner + step, active) for step in (0, 1, side, side + 1))
    return dr.lerp(dr.lerp(c00, c10, fx), dr.lerp(c01, c11, fx), fy)
