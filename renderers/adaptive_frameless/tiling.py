"""The tiling: a cut through a K-D tree over the picture, kept so that all tiles have about the same error.

Dayal et al. 2005, sections 4, 4.1 and 6.1. Each tile keeps weighted sums over the crosshairs in its block of the deep
buffer; a weight exp(-decay * age) is kept relative to a common epoch, so that ageing costs nothing. Adding and removing
a crosshair changes one tile; splitting sums a tile's pixels anew; merging adds two tiles. So nothing drifts.
"""

from __future__ import annotations

import math

import numpy as np

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers, Settings
from renderers.adaptive_frameless.compiled import inlined, uncounted

EPOCH_S = 2.0
"""How often the common epoch of the weights moves: weights then span a factor of a thousand at most."""


@inlined
def add_entry(b: Buffers, s: Settings, entry: int, sign: float) -> None:
    """Count (sign 1) or uncount (-1) ``entry`` in the tile of its pixel and in the whole picture's sums."""
    node = b.leaf_of[b.entry_i[entry, c.PIXEL]]
    weight = _weight(b, s, entry)
    _add_to(b, node, entry, weight, sign, True)
    b.number[c.ENTRIES] += int(sign)
    b.total[c.TIMES] += sign * b.entry_t[entry]
    if sign < 0 and b.node_f[node, c.W] < 1e-6 * weight:
        sum_tile(b, s, node)  # what is left weighs so little that the subtraction's rounding would show
    if not b.is_touched[node]:
        b.is_touched[node] = True
        b.touched[b.number[c.TOUCHED]] = node
        b.number[c.TOUCHED] += 1


@inlined
def _weight(b: Buffers, s: Settings, entry: int) -> float:
    return math.exp(s.decay_per_s * (b.entry_t[entry] - b.total[c.EPOCH]))


@inlined
def _add_to(b: Buffers, node: int, entry: int, own_weight: float, sign: float, everywhere: bool) -> None:
    weight = sign * own_weight
    f, e = b.node_f[node], b.entry_f[entry]
    luma, squares = 0.0, 0.0
    for k in range(5):
        value = np.float64(e[c.LUMA + k])
        luma += value
        squares += value * value
    f[c.W] += 5.0 * weight
    f[c.WL] += weight * luma
    f[c.WLL] += weight * squares
    f[c.G] += weight
    f[c.GGX] += weight * e[c.GX]
    f[c.GGY] += weight * e[c.GY]
    f[c.COUNT] += sign
    f[c.HIDDEN] += sign * b.entry_i[entry, c.OCCLUDED]
    if e[c.GT] >= 0:
        f[c.GTW] += weight
        f[c.GGT] += weight * e[c.GT]
    if everywhere:
        b.total[c.G] += weight
        b.total[c.GGX] += weight * e[c.GX]
        b.total[c.GGY] += weight * e[c.GY]
        if e[c.GT] >= 0:
            b.total[c.GTW] += weight
            b.total[c.GGT] += weight * e[c.GT]


@uncounted
def sum_tile(b: Buffers, s: Settings, node: int) -> None:
    """Sum a tile's block of the deep buffer anew."""
    b.node_f[node] = 0.0
    n = b.node_i[node]
    for y in range(n[c.Y0], n[c.Y1]):
        for x in range(n[c.X0], n[c.X1]):
            pixel = y * s.width + x
            for k in range(b.fill[pixel]):
                _add_to(b, node, b.queue[pixel, k], _weight(b, s, b.queue[pixel, k]), 1.0, False)


@uncounted
def move_epoch(b: Buffers, s: Settings, now_s: float) -> None:
    """Bring the weights' epoch to ``now_s`` if it is far behind; the picture's sums are added up anew."""
    passed = now_s - b.total[c.EPOCH]
    if passed < EPOCH_S:
        return
    factor = math.exp(-s.decay_per_s * passed)
    for column in range(c.W, c.GGT + 1):
        b.total[column] = 0.0
    for k in range(b.number[c.LEAVES]):
        f = b.node_f[b.leaves[k]]
        for column in range(c.W, c.GGT + 1):
            f[column] *= factor
            b.total[column] += f[column]
    b.total[c.EPOCH] = now_s


@inlined
def variation(b: Buffers, node: int) -> float:
    """v_tile: the weighted variance of luma in the tile's block; 0 where it is empty."""
    f = b.node_f[node]
    if f[c.W] <= 0:
        return 0.0
    mean = f[c.WL] / f[c.W]
    return max(0.0, f[c.WLL] / f[c.W] - mean * mean)


