"""The display certificate: what was measured, what is declared, and whether a study may run on it."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from math import isfinite
from typing import Any

from stimuli.errors import InputError, problem
from studyapp.clock import wall_clock_utc
from studyapp.display.calibrate import (
    FALL_THROUGH_SHARE,
    REFRESHES,
    RESIDUAL_LIMIT,
    fit_period,
    measure,
    why_not_locked,
)
from studyapp.present.frame_loop import undisturbed
from studyapp.seams import Display

LOCK_OVERRIDE = "display_lock"
STAMP_OVERRIDE = "stamp_class"
SOFTWARE_ONSET = "onset by software stamp"
UNDECLARED = "not declared"
ATTEMPTS = 3
DECLARABLE = ("bit_depth", "dithering", "scaling", "vrr", "strobing", "overdrive")


@dataclass(frozen=True)
class Certificate:
    """Everything about the display that stands in every session's header (``as_dict``)."""

    locked: bool
    reason: str
    nominal_hz: float
    measured_hz: float
    period_ns: float
    period_se_ns: float | None
    phase_ns: int
    residual_sd_ms: float | None
    interval_sd_ms: float
    lost: int
    outliers: int
    refreshes: int
    attempts: int
    stamp_class: str
    stamp_source: str
    display: str
    size_px: tuple[int, int]
    warnings: tuple[str, ...] = ()
    encoding: str = "sRGB"
    background_code: int = 119
    settings: Mapping[str, str] = field(default_factory=dict)
    onset: str = SOFTWARE_ONSET
    light: Mapping[str, Any] | None = None
    photometry: Mapping[str, Any] | None = None
    eye_to_light: Mapping[str, Any] | None = None
    priority: str = "normal"
    machine: str = ""
    measured_utc: str = ""

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)

    def to_json(self) -> str:
        """One JSON object, without nan (absent numbers are null)."""
        return json.dumps(self.as_dict(), indent=2, allow_nan=False)


def certify(
    display: Display,
    refreshes: int = REFRESHES,
    declared: Mapping[str, str] | None = None,
    encoding: str = "sRGB",
    light: Mapping[str, Any] | None = None,
    photometry: Mapping[str, Any] | None = None,
    nominal_hz: Fraction | None = None,
    background_code: int = 119,
    priority: str = "normal",
    eye_to_light: Mapping[str, Any] | None = None,
) -> Certificate:
    """Measure ``display`` over ``refreshes`` swaps (at least 480; three tries) and judge it against its nominal rate.

    ``declared``: what the lab file says of bit depth, dithering, scaling, VRR, strobing and overdrive; what the system
    itself tells (bit depth) goes before it. A display that can use the measured period is told it.
    """
    if refreshes < REFRESHES:
        raise InputError(problem("certificate", "refreshes", refreshes, f"at least {REFRESHES}"))
    nominal = display.nominal_hz if nominal_hz is None else nominal_hz
    nominal_ns = float(1_000_000_000 / nominal)
    # As Psychtoolbox does: a busy machine gets another try, and the certificate says how many it took.
    attempts = 0
    while True:
        attempts += 1
        with undisturbed():
            stamps, numbers = measure(display, refreshes)
        fit = fit_period(stamps, nominal_ns, numbers)
        reasons = why_not_locked(fit, nominal)
        if not reasons or attempts == ATTEMPTS or fit.fell_through > FALL_THROUGH_SHARE * refreshes:
            break
    use_period = getattr(display, "use_period", None)
    if use_period is not None and isfinite(fit.residual_sd_ns):
        use_period(fit.period_ns, fit.residual_sd_ns > RESIDUAL_LIMIT * fit.period_ns)
    return Certificate(
        locked=not reasons,
        reason="; ".join(reasons) or "locked",
        nominal_hz=float(nominal),
        measured_hz=1e9 / fit.period_ns,
        period_ns=fit.period_ns,
        period_se_ns=_finite(fit.period_se_ns),
        phase_ns=fit.phase_ns,
        residual_sd_ms=_finite(fit.residual_sd_ns / 1e6),
        interval_sd_ms=fit.interval_sd_ns / 1e6,
        lost=fit.lost,
        outliers=fit.outliers,
        refreshes=fit.refreshes,
        attempts=attempts,
        stamp_class=display.stamp_class,
        stamp_source=str(getattr(display, "stamp_source", display.stamp_class)),
        display=display.description,
        size_px=(display.size_px[0], display.size_px[1]),
        warnings=tuple(getattr(display, "warnings", ())),
        encoding=encoding,
        background_code=background_code,
        settings=_settings(display, declared or {}),
        onset=SOFTWARE_ONSET if light is None else "onset by light sensor",
        light=light,
        photometry=photometry,
        eye_to_light=eye_to_light,
        priority=priority,
        machine=f"{platform.system()} {platform.release()} {platform.machine()}",
        measured_utc=wall_clock_utc(),
    )


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None


def _settings(display: Display, declared: Mapping[str, str]) -> dict[str, str]:
    """What the system tells, else what the lab declares, else that nobody said."""
    settings = {name: str(declared.get(name, UNDECLARED)) for name in DECLARABLE}
    bits = getattr(display, "bits_per_channel", None)
    if bits:
        settings["bit_depth"] = f"{bits} (system)"
    return settings


def require_lock(
    certificate: Certificate, rate_hz: Fraction, overrides: Mapping[str, str], simulated: bool = False
) -> list[dict[str, str]]:
    """Refuse to run on a display that is not locked at the protocol's refresh ``rate_hz``.

    ``overrides``: check name -> reason. Returns the overrides that were needed, as they stand in the session's header
    ([{check, reason}]). `timer` and `virtual` stamps need the simulated observer or the override 'stamp_class'.
    Raises InputError naming every reason.
    """
    used: list[dict[str, str]] = []
    problems: list[str] = []

    def need(check: str, what: str, got: str, wanted: str) -> None:
        if overrides.get(check, "").strip():
            used.append({"check": check, "reason": overrides[check]})
        else:
            problems.append(problem("display", what, got, f"{wanted} (or --override {check}=REASON)"))

    # A virtual display is locked by definition, its rate is the one it was opened with.
    at_rate = abs(certificate.measured_hz / float(rate_hz) - 1) <= 0.01
    if not certificate.locked or not at_rate:
        reason = certificate.reason if not certificate.locked else f"locked at {certificate.measured_hz:.2f} Hz"
        need(LOCK_OVERRIDE, "lock", reason, f"a display locked at {float(rate_hz):g} Hz")
    if certificate.stamp_class in ("timer", "virtual") and not simulated:
        need(STAMP_OVERRIDE, "stamps", certificate.stamp_class, "hardware or software stamps for a person")
    if problems:
        raise InputError(*problems)
    return used
