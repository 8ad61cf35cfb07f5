"""Orders and the decision function against Eqs. 4 and 5 and a plain float64 oracle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from renderers.backend import activate, mi
from renderers.temporally_dense.pixel_order import BOWTIE, HOURGLASS, coin_flip, decide, pixel_in_tile
from tests.renderers.temporally_dense import oracle

activate()


def decided(decision: str, length: np.ndarray, alpha: np.ndarray, coin: bool = True) -> np.ndarray:
    mx, my = (
        mi.Float((length * np.cos(alpha)).astype(np.float32)),
        mi.Float((length * np.sin(alpha)).astype(np.float32)),
    )
    return np.array(decide(decision, mx, my, mi.Bool(coin)))


@pytest.mark.parametrize("hourglass", [True, False])
def test_each_subframe_traces_the_pixel_of_its_order_value(hourglass: bool) -> None:
    table = HOURGLASS if hourglass else BOWTIE
    column, row = pixel_in_tile(mi.Bool(hourglass), mi.UInt32(np.arange(4, dtype=np.uint32)))
    for k, (x, y) in enumerate(zip(np.array(column), np.array(row), strict=True)):
        assert table[y][x] == k


@pytest.mark.parametrize("decision", ["combined", "up", "down", "dominant"])
def test_horizontal_motion_is_equation_4_and_vertical_equation_5(decision: str) -> None:
    l_f = np.arange(0.02, 1.0, 0.04)  # never on a band edge
    inside = (l_f > 0.25) & (l_f < 0.75)
    np.testing.assert_array_equal(decided(decision, l_f + 2, np.zeros_like(l_f)), inside)
    np.testing.assert_array_equal(decided(decision, l_f + 2, np.full_like(l_f, math.pi / 2)), ~inside)


def test_the_combined_function_is_the_oracles_everywhere() -> None:
    rng = np.random.default_rng(5)
    motion = rng.normal(0, 3, (20_000, 2)).astype(np.float32).astype(float)
    for coin in (True, False):
        got = np.array(
            decide(
                "combined",
                mi.Float(motion[:, 0].astype(np.float32)),
                mi.Float(motion[:, 1].astype(np.float32)),
                mi.Bool(coin),
            )
        )
        wanted = np.array([oracle.hourglass((x, y), coin) for x, y in motion])
        assert np.mean(got != wanted) < 2e-4  # float32 against float64 on the band's very edges


def test_signs_of_the_motion_do_not_matter() -> None:
    x, y = mi.Float([0.3, 1.7]), mi.Float([0.1, 0.2])
    plain = np.array(decide("combined", x, y, mi.Bool(True)))
    for sx, sy in ((-1, 1), (1, -1), (-1, -1)):
        np.testing.assert_array_equal(np.array(decide("combined", x * sx, y * sy, mi.Bool(True))), plain)


def test_no_motion_gives_the_hourglass() -> None:
    assert np.array(decide("combined", mi.Float([0.0]), mi.Float([0.0]), mi.Bool(False)))[0]


def test_the_coin_is_fair_and_new_each_cycle_and_seed() -> None:
    tile = mi.UInt32(np.arange(40_000, dtype=np.uint32))
    flips = np.array(
        [np.array(coin_flip(tile, mi.UInt32(c), mi.UInt32(s))) for c, s in ((0, 0), (1, 0), (0, 1))], float
    )
    z = (flips.mean(1) - 0.5) / (0.5 / math.sqrt(flips.shape[1]))
    assert np.all(np.abs(z) < 4)
    assert np.all(np.abs(np.corrcoef(flips)[np.triu_indices(3, 1)]) < 4 / math.sqrt(flips.shape[1]))