@inlined
def tile_area(b: Buffers, node: int) -> int:
    """Pixels of a tile."""
    n = b.node_i[node]
    return (n[c.X1] - n[c.X0]) * (n[c.Y1] - n[c.Y0])


@inlined
def undersampling(b: Buffers, s: Settings, node: int) -> float:
    """u_tile: by how much the tile's share of empty places exceeds ``m`` times that of the whole buffer."""
    empty_tile = 1.0 - b.node_f[node, c.COUNT] / (tile_area(b, node) * s.depth)
    empty_buffer = 1.0 - b.number[c.ENTRIES] / (s.width * s.height * s.depth)
    return max(0.0, empty_tile - s.m * empty_buffer)


@inlined
def _terms(b: Buffers, s: Settings, node: int) -> tuple[float, float, float]:
    """Variation, undersampling and occlusions of a tile, each times area ** ``area_power``."""
    area = tile_area(b, node)
    size = float(area) if s.area_power == 1.0 else float(area) ** s.area_power  # a power costs as much as the rest
    hidden = b.node_f[node, c.HIDDEN] / (area * s.depth)
    return variation(b, node) * size, undersampling(b, s, node) * size, hidden * size


@inlined
def tile_error(b: Buffers, s: Settings, node: int) -> float:
    """E_tile from variation, undersampling and occlusions, each over its sum over all tiles when last summed.

    A term whose sum is 0 counts as 0. A millionth of the tile's share of the picture lets the larger of equals split.
    """
    error = 1e-6 * tile_area(b, node) / (s.width * s.height)
    v, u, o = _terms(b, s, node)
    if b.total[c.SUM_V] > 0:
        error += (1.0 - s.kappa - s.lam) * v / b.total[c.SUM_V]
    if b.total[c.SUM_U] > 0:
        error += s.kappa * u / b.total[c.SUM_U]
    if b.total[c.SUM_O] > 0:
        error += s.lam * o / b.total[c.SUM_O]
    return error


