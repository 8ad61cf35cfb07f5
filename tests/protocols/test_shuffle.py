from __future__ import annotations

import time

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from protocols.shuffle import constrained_order, violations


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def test_violations_are_counted_where_they_stand() -> None:
    assert violations({"x": list("aaab")}, {"x": 2}, {}) == [2]
    assert violations({"x": list("abcab")}, {}, {"x": 4}) == [3, 4]
    assert violations({"x": list("abab")}, {"x": 1}, {"x": 2}) == []


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 6), st.integers(1, 12), st.integers(1, 3), st.integers(0, 2**32))
def test_constraints_are_kept_and_nothing_is_lost(levels: int, each: int, most: int, seed: int) -> None:
    keys = {"x": [str(i % levels) for i in range(levels * each)], "y": [str(i % 3) for i in range(levels * each)]}
    order = constrained_order(keys, rng(seed), {"x": most}, {})
    assert order is not None
    assert sorted(order) == list(range(levels * each))
    assert violations({"x": [keys["x"][i] for i in order]}, {"x": most}, {}) == []


def test_a_least_distance_is_kept() -> None:
    keys = {"cell": [str(i % 20) for i in range(60)]}
    for seed in range(10):
        order = constrained_order(keys, rng(seed), {}, {"cell": 8})
        assert order is not None
        assert violations({"cell": [keys["cell"][i] for i in order]}, {}, {"cell": 8}) == []


def test_what_cannot_be_met_is_said() -> None:
    assert constrained_order({"x": list("aaaab")}, rng(), {"x": 1}, {}) is None
    assert constrained_order({"x": list("aabb")}, rng(), {}, {"x": 3}) is None


def test_the_same_seed_gives_the_same_order_and_another_one_another() -> None:
    keys = {"x": [str(i % 5) for i in range(50)]}
    first = constrained_order(keys, rng(1), {"x": 2}, {})
    assert first == constrained_order(keys, rng(1), {"x": 2}, {})
    assert first != constrained_order(keys, rng(2), {"x": 2}, {})


def test_without_constraints_every_order_is_equally_likely() -> None:
    counts: dict[tuple[int, ...], int] = {}
    source = rng(3)
    for _ in range(6000):
        order = tuple(constrained_order({"x": list("abc")}, source, {}, {}) or ())
        counts[order] = counts.get(order, 0) + 1
    expected = 1000.0
    chi2 = sum((count - expected) ** 2 / expected for count in counts.values())
    assert len(counts) == 6
    assert chi2 < 20.5  # 99.9 % of chi-square with 5 df


def test_a_thousand_rows_take_less_than_half_a_second() -> None:
    keys = {"x": [str(i % 4) for i in range(1000)], "cell": [str(i % 100) for i in range(1000)]}
    start = time.perf_counter()
    assert constrained_order(keys, rng(), {"x": 2}, {"cell": 10}) is not None
    assert time.perf_counter() - start < 1.0
