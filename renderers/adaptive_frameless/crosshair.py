"""Crosshairs: five samples one pixel apart and one made earlier at the same place, and the gradients they show.

Dayal et al. 2005, section 4.1 and Fig. 4; projections are the sampler's own, on the host, at each visit's time.
"""

from __future__ import annotations

import math

import numpy as np

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers
from renderers.adaptive_frameless.compiled import inlined

ARMS = ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))
"""Offsets in pixels of the left, right, upper and lower sample."""
LEAST_AGE_S = 1e-3
"""A shorter time between two samples shows no gradient over time worth having."""
_LEAST_ARM_PX = 0.25


@inlined
def blended(knots: np.ndarray, span_s: float, time_s: float, out: np.ndarray) -> None:
    """Write the (3, 4) pose at ``time_s`` (after t1, so not positive) between the knots (K, 3, 4) to ``out``."""
    last = len(knots) - 1
    place = (min(max(time_s / span_s, 0.0), 1.0) if span_s != 0 else 0.0) * -last + last
    low = min(int(place), last - 1)
    share = place - low
    for i in range(3):
        for j in range(4):
            out[i, j] = knots[low, i, j] * (1.0 - share) + knots[low + 1, i, j] * share


@inlined
def moved(pose: np.ndarray, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A point of own space through a (3, 4) pose."""
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


@inlined
def projected(camera: np.ndarray, lens: np.ndarray, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Tracer point -> (x, y) in pixels and its depth (not positive: behind the eye, then x and y mean nothing)."""
    ax, ay, az = x - camera[0, 3], y - camera[1, 3], z - camera[2, 3]
    right = camera[0, 0] * ax + camera[1, 0] * ay + camera[2, 0] * az
    up = camera[0, 1] * ax + camera[1, 1] * ay + camera[2, 1] * az
    depth = -(camera[0, 2] * ax + camera[1, 2] * ay + camera[2, 2] * az)
    if depth <= 1e-9:
        return 0.0, 0.0, -1.0
    scale = 1.0 / (depth * lens[3])
    return lens[1] + right * scale, lens[2] - up * scale, depth


@inlined
def spatial_gradients(b: Buffers, entry: int) -> None:
    """G_x, G_y of a crosshair with arms of one pixel: mean absolute differences of luma to both sides, per pixel."""
    e = b.entry_f[entry]
    e[c.GX] = 0.5 * (abs(e[c.LUMA] - e[c.LUMA + 1]) + abs(e[c.LUMA] - e[c.LUMA + 2]))
    e[c.GY] = 0.5 * (abs(e[c.LUMA] - e[c.LUMA + 3]) + abs(e[c.LUMA] - e[c.LUMA + 4]))


@inlined
def moved_gradients(b: Buffers, entry: int, x: np.ndarray, y: np.ndarray) -> None:
    """G_x, G_y of a crosshair whose five samples now lie at ``x``, ``y`` (5,): differences over their new distances.

    An arm counts for the axis along which it now lies more; where no arm lies along an axis its gradient stays.
    """
    e = b.entry_f[entry]
    sum_x, sum_y, arms_x, arms_y = 0.0, 0.0, 0, 0
    for k in range(1, 5):
        dx, dy = x[k] - x[0], y[k] - y[0]
        far = max(math.sqrt(dx * dx + dy * dy), _LEAST_ARM_PX)
        change = abs(e[c.LUMA] - e[c.LUMA + k]) / far
        if abs(dx) >= abs(dy):
            sum_x += change
            arms_x += 1
        else:
            sum_y += change
            arms_y += 1
    if arms_x:
        e[c.GX] = sum_x / arms_x
    if arms_y:
        e[c.GY] = sum_y / arms_y


@inlined
def temporal_gradient(luma: float, time_s: float, earlier_luma: float, earlier_s: float) -> float:
    """G_t: the absolute difference over the time between two samples of one place; -1 where they are simultaneous."""
    passed = abs(time_s - earlier_s)
    return abs(luma - earlier_luma) / passed if passed >= LEAST_AGE_S else -1.0
