"""The clock model finds offset and drift under jitter, from each kind of evidence."""

from __future__ import annotations

import numpy as np
import pytest

from studyapp.devices.clock_model import ClockModel

TRUE_OFFSET_NS, TRUE_DRIFT_PPM = 7_123_456_789_012, 50.0


def true_ns(device_s: np.ndarray) -> np.ndarray:
    return device_s * 1e9 * (1 + TRUE_DRIFT_PPM * 1e-6) + TRUE_OFFSET_NS


def worst_error_ms(model: ClockModel, device_s: np.ndarray) -> float:
    fit = model.fit()
    assert fit is not None
    return float(np.abs(fit.session_ns_many(device_s) - true_ns(device_s)).max() * 1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_50_ppm_and_3_ms_of_symmetric_jitter_are_recovered_to_0_2_ms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = ClockModel("symmetric", recent=1000)
    device_s = 40_000.0 + np.arange(20_000) * 0.02
    for stamp, host in zip(device_s, true_ns(device_s) + rng.normal(0, 3e6, 20_000), strict=True):
        model.arrival(float(stamp), int(host))
    assert worst_error_ms(model, device_s) < 0.2
    fit = model.fit()
    assert fit is not None
    assert fit.drift_ppm == pytest.approx(50.0, abs=1.0)
    assert 0.01e6 < fit.uncertainty_ns < 0.2e6


@pytest.mark.parametrize("seed", range(5))
def test_50_ppm_and_3_ms_of_transport_delay_are_recovered_to_0_2_ms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = ClockModel("one_sided", fixed_delay_ns=0.5e6, recent=500)
    device_s = 3.0 + np.arange(6000) * 0.1
    delay_ns = 0.5e6 + rng.exponential(3e6, 6000)
    for stamp, host in zip(device_s, true_ns(device_s) + delay_ns, strict=True):
        model.arrival(float(stamp), int(host))
    assert worst_error_ms(model, device_s) < 0.2


@pytest.mark.parametrize("seed", range(5))
def test_50_ppm_and_3_ms_of_round_trip_jitter_are_recovered_to_0_2_ms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = ClockModel("round_trip")
    device_s = 10.0 + np.arange(600) * 0.5
    there_ns, back_ns = 0.05e6 + rng.exponential(3e6, 600), 0.05e6 + rng.exponential(3e6, 600)
    for stamp, there, back in zip(device_s, there_ns, back_ns, strict=True):
        at_ns = int(true_ns(np.array([stamp]))[0])
        model.round_trip(float(stamp), at_ns - int(there), at_ns + int(back))
    assert worst_error_ms(model, device_s) < 0.2


def test_outliers_of_a_second_do_not_pull_the_robust_line() -> None:
    rng = np.random.default_rng(0)
    model = ClockModel("symmetric", recent=6000)
    device_s = np.arange(6000) * 0.1
    host = true_ns(device_s) + rng.normal(0, 1e6, 6000)
    host[::50] += 1e9
    for stamp, at in zip(device_s, host, strict=True):
        model.arrival(float(stamp), int(at))
    assert worst_error_ms(model, device_s) < 0.3


@pytest.mark.parametrize("delay", ["round_trip", "one_sided", "symmetric"])
def test_little_evidence_gives_an_offset_without_drift(delay: str) -> None:
    model = ClockModel(delay)  # type: ignore[arg-type]
    assert model.fit() is None
    model.round_trip(5.0, 6_000_000_000, 6_000_000_000)
    model.arrival(float("nan"), 3)
    fit = model.fit()
    assert fit is not None
    assert fit.n == 1
    assert fit.drift_ppm == 0
    assert fit.session_ns(5.0) == 6_000_000_000
    model.round_trip(5.0, 6_000_000_000, 6_000_000_000)
    again = model.fit()
    assert again is not None
    assert again.session_ns(6.0) == 7_000_000_000


def test_memory_is_bounded_by_the_seconds_not_by_the_samples() -> None:
    model = ClockModel("one_sided", recent=100)
    for index in range(20_000):
        model.arrival(index / 2000, index * 500_000)
    assert len(model) < 250
