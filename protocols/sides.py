"""Which condition stands where: as balanced as the counts allow, within one participant and over neighbours."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

SLOTS = {
    ("two_interval", 2): ("first", "second"),
    ("side_by_side", 2): ("left", "right"),
    ("forced_choice", 2): ("left", "right"),
    ("forced_choice", 3): ("left", "centre", "right"),
    ("forced_choice", 4): ("top_left", "top_right", "bottom_left", "bottom_right"),
}


def placements(
    sets: Sequence[tuple[str, ...]], cells: Sequence[str], slot: int, rng: np.random.Generator
) -> list[tuple[str, ...]]:
    """For each trial the members of its set in the order of the slots.

    ``sets``: the conditions of each trial; ``cells``: the name of its cell; ``slot``: participant number, whose parity
    mirrors every pair; ``rng``: must be the same for both participants of a couple (1, 2), (3, 4), ... Two trials of
    one cell have opposite sides; beyond that every condition is left as often as right, give or take one (an
    orientation along Euler circuits). Sets of n > 2 go round their n rotations.
    """
    out: list[tuple[str, ...]] = [()] * len(sets)
    waiting: dict[tuple[str, tuple[str, ...]], int] = {}
    edges: list[int] = []
    partner: dict[int, int] = {}
    turns: dict[tuple[str, ...], int] = defaultdict(lambda: int(rng.integers(0, 1000)))
    for index, members in enumerate(sets):
        if len(members) != 2:
            # The reference of a rotation is the set's own order; slot moves everybody by one.
            shift = (turns[members] + slot) % max(len(members), 1)
            turns[members] += 1
            out[index] = members[shift:] + members[:shift]
            continue
        key = (cells[index], members)
        if key in waiting:
            partner[index] = waiting.pop(key)
        else:
            waiting[key] = index
    edges = sorted(waiting.values())
    flipped = slot % 2 == 0
    for index, first in zip(edges, _orientation([sets[index] for index in edges], rng), strict=True):
        out[index] = sets[index] if first == flipped else sets[index][::-1]
    for index, other in partner.items():
        side = bool(rng.integers(0, 2)) == flipped
        out[other] = sets[other] if side else sets[other][::-1]
        out[index] = out[other][::-1]
    return out


def _orientation(pairs: Sequence[tuple[str, ...]], rng: np.random.Generator) -> list[bool]:
    """True where a pair keeps its written order; every item is first as often as second, give or take one."""
    names = sorted({name for pair in pairs for name in pair})
    touching: dict[str, list[tuple[int, str]]] = {name: [] for name in names}
    for edge in rng.permutation(len(pairs)):
        a, b = pairs[edge]
        touching[a].append((int(edge), b))
        touching[b].append((int(edge), a))
    # Items with an odd number of trials are joined in twos, so that closed walks use every edge.
    odd = [name for name in names if len(touching[name]) % 2]
    odd = [odd[i] for i in rng.permutation(len(odd))]
    for extra, (a, b) in enumerate(zip(odd[::2], odd[1::2], strict=True), len(pairs)):
        touching[a].append((extra, b))
        touching[b].append((extra, a))
    keeps: dict[int, bool] = {}
    for start in [names[i] for i in rng.permutation(len(names))]:
        here = start
        while touching[here]:
            edge, there = touching[here].pop()
            if edge in keeps:
                continue
            keeps[edge] = edge >= len(pairs) or pairs[edge][0] == here
            here = there
    return [keeps[edge] for edge in range(len(pairs))]
