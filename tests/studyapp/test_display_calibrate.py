"""The lock check: what is accepted, what is refused, and that the reason is said."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest

from stimuli.errors import InputError
from studyapp.display.calibrate import fit_period, why_not_locked
from studyapp.display.certificate import Certificate, certify, require_lock
from studyapp.display.virtual_display import Fault, VirtualDisplay

NOMINAL = Fraction(240)
T = 1e9 / 240
K = np.arange(960)


def reasons(stamps: np.ndarray) -> tuple[str, ...]:
    return why_not_locked(fit_period(np.asarray(stamps).round().astype(np.int64), T), NOMINAL)


def test_true_raster_is_locked_and_its_period_found() -> None:
    noise = np.random.default_rng(0).normal(0, 0.01 * T, 960)
    fit = fit_period((10**12 + K * T * 1.002 + noise).astype(np.int64), T)
    assert why_not_locked(fit, NOMINAL) == ()
    assert abs(fit.period_ns - 1.002 * T) < 4 * fit.period_se_ns
    assert fit.residual_sd_ns == pytest.approx(0.01 * T, rel=0.1)
    # Standard error of a slope: sd / sqrt(sum (k - mean)^2).
    assert fit.period_se_ns == pytest.approx(fit.residual_sd_ns / np.sqrt(np.sum((K - K.mean()) ** 2)), rel=1e-2)


def test_single_late_stamps_are_rejected_from_the_fit() -> None:
    stamps = K * T
    stamps[100:110] += 0.3 * T
    fit = fit_period(stamps.astype(np.int64), T)
    assert fit.outliers == 10
    assert fit.period_ns == pytest.approx(T, rel=1e-7)


def test_wandering_phase_is_refused_though_its_interval_sd_is_small() -> None:
    intervals = T + np.random.default_rng(1).normal(0, 0.025 * T, 960)
    fit = fit_period(np.cumsum(intervals).astype(np.int64), T)
    assert fit.interval_sd_ns < 0.05 * T
    said = why_not_locked(fit, NOMINAL)
    assert len(said) == 1
    assert said[0].startswith("wandering phase: residual SD")


def test_lying_rate_and_wandering_phase_are_both_named() -> None:
    intervals = 1.2 * T + np.random.default_rng(1).normal(0, 0.025 * T, 960)
    said = "; ".join(reasons(np.cumsum(intervals)))
    assert "rate: nominal 240 Hz, measured 200" in said
    assert "wandering phase" in said


def test_lost_refresh_is_refused() -> None:
    assert reasons(np.delete(K, 400) * T) == ("lost: 1 refreshes in 959",)


def test_no_vblank_is_refused_in_those_words() -> None:
    assert reasons(K * 0.02 * T)[0].startswith("no vblank: 959 of 959 swaps did not wait")


def test_rate_limit_is_one_percent() -> None:
    assert reasons(K * T * 1.009) == ()
    assert reasons(K * T * 1.012)[0].startswith("rate:")


@pytest.mark.parametrize("rate", [20, 60, 1000])
def test_any_rate_from_20_to_1000_hz_can_be_locked(rate: int) -> None:
    fit = fit_period(np.round(K * 1e9 / rate).astype(np.int64), 1e9 / rate)
    assert why_not_locked(fit, Fraction(rate)) == ()


def test_display_that_counts_itself_keeps_its_numbers_through_late_stamps() -> None:
    stamps = K * T
    stamps[300] += 0.7 * T  # its process woke late; no refresh was lost
    fit = fit_period(stamps.astype(np.int64), T, numbers=K)
    assert (fit.lost, fit.fell_through, fit.outliers) == (0, 0, 1)


def test_too_few_stamps() -> None:
    with pytest.raises(ValueError, match="n >= 3"):
        fit_period(np.array([1, 2]), T)


def test_certificate_of_the_virtual_display() -> None:
    certificate = certify(VirtualDisplay())
    assert certificate.locked
    assert certificate.stamp_class == "virtual"
    assert certificate.onset == "onset by software stamp"
    assert certificate.settings["vrr"] == "not declared"
    data = json.loads(certificate.to_json())
    keys = {"locked", "reason", "nominal_hz", "measured_hz", "residual_sd_ms", "lost", "stamp_class"}
    assert keys <= data.keys()


def test_certificate_of_a_display_that_loses_refreshes_in_every_try() -> None:
    faults = {swap: Fault("miss", 1) for swap in range(100, 3000, 400)}
    certificate = certify(VirtualDisplay(faults=faults))
    assert not certificate.locked
    assert certificate.attempts == 3
    assert "lost:" in certificate.reason
    json.loads(certificate.to_json())


def test_busy_machine_gets_a_second_try() -> None:
    certificate = certify(VirtualDisplay(faults={100: Fault("miss", 1)}))
    assert certificate.locked
    assert certificate.attempts == 2


def test_certificate_needs_480_refreshes() -> None:
    with pytest.raises(InputError, match="at least 480"):
        certify(VirtualDisplay(), refreshes=479)


def _certificate(locked: bool, stamp_class: str, hz: float = 240.0) -> Certificate:
    return Certificate(
        locked, "" if locked else "wandering phase: residual SD 3 ms", 240.0, hz, 1e9 / hz, 0.0, 0, 0.0, 0.0, 0, 0, 480,
        1, stamp_class, "clock", "a display", (1, 1),
    )  # fmt: skip


def test_run_is_refused_when_not_locked_unless_overridden_by_name() -> None:
    certificate = _certificate(False, "software")
    with pytest.raises(InputError, match=r"wandering phase.*--override display_lock=REASON"):
        require_lock(certificate, NOMINAL, {})
    with pytest.raises(InputError, match="display_lock"):
        require_lock(certificate, NOMINAL, {"display_lock": "  "})
    used = require_lock(certificate, NOMINAL, {"display_lock": "soak test", "other": "unused"})
    assert used == [{"check": "display_lock", "reason": "soak test"}]


def test_display_locked_at_another_rate_is_refused() -> None:
    with pytest.raises(InputError, match=r"locked at 120\.00 Hz"):
        require_lock(_certificate(True, "hardware", 120.0), NOMINAL, {})


@pytest.mark.parametrize("stamp_class", ["timer", "virtual"])
def test_timer_and_virtual_stamps_are_for_simulated_observers(stamp_class: str) -> None:
    certificate = _certificate(True, stamp_class)
    assert require_lock(certificate, NOMINAL, {}, simulated=True) == []
    with pytest.raises(InputError, match="stamp_class"):
        require_lock(certificate, NOMINAL, {})
    assert require_lock(_certificate(True, "hardware"), NOMINAL, {}) == []
