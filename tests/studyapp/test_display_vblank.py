"""The grid of refreshes: every fault found, none invented."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from protocols.records import FLIP_EARLY, FLIP_LATE, FLIP_PHASE_SLIP
from studyapp.display.vblank import SLIP_CONFIRM, VblankGrid, grid_time_ns, wait_until
from studyapp.display.virtual_display import Fault, VirtualDisplay, random_faults

PERIOD = 1e9 / 240


def test_first_stamp_is_refresh_zero() -> None:
    assert VblankGrid(PERIOD).place(123_456) == (0, 123_456, 0, 0)


def test_regular_stamps_lose_nothing_for_a_million_refreshes() -> None:
    grid = VblankGrid(PERIOD)
    for k in range(0, 1_000_000, 1000):
        assert grid.place(grid_time_ns(10**15, k, Fraction(240)))[0] == k
    assert abs(grid.period_ns - PERIOD) < 1


@pytest.mark.parametrize("lost", [1, 2, 7, 240])
def test_lost_refreshes_are_counted(lost: int) -> None:
    grid = VblankGrid(PERIOD)
    grid.place(0)
    index, due, missed, flags = grid.place(round((lost + 1) * PERIOD))
    assert (index, missed, flags) == (lost + 1, lost, 0)
    assert due == round((lost + 1) * PERIOD)


def test_swap_that_does_not_wait_is_early_and_keeps_its_refresh() -> None:
    grid = VblankGrid(PERIOD)
    grid.place(0)
    index, _, missed, flags = grid.place(round(0.3 * PERIOD))
    assert (index, missed, flags) == (0, 0, FLIP_EARLY)
    assert grid.place(round(PERIOD))[:1] == (1,)


def test_late_stamp_past_the_deadline_is_flagged_and_does_not_move_the_grid() -> None:
    grid = VblankGrid(PERIOD, slack=1.2)
    grid.place(0)
    assert grid.place(round(1.3 * PERIOD))[2:] == (0, FLIP_LATE)
    assert grid.place(round(2 * PERIOD))[2:] == (0, 0)


@pytest.mark.parametrize("slip", [0.2, -0.2, 0.4, -0.4])
def test_lasting_displacement_is_one_slip_and_the_grid_follows(slip: float) -> None:
    grid = VblankGrid(PERIOD)
    flags = [grid.place(round((k + (slip if k >= 5 else 0)) * PERIOD))[3] & FLIP_PHASE_SLIP for k in range(20)]
    assert [k for k, flag in enumerate(flags) if flag] == [5 + SLIP_CONFIRM - 1]


def test_single_late_stamp_is_no_slip() -> None:
    grid = VblankGrid(PERIOD)
    flags = [grid.place(round((k + (0.3 if k in (5, 9) else 0)) * PERIOD))[3] for k in range(20)]
    assert not any(flag & FLIP_PHASE_SLIP for flag in flags)


def test_grid_follows_a_crystal_that_is_off_by_200_ppm() -> None:
    grid = VblankGrid(PERIOD)
    true = PERIOD * (1 + 200e-6)
    placed = [grid.place(round(k * true)) for k in range(20_000)]
    assert [p[0] for p in placed] == list(range(20_000))
    assert not any(p[2] or p[3] for p in placed)
    assert grid.period_ns == pytest.approx(true, rel=5e-6)


@pytest.mark.parametrize("rate", [Fraction(240), Fraction(60000, 1001), Fraction(20), Fraction(1000)])
def test_grid_times_are_exact_after_a_day(rate: Fraction) -> None:
    k = int(86_400 * rate)
    assert grid_time_ns(7, k, rate) == 7 + round(k * 1_000_000_000 / rate)


def test_wait_sleeps_to_the_spin_and_never_returns_early() -> None:
    clock = [0]
    slept: list[float] = []

    def now() -> int:
        clock[0] += 1_000
        return clock[0]

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        clock[0] += round(seconds * 1e9)

    shown = wait_until(4_000_000, now, sleep, spin_ns=400_000)
    assert 4_000_000 <= shown < 4_002_000
    assert sum(slept) == pytest.approx(3.6e-3, rel=1e-2)
    assert wait_until(0, now, sleep, spin_ns=400_000) >= 4_000_000


@pytest.mark.parametrize("jitter", [0.0, 0.02])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_ten_thousand_scripted_refreshes_every_fault_found_none_invented(seed: int, jitter: float) -> None:
    rng = np.random.default_rng(seed)
    faults = random_faults(10_000, rng, miss=0.01, early=0.01, slip=0.005)
    assert {fault.kind for fault in faults.values()} == {"miss", "early", "slip"}
    display = VirtualDisplay(faults=faults, jitter=jitter, rng=rng)
    rows = display.flip_block(10_000)
    assert len(rows) == 10_000
    misses = {swap: int(fault.amount) for swap, fault in faults.items() if fault.kind == "miss"}
    found = {int(swap): int(rows["missed"][swap]) for swap in np.flatnonzero(rows["missed"])}
    assert found == misses
    early = [swap for swap, fault in faults.items() if fault.kind == "early"]
    assert np.flatnonzero(rows["flags"] & FLIP_EARLY).tolist() == early
    slips = [swap for swap, fault in faults.items() if fault.kind == "slip"]
    seen = np.flatnonzero(rows["flags"] & FLIP_PHASE_SLIP)
    assert len(seen) == len(slips)
    # A slip is known to be one by the stamps after it.
    assert all(0 <= late - swap <= 8 for late, swap in zip(seen, slips, strict=True))
    # The index is the raster's own: one a swap, more after a miss, none for an early swap.
    steps = np.ones(10_000, int)
    steps[0] = 0
    for swap, lost in misses.items():
        steps[swap] += lost
    steps[early] = 0
    assert np.array_equal(rows["refresh"], np.cumsum(steps))


def test_block_and_single_swaps_are_the_same() -> None:
    faults = {5: Fault("miss", 2), 9: Fault("early", 0.2), 20: Fault("slip", 0.3)}
    one, many = VirtualDisplay(faults=faults), VirtualDisplay(faults=faults)
    rows = many.flip_block(50)
    for row in rows:
        flip = one.flip()
        assert (flip.index, flip.shown_ns, flip.missed, flip.flags) == (
            row["refresh"], row["shown_ns"], row["missed"], row["flags"],
        )  # fmt: skip
        assert abs(flip.due_ns - row["due_ns"]) <= 1


def test_block_stops_at_the_refresh_asked_for() -> None:
    display = VirtualDisplay(faults={3: Fault("miss", 4)})
    rows = display.flip_block(100, stop_index=10)
    assert rows["refresh"].tolist() == [0, 1, 2, 7, 8, 9]
