"""Light against flips: the offset is found through the logger's drifting clock, and lost light is told."""

from __future__ import annotations

import numpy as np
import pytest

from protocols.records import FLIP_DTYPE, FLIP_LIGHT_PATCH
from stimuli.errors import InputError
from studyapp.display.choose import open_display
from studyapp.light_sensor import Emulator, LightEdge, Logger, compare, measure_light, parse_lines

T = 1e9 / 240


def run(missed: dict[int, int], latency_ms: float = 3.0, drift_ppm: float = 40.0, n: int = 400, sd_ms: float = 0.02):
    """Rows of a patch that toggles each swap, and the edges a logger would send."""
    rows = np.zeros(n, FLIP_DTYPE)
    steps = np.ones(n, int)
    for swap, lost in missed.items():
        steps[swap] += lost
    rows["refresh"] = np.cumsum(steps)
    rows["shown_ns"] = 10**9 + np.round(rows["refresh"] * T).astype(np.int64)
    rows["flags"] = np.where(np.arange(n) % 2 == 0, FLIP_LIGHT_PATCH, 0)
    rng = np.random.default_rng(0)
    light = rows["shown_ns"] + latency_ms * 1e6 + rng.normal(0, sd_ms * 1e6, n)
    device = np.round((light - 10**9) * (1 + drift_ppm * 1e-6) / 1000).astype(int) + 777
    edges = [LightEdge(int(us), place % 2 == 0) for place, us in enumerate(device)]
    return rows, edges, (777, 10**6)


@pytest.mark.parametrize("drift", [-50.0, 0.0, 50.0])
def test_flip_to_light_is_found_through_a_drifting_clock(drift: float) -> None:
    rows, edges, moment = run({}, 3.0, drift)
    result = compare(rows, edges, moment, T)
    assert result.mean_ms == pytest.approx(3.0, abs=0.01)
    assert result.sd_ms == pytest.approx(0.02, rel=0.15)
    assert result.drift_ppm == pytest.approx(drift, abs=5)
    assert (result.light_missed, result.recorded_missed, result.agreeing) == (0, 0, True)


def test_misses_by_light_and_by_record_agree() -> None:
    rows, edges, moment = run({50: 1, 200: 3})
    result = compare(rows, edges, moment, T)
    assert (result.light_missed, result.recorded_missed, result.agreeing) == (4, 4, True)


def test_miss_that_was_not_recorded_is_told() -> None:
    rows, edges, moment = run({50: 1})
    rows["refresh"] = np.arange(len(rows))
    result = compare(rows, edges, moment, T)
    assert (result.light_missed, result.recorded_missed, result.agreeing) == (1, 0, False)


def test_light_that_does_not_follow_is_refused() -> None:
    rows, edges, moment = run({})
    with pytest.raises(InputError, match="edges: got 399, wanted 400"):
        compare(rows, edges[1:], moment, T)
    swapped = [LightEdge(edge.device_us, not edge.on) for edge in edges]
    with pytest.raises(InputError, match="wrong kind"):
        compare(rows, swapped, moment, T)
    with pytest.raises(InputError, match="flip to light"):
        compare(rows, [LightEdge(e.device_us + 10**6, e.on) for e in edges], moment, T)


def test_lines_of_other_events_and_noise_are_no_edges() -> None:
    edges, rest, other = parse_lines(b"12:PD\r\n13:M1\r\n\xff\xfe:PD\n-4:PD\n14:pd\n99999999999999999999:PD\n15:P")
    assert edges == [LightEdge(12, True), LightEdge(14, False)]
    assert (rest, other) == (b"15:P", 4)


def test_emulated_sensor_on_the_off_screen_display() -> None:
    display = open_display("offscreen", (64, 64), 240)
    result = measure_light(display, "emulated", toggles=120)
    display.close()
    assert result["edges"] == 120
    assert result["mean_ms"] == pytest.approx(3.0, abs=1.0)
    # Where a busy machine stamps a refresh more than half of one late, its light counts as that of the next.
    assert result["light_missed"] == pytest.approx(result["recorded_missed"], abs=4)


def test_emulator_that_loses_light_is_noticed() -> None:
    emulator = Emulator(lose=frozenset([5]))
    logger = Logger(emulator.port, emulator.answer)
    device, session = logger.synchronise(3)
    assert device > 0 < session
    for flip in range(8):
        emulator.see(session * 1000 + flip * 4_000_000, flip % 2 == 0)
    assert len(logger.edges()) == 6
    logger.close()
    emulator.close()


def test_missing_port_is_named() -> None:
    with pytest.raises(InputError, match="light sensor: port"):
        measure_light(open_display("offscreen", (16, 16), 240), "/dev/nothing-here", toggles=10)
