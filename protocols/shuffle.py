"""Random orders that keep constraints: no more than n alike in a row, a least distance between equals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

PLAIN_STARTS, GREEDY_STARTS = 2, 24
SWEEPS = 40
TRIES = 40
PLAIN_BUDGET, GREEDY_BUDGET = 2500, 250  # swaps tried from one start (and 10 a row): about a second in all
GREEDY_UP_TO = 300


def violations(keys: Mapping[str, Sequence[str]], longest: Mapping[str, int], distance: Mapping[str, int]) -> list[int]:
    """Places at which a run is longer than ``longest[key]`` or an equal stands fewer than ``distance[key]`` places
    before. ``keys``: name of a column -> its values in order."""
    bad: set[int] = set()
    for name, most in longest.items():
        run = 1
        for place, (before, now) in enumerate(pairwise(keys[name]), 1):
            run = run + 1 if before == now else 1
            if run > most:
                bad.add(place)
    for name, least in distance.items():
        last: dict[str, int] = {}
        for place, value in enumerate(keys[name]):
            if value in last and place - last[value] < least:
                bad.add(place)
            last[value] = place
    return sorted(bad)


def constrained_order(
    keys: Mapping[str, Sequence[str]],
    rng: np.random.Generator,
    longest: Mapping[str, int],
    distance: Mapping[str, int],
) -> list[int] | None:
    """A random permutation of the rows of ``keys`` that keeps the constraints; None where none was found.

    A plain shuffle, repaired by swaps that lower the number of violations; started anew where that gets stuck, the
    later starts from a greedy order that places the most frequent values first.
    """
    n = len(next(iter(keys.values()))) if keys else 0
    used = {name: list(keys[name]) for name in {*longest, *distance}}
    if any(_impossible(used[name], most) for name, most in longest.items()):
        return None
    reach = max([most + 1 for most in longest.values()] + list(distance.values()), default=1)
    for start in range(PLAIN_STARTS + (GREEDY_STARTS if n <= GREEDY_UP_TO else 0)):
        plain = start < PLAIN_STARTS
        order = [int(i) for i in rng.permutation(n)] if plain else _greedy(used, rng, longest, distance, n)
        budget = PLAIN_BUDGET + 10 * n if plain else GREEDY_BUDGET
        if not used or _repair(order, used, rng, longest, distance, reach, budget):
            return order
    return None


def _impossible(values: Sequence[str], most: int) -> bool:
    """True where one value is so frequent that a run longer than ``most`` cannot be avoided."""
    counts = {value: values.count(value) for value in set(values)}
    top = max(counts.values(), default=0)
    return top > most * (len(values) - top + 1)


def _repair(
    order: list[int],
    used: Mapping[str, list[str]],
    rng: np.random.Generator,
    longest: Mapping[str, int],
    distance: Mapping[str, int],
    reach: int,
    budget: int,
) -> bool:
    """Swap rows in place until nothing is violated; False where it gets stuck or the budget of swaps is spent."""
    n = len(order)

    def around(places: tuple[int, int]) -> int:
        """Violations in windows around the two places (enough to compare before and after a swap)."""
        total = 0
        (a, b) = sorted(places)
        spans = [(a - reach, a + reach + 1), (b - reach, b + reach + 1)]
        if spans[0][1] >= spans[1][0]:
            spans = [(spans[0][0], spans[1][1])]
        for low, high in spans:
            part = order[max(low, 0) : min(high, n)]
            columns = {name: [values[i] for i in part] for name, values in used.items()}
            total += len(violations(columns, longest, distance))
        return total

    for _ in range(SWEEPS):
        columns = {name: [values[i] for i in order] for name, values in used.items()}
        bad = violations(columns, longest, distance)
        if not bad:
            return True
        for place in bad:
            for other in rng.integers(0, n, TRIES):
                budget -= 1
                if budget <= 0:
                    return False
                before = around((place, int(other)))
                order[place], order[other] = order[other], order[place]
                if around((place, int(other))) < before:
                    break
                order[place], order[other] = order[other], order[place]
    return False


def _greedy(
    used: Mapping[str, list[str]],
    rng: np.random.Generator,
    longest: Mapping[str, int],
    distance: Mapping[str, int],
    n: int,
) -> list[int]:
    """Row after row: among those that keep the constraints, one whose values are most frequent among what is left."""
    left = [int(i) for i in rng.permutation(n)]
    counts = {name: {value: values.count(value) for value in set(values)} for name, values in used.items()}
    order: list[int] = []
    while left:
        recent = {name: [values[i] for i in order[-40:]] for name, values in used.items()}

        def fits(row: int, recent: Mapping[str, list[str]] = recent) -> bool:
            for name, most in longest.items():
                if len(recent[name]) >= most and all(v == used[name][row] for v in recent[name][-most:]):
                    return False
            for name, least in distance.items():
                if least > 1 and used[name][row] in recent[name][max(0, len(recent[name]) - least + 1) :]:
                    return False
            return True

        allowed = [row for row in left if fits(row)] or left
        row = max(allowed, key=lambda row: sum(counts[name][values[row]] for name, values in used.items()))
        left.remove(row)
        order.append(row)
        for name, values in used.items():
            counts[name][values[row]] -= 1
    return order
