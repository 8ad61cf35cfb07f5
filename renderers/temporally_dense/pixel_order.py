"""Which pixel of a 2x2 tile is traced when: the hourglass and bowtie orders and the function that chooses between them.

Paper: Andersson et al. 2019, sections 3.1.1 and 3.2.3, Figs. 4 and 10. The adaptive choice by the length fraction and
the angle of a tile's motion is claimed by US patents 11,089,320 and 11,120,609 (NVIDIA): research use is customary,
other use is a question for a lawyer.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from renderers.backend import dr, mi

HOURGLASS = ((0, 1), (2, 3))
"""order[row][column]: TL, TR, BL, BR (two horizontal edges, two diagonals)."""
BOWTIE = ((0, 2), (1, 3))
"""TL, BL, TR, BR: the transpose."""
GAMMA_RAD = math.pi / 40
"""Half width of the band about 45 degrees in which the order is drawn at random (section 3.2.3)."""
STATIC_JITTER = ((0.375, 0.125), (0.875, 0.375), (0.125, 0.625), (0.625, 0.875))
"""Sample positions in a static pixel, one a cycle: the standard 4x multisampling positions (Fig. 4, right)."""


def pixel_in_tile(hourglass: Any, subframe: Any) -> tuple[Any, Any]:
    """(column, row) in {0, 1} of the pixel whose order value is ``subframe`` (0..3), for Dr.Jit arrays.

    Subframes 0 and 3 are TL and BR in both orders; 1 and 2 swap.
    """
    middle = dr.select(hourglass, subframe, 3 - subframe)  # as the hourglass counts: 1 = TR, 2 = BL
    first_or_last = (subframe == 0) | (subframe == 3)
    index = dr.select(first_or_last, subframe, middle)
    return index & 1, index >> 1


def fraction(x: Any) -> Any:
    """x - floor(x), Dr.Jit or numpy."""
    return x - (np.floor(x) if isinstance(x, np.ndarray) else dr.floor(x))


def _band_up(l_f: Any, alpha: Any) -> Any:
    """Fig. 10, middle left: equals Eq. 4 at alpha 0 and Eq. 5 at pi/2; the band's centre moves from 0.5 to 1."""
    s = fraction(l_f - alpha * (1 / math.pi))
    return (s > 0.25) & (s < 0.75)


def _band_down(l_f: Any, alpha: Any) -> Any:
    """Fig. 10, middle right: the same ends, the band's centre moves from 0.5 to 0. Closed bounds above 45 degrees."""
    s = fraction(l_f + alpha * (1 / math.pi) - 0.5)
    return ~((s > 0.25) & (s < 0.75))


def _dominant(l_f: Any, alpha: Any) -> Any:
    """Fig. 10, left: Eq. 4 below 45 degrees, Eq. 5 from there on."""
    inside = (l_f > 0.25) & (l_f < 0.75)
    return (inside & (alpha < math.pi / 4)) | (~inside & (alpha >= math.pi / 4))


def decide(decision: str, motion_x: Any, motion_y: Any, coin: Any) -> Any:
    """True where a tile shall use the hourglass order for its next four frames.

    Args:
        decision: 'combined' (the paper's, Fig. 10 right), 'up', 'down' or 'dominant' (Fig. 10 from the left).
        motion_x, motion_y: the tile's longest motion in pixels a frame, Dr.Jit floats.
        coin: random booleans for the band |alpha - 45 degrees| < pi / 40 of 'combined'.
    """
    length = dr.sqrt(motion_x * motion_x + motion_y * motion_y)
    l_f = fraction(length)
    alpha = dr.select(length > 0, dr.atan2(dr.abs(motion_y), dr.abs(motion_x)), 0)
    if decision == "up":
        chosen = _band_up(l_f, alpha)
    elif decision == "down":
        chosen = _band_down(l_f, alpha)
    elif decision == "dominant":
        chosen = _dominant(l_f, alpha)
    else:
        ordered = dr.select(alpha < math.pi / 4, _band_up(l_f, alpha), _band_down(l_f, alpha))
        chosen = dr.select(dr.abs(alpha - math.pi / 4) < GAMMA_RAD, coin, ordered)
    return chosen | (length == 0)  # no direction: hourglass


def coin_flip(tile: Any, cycle: Any, seed: Any) -> Any:
    """One fair random bit a tile and cycle: PCG's output hash of both and the seed (mi.UInt32 each)."""
    state = (tile ^ (cycle * mi.UInt32(0x9E3779B9)) ^ (seed * mi.UInt32(0x85EBCA6B))) * mi.UInt32(
        747796405
    ) + 2891336453
    word = ((state >> ((state >> 28) + 4)) ^ state) * mi.UInt32(277803737)
    return ((word >> 22) ^ word) & 1 == 0
