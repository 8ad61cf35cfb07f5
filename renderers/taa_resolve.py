"""The resolve passes of the two temporal antialiasing forms, as Dr.Jit kernels over whole pictures.

'longest' follows the published description of Falcor's pass (longest motion of 3x3, mean +- sigma box in YCoCg,
anti-flicker weight); 'karis' Karis 2014 (box from two neighbourhoods, clip towards its centre, luminance weights).
Buffers are as in `renderers.image`; motion holds (x, y) pixels a frame for each pixel.
"""

from __future__ import annotations

from typing import Any

from renderers.backend import dr, mi
from renderers.engine import LARGEST
from renderers.image import (
    catmull_rom,
    clip_towards_centre,
    from_ycocg,
    longest_of_3x3,
    mean_and_deviation,
    neighbours,
    store,
    to_ycocg,
)

HALTON_8 = tuple(
    (a / 8, b)
    for a, b in zip(
        (4, 2, 6, 1, 5, 3, 7, 0.5),
        (1 / 3, 2 / 3, 1 / 9, 4 / 9, 7 / 9, 2 / 9, 5 / 9, 8 / 9),
        strict=True,
    )
)
"""Halton(2, 3), elements 1 to 8: sample positions in the pixel, one a frame."""
_PLUS = (1, 3, 4, 5, 7)


def resolve(
    form: str, width: int, height: int, box_sigmas: float, current: Any, motion: Any, history: Any, alpha: Any
) -> Any:
    """The displayed picture (H * W * 4) from this frame's jittered one, its motion and the last displayed one.

    ``alpha``: opaque `mi.Float`, the weight of the new sample.
    """
    index = dr.arange(mi.UInt32, width * height)
    y = mi.Int32(index // width)
    x = mi.Int32(index) - y * width
    mx, my = longest_of_3x3(motion, x, y, width, height)
    from_x, from_y = mi.Float(x) + 0.5 - mx, mi.Float(y) + 0.5 - my
    inside = (from_x >= 0) & (from_x <= width) & (from_y >= 0) & (from_y <= height)
    # the cubic's overshoot beside bright features is below zero: black specks, if it were kept
    before = to_ycocg(dr.maximum(catmull_rom(history, from_x, from_y, width, height, inside), 0))
    near = [to_ycocg(colour) for colour in neighbours(current, x, y, width, height)]
    new = near[4]
    if form == "longest":
        mean, sigma, _ = mean_and_deviation([(colour, mi.Bool(True)) for colour in near])
        low, high = mean - sigma * box_sigmas, mean + sigma * box_sigmas
        # less of the new sample where history is near the box's edge (anti-flicker), before history is clamped
        distance = dr.minimum(dr.abs(low.x - before.x), dr.abs(high.x - before.x))
        weight = dr.clip(alpha * distance / (distance + (high.x - low.x) + 1e-7), 0, 1)
        out = dr.lerp(dr.clip(before, low, high), new, weight)
    else:
        low, high = _mean_box(near)
        clipped = clip_towards_centre(before, low, high)
        w_new, w_old = alpha / (1 + new.x), (1 - alpha) / (1 + clipped.x)
        out = (new * w_new + clipped * w_old) / (w_new + w_old)
    # rounding of the YCoCg transform may leave the range that shading keeps to
    shown = dr.clip(from_ycocg(dr.select(inside, out, new)), 0, LARGEST)
    picture = dr.zeros(mi.Float, width * height * 4)
    store(picture, shown, mi.Float(0), index)
    return picture


def _mean_box(near: list[Any]) -> tuple[Any, Any]:
    """The average of the boxes around the 3x3 and around its five-pixel plus (Karis 2014)."""
    low, high, plus_low, plus_high = near[0], near[0], near[4], near[4]
    for k, colour in enumerate(near):
        low, high = dr.minimum(low, colour), dr.maximum(high, colour)
        if k in _PLUS:
            plus_low, plus_high = dr.minimum(plus_low, colour), dr.maximum(plus_high, colour)
    return (low + plus_low) * 0.5, (high + plus_high) * 0.5
