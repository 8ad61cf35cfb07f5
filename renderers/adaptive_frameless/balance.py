"""How many tiles there are to be, and the moves towards equal error after a chunk (Dayal et al. 2005, 4 and 4.1)."""

from __future__ import annotations

import math

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers, Settings
from renderers.adaptive_frameless.compiled import inlined, uncounted
from renderers.adaptive_frameless.tiling import can_split, find_errors, merge, move_epoch, split, sum_errors

ERRORS_EVERY = 16
"""Chunks between two sums of all tiles' errors, which normalise them; more where there are many tiles to sum."""


@uncounted
def wanted_tiles(b: Buffers, s: Settings, now_s: float) -> int:
    """The number of tiles at which dC/ds * S = i * dC/dt * T (section 4.1): S the tiles' width, T the mean age."""
    total = b.total
    if total[c.G] <= 0 or b.number[c.ENTRIES] == 0:
        return s.least_tiles
    over_space = (total[c.GGX] + total[c.GGY]) / (2.0 * total[c.G])
    over_time = total[c.GGT] / total[c.GTW] if total[c.GTW] > 0 else 0.0
    age_s = now_s - total[c.TIMES] / b.number[c.ENTRIES]
    wide = s.gain * over_time * max(age_s, 0.0)
    if wide <= 0 or over_space <= 0:
        return s.most_tiles if wide <= 0 else s.least_tiles
    tiles = s.width * s.height * (over_space / wide) ** 2
    return int(min(max(tiles, s.least_tiles), s.most_tiles))


@uncounted
def worst_tile(b: Buffers, s: Settings) -> int:
    """The tile of largest error that can be split, -1 where none can."""
    best, found, tiles = -1.0, -1, b.number[c.LEAVES]
    for block in range((tiles + c.BLOCK - 1) // c.BLOCK):
        if b.leaf_stale[block]:
            top, place = -1.0, -1
            for k in range(block * c.BLOCK, min((block + 1) * c.BLOCK, tiles)):
                if b.error[k] > top and can_split(b, s, b.leaves[k]):
                    top, place = b.error[k], k
            b.leaf_best[block], b.leaf_stale[block] = place, False
        place = b.leaf_best[block]
        if place >= 0 and b.error[place] > best:
            best, found = b.error[place], b.leaves[place]
    return found


@inlined
def summed_error(b: Buffers, node: int) -> float:
    """Of the two tiles under ``node``."""
    n = b.node_i[node]
    return b.error[b.node_i[n[c.LEFT], c.PLACE]] + b.error[b.node_i[n[c.RIGHT], c.PLACE]]


@uncounted
def calmest_pair(b: Buffers) -> int:
    """The parent of the two tiles with the least summed error, -1 where no two tiles have one parent."""
    best, found, pairs = math.inf, -1, b.number[c.PAIRS]
    for block in range((pairs + c.BLOCK - 1) // c.BLOCK):
        if b.pair_stale[block]:
            least, place = math.inf, -1
            for k in range(block * c.BLOCK, min((block + 1) * c.BLOCK, pairs)):
                both = summed_error(b, b.pairs[k])
                if both < least:
                    least, place = both, k
            b.pair_best[block], b.pair_stale[block] = place, False
        place = b.pair_best[block]
        if place >= 0:
            both = summed_error(b, b.pairs[place])
            if both < best:
                best, found = both, b.pairs[place]
    return found


@uncounted
def adjust(b: Buffers, s: Settings, now_s: float) -> None:
    """After a chunk: move towards the wanted number of tiles, and split the worst and merge the calmest pair."""
    move_epoch(b, s, now_s)
    find_errors(b, s)
    if b.number[c.CHUNKS] % max(ERRORS_EVERY, b.number[c.LEAVES] // 32) == 0:
        sum_errors(b, s)
    b.number[c.CHUNKS] += 1
    b.number[c.TARGET] = wanted_tiles(b, s, now_s)
    for _ in range(s.moves):
        few, many = b.number[c.LEAVES] < b.number[c.TARGET], b.number[c.LEAVES] > b.number[c.TARGET]
        worst = -1 if many else worst_tile(b, s)
        calmest = -1 if few else calmest_pair(b)
        if few and worst >= 0:
            split(b, s, worst)
        elif many and calmest >= 0:
            merge(b, s, calmest)
        elif worst >= 0 and calmest >= 0:
            even = b.error[b.node_i[worst, c.PLACE]] <= summed_error(b, calmest)
            if even or b.node_i[worst, c.PARENT] == calmest:
                return
            merge(b, s, calmest)
            split(b, s, worst)
        else:
            return
