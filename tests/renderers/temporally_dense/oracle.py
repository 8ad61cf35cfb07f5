"""The final frame generation of Andersson et al. 2019 (section 3.2) in plain float64 loops: slow and obvious."""

from __future__ import annotations

import math

import numpy as np

ORDER = {True: ((0, 1), (2, 3)), False: ((0, 2), (1, 3))}
TO_YCOCG = np.array([[0.25, 0.5, 0.25], [-0.25, 0.5, -0.25], [0.5, 0.0, -0.5]])
FROM_YCOCG = np.linalg.inv(TO_YCOCG)


def traced_pixel(tile_x: int, tile_y: int, hourglass: bool, subframe: int, width: int, height: int) -> tuple[int, int]:
    """The pixel of a tile whose order value is ``subframe``; at an odd edge the nearest inside one."""
    for row in (0, 1):
        for column in (0, 1):
            if ORDER[hourglass][row][column] == subframe:
                return min(2 * tile_x + column, width - 1), min(2 * tile_y + row, height - 1)
    raise AssertionError(subframe)


def hourglass(motion: tuple[float, float], coin: bool) -> bool:
    """Fig. 10, right, from the notes: Eq. 4 at 0 degrees, Eq. 5 at 90, linear bands between, random about 45."""
    length = math.hypot(*motion)
    if length == 0:
        return True
    l_f = length - math.floor(length)
    alpha = math.atan2(abs(motion[1]), abs(motion[0]))
    if abs(alpha - math.pi / 4) < math.pi / 40:
        return coin
    if alpha < math.pi / 4:
        s = (l_f - alpha / math.pi) % 1.0
        return 0.25 < s < 0.75
    s = (l_f + alpha / math.pi - 0.5) % 1.0
    return not 0.25 < s < 0.75


def longest_of_3x3(motion: np.ndarray, x: int, y: int) -> np.ndarray:
    """The longest vector of the 3x3 entries around (x, y); motion is (rows, columns, 2)."""
    rows, columns, _ = motion.shape
    near = [
        motion[j, i] for j in range(max(y - 1, 0), min(y + 2, rows)) for i in range(max(x - 1, 0), min(x + 2, columns))
    ]
    return max(near, key=lambda m: m[0] ** 2 + m[1] ** 2)


def bilinear(picture: np.ndarray, x: float, y: float) -> np.ndarray:
    """(H, W, 3) at continuous pixels, clamped to the edge."""
    height, width, _ = picture.shape
    gx, gy = min(max(x - 0.5, 0), width - 1), min(max(y - 0.5, 0), height - 1)
    x0, y0 = min(int(gx), max(width - 2, 0)), min(int(gy), max(height - 2, 0))
    x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
    fx, fy = gx - x0, gy - y0
    top = picture[y0, x0] * (1 - fx) + picture[y0, x1] * fx
    bottom = picture[y1, x0] * (1 - fx) + picture[y1, x1] * fx
    return top * (1 - fy) + bottom * fy


def compose_dynamic(
    previous: np.ndarray | None,
    samples: np.ndarray,
    motion: np.ndarray,
    orders: np.ndarray,
    subframe: int,
    size: tuple[int, int],
) -> np.ndarray:
    """One frame in which every pixel is dynamic; ``previous`` None: no history. samples (rows, columns, 3)."""
    width, height = size
    rows, columns = orders.shape
    new = {}
    for ty in range(rows):
        for tx in range(columns):
            new[traced_pixel(tx, ty, bool(orders[ty, tx]), subframe, width, height)] = samples[ty, tx]
    out = np.zeros((height, width, 3))
    for y in range(height):
        for x in range(width):
            if (x, y) in new:
                out[y, x] = new[x, y]
                continue
            near = [new[i, j] for j in (y - 1, y, y + 1) for i in (x - 1, x, x + 1) if (i, j) in new]
            box = np.array(near) @ TO_YCOCG.T
            mean, sigma = box.mean(0), box.std(0)
            m = longest_of_3x3(motion, x // 2, y // 2)
            px, py = x + 0.5 - m[0], y + 0.5 - m[1]
            if previous is None or not (0 <= px <= width and 0 <= py <= height):
                colour = mean
            else:
                colour = np.clip(TO_YCOCG @ bilinear(previous, px, py), mean - sigma, mean + sigma)
            out[y, x] = np.maximum(FROM_YCOCG @ colour, 0) if previous is not None else FROM_YCOCG @ colour
    return out