@inlined
def _find_error(b: Buffers, s: Settings, node: int) -> None:
    place = b.node_i[node, c.PLACE]
    b.error[place] = tile_error(b, s, node)
    b.leaf_stale[place // c.BLOCK] = True
    parent = b.node_i[node, c.PARENT]
    if parent >= 0 and b.pair_place[parent] >= 0:
        b.pair_stale[b.pair_place[parent] // c.BLOCK] = True


@uncounted
def find_errors(b: Buffers, s: Settings) -> None:
    """Find the errors of the tiles whose sums have changed: once after a chunk, however many changes there were."""
    for k in range(b.number[c.TOUCHED]):
        node = b.touched[k]
        b.is_touched[node] = False
        if b.node_i[node, c.PLACE] >= 0:
            _find_error(b, s, node)
    b.number[c.TOUCHED] = 0


@uncounted
def sum_errors(b: Buffers, s: Settings) -> None:
    """Sum the three terms over all tiles, and refresh every tile's error."""
    v, u, o = 0.0, 0.0, 0.0
    for k in range(b.number[c.LEAVES]):
        own = _terms(b, s, b.leaves[k])
        v, u, o = v + own[0], u + own[1], o + own[2]
    b.total[c.SUM_V], b.total[c.SUM_U], b.total[c.SUM_O] = v, u, o
    for k in range(b.number[c.LEAVES]):
        b.error[k] = tile_error(b, s, b.leaves[k])
    b.leaf_stale[:], b.pair_stale[:] = True, True


@uncounted
def _own(b: Buffers, s: Settings, node: int) -> None:
    n = b.node_i[node]
    for y in range(n[c.Y0], n[c.Y1]):
        b.leaf_of[y * s.width + n[c.X0] : y * s.width + n[c.X1]] = node


@uncounted
def _drop_pair(b: Buffers, node: int) -> None:
    place = b.pair_place[node]
    if place >= 0:
        last = b.pairs[b.number[c.PAIRS] - 1]
        b.pairs[place], b.pair_place[last] = last, place
        b.pair_place[node] = -1
        b.number[c.PAIRS] -= 1
        b.pair_stale[place // c.BLOCK] = b.pair_stale[b.number[c.PAIRS] // c.BLOCK] = True


@uncounted
def _add_pair(b: Buffers, node: int) -> None:
    place = b.number[c.PAIRS]
    b.pairs[place], b.pair_place[node] = node, place
    b.pair_stale[place // c.BLOCK] = True
    b.number[c.PAIRS] += 1


@inlined
def can_split(b: Buffers, s: Settings, node: int) -> bool:
    """Whether both halves of a tile would have at least ``least_tile_px`` pixels."""
    n = b.node_i[node]
    wide, high = n[c.X1] - n[c.X0], n[c.Y1] - n[c.Y0]
    small = (max(wide, high) // 2) * min(wide, high)
    return max(wide, high) >= 2 and small >= s.least_tile_px


@uncounted
def split(b: Buffers, s: Settings, node: int) -> None:
    """Halve a tile across its longer side."""
    n = b.node_i[node]
    if n[c.PARENT] >= 0:
        _drop_pair(b, n[c.PARENT])
    wide = n[c.X1] - n[c.X0] >= n[c.Y1] - n[c.Y0]
    middle = (n[c.X0] + n[c.X1]) // 2 if wide else (n[c.Y0] + n[c.Y1]) // 2
    place = n[c.PLACE]
    for side in range(2):
        b.number[c.FREE_NODES] -= 1
        child = b.free_nodes[b.number[c.FREE_NODES]]
        k = b.node_i[child]
        k[c.X0], k[c.Y0], k[c.X1], k[c.Y1] = n[c.X0], n[c.Y0], n[c.X1], n[c.Y1]
        if wide:
            k[c.X0 if side else c.X1] = middle
        else:
            k[c.Y0 if side else c.Y1] = middle
        k[c.PARENT], k[c.LEFT], k[c.RIGHT] = node, -1, -1
        n[c.LEFT + side] = child
        if side:
            place = b.number[c.LEAVES]
            b.number[c.LEAVES] += 1
        k[c.PLACE], b.leaves[place] = place, child
        b.pair_place[child] = -1
        _own(b, s, child)
        sum_tile(b, s, child)
        # the waiting sample goes to the half in which it lies
        p = b.node_p[node]
        inside = k[c.X0] <= p[c.PX] < k[c.X1] and k[c.Y0] <= p[c.PY] < k[c.Y1]
        for column in range(c.NODE_P):
            b.node_p[child, column] = p[column]
        if not inside:
            b.node_p[child, c.HAS] = 0.0
        _find_error(b, s, child)
    n[c.PLACE] = -1
    _add_pair(b, node)


@uncounted
def merge(b: Buffers, s: Settings, node: int) -> None:
    """Make the two leaves under ``node`` one tile."""
    n = b.node_i[node]
    left, right = n[c.LEFT], n[c.RIGHT]
    for column in range(c.NODE_F):
        b.node_f[node, column] = b.node_f[left, column] + b.node_f[right, column]
    newer = (
        left
        if b.node_p[left, c.HAS] * b.node_p[left, c.PTIME] >= b.node_p[right, c.HAS] * b.node_p[right, c.PTIME]
        or b.node_p[right, c.HAS] == 0
        else right
    )
    for column in range(c.NODE_P):
        b.node_p[node, column] = b.node_p[newer, column]
    # the merged tile takes the left one's place, the last leaf the right one's
    place, gap = b.node_i[left, c.PLACE], b.node_i[right, c.PLACE]
    b.leaves[place], n[c.PLACE] = node, place
    last = b.number[c.LEAVES] - 1
    moved = b.leaves[last]
    b.leaves[gap], b.error[gap] = moved, b.error[last]
    b.node_i[moved, c.PLACE] = gap
    b.leaf_stale[gap // c.BLOCK] = b.leaf_stale[last // c.BLOCK] = True
    b.number[c.LEAVES] = last
    for child in (right, left):
        b.free_nodes[b.number[c.FREE_NODES]] = child
        b.number[c.FREE_NODES] += 1
    n[c.LEFT], n[c.RIGHT] = -1, -1
    _own(b, s, node)
    _drop_pair(b, node)
    parent = n[c.PARENT]
    if parent >= 0:
        other = b.node_i[parent, c.RIGHT] if b.node_i[parent, c.LEFT] == node else b.node_i[parent, c.LEFT]
        if b.node_i[other, c.LEFT] < 0:
            _add_pair(b, parent)
    _find_error(b, s, node)


def even_tiling(b: Buffers, s: Settings) -> None:
    """Halve the largest tiles until there are ``least_tiles`` (as the first fill finds them)."""
    _even(b, s)


@uncounted
def _even(b: Buffers, s: Settings) -> None:
    while b.number[c.LEAVES] < s.least_tiles:
        largest, found = 0, -1
        for k in range(b.number[c.LEAVES]):
            node = b.leaves[k]
            if tile_area(b, node) > largest and can_split(b, s, node):
                largest, found = tile_area(b, node), node
        if found < 0:
            return
        split(b, s, found)


def tile_rectangles(b: Buffers) -> np.ndarray:
    """(tiles, 4) int32: x0, y0, x1, y1 of each tile."""
    return b.node_i[b.leaves[: b.number[c.LEAVES]], :4].copy()
