"""The room of one session: its display, and what is measured of it before anything is shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import date
from fractions import Fraction
from typing import Any

from protocols.study import Study
from protocols.trial import Trial
from renderers.technique import ViewGeometry
from stimuli.errors import InputError
from studyapp import clock
from studyapp.devices.emulators import Emulator
from studyapp.display.certificate import Certificate, require_lock
from studyapp.display.choose import open_display
from studyapp.display.virtual_display import VirtualDisplay
from studyapp.gaze.angles import ScreenGeometry
from studyapp.lab_file import Lab, age_warning, photometry_age_warning
from studyapp.present.admission import UploadBudget, measure_upload
from studyapp.present.overlay import Style, style_on
from studyapp.seams import Display, GazeSource

UPLOAD_OVERRIDE = "upload"
SIMULATED_STEPS = 20
"""Steps of an emulated eye before a simulated session."""


def session_display(kind: str, study: Study, monitor: int | None, start_ns: int | None) -> Display:
    """The display at the protocol's size and rate. ``start_ns``: where the virtual display's clock goes on."""
    rate = Fraction(study.display.refresh_hz)
    if kind == "virtual" and start_ns is not None:
        return VirtualDisplay(study.display.size_px, rate, start_ns=start_ns)
    return open_display(kind, study.display.size_px, rate, monitor)


def lock_overrides(
    study: Study, certificate: Certificate, overrides: Mapping[str, str], simulated: bool
) -> list[dict[str, str]]:
    """The overrides that were needed; InputError where a check fails without one."""
    given = dict(overrides)
    if not study.timing.lock:
        given.setdefault("display_lock", "the protocol does not ask for a locked display")
    return require_lock(certificate, Fraction(study.display.refresh_hz), given, simulated)


def flip_to_light(display: Display, lab: Lab) -> dict[str, Any] | None:
    """Flip to light, measured now, where the lab has a sensor and the display has light."""
    if lab.sensor is None or display.context() is None:
        return None
    from studyapp.light_sensor import measure_light

    return measure_light(display, lab.sensor.port)


def eye_to_light(
    study: Study, lab: Lab, display: Display, gaze: GazeSource | None, eye: Emulator | None
) -> dict[str, Any] | None:
    """Eye to light: the lab file's record; measured now where sensor and ``eye`` are both emulated; else None. None too
    where the protocol requires no gaze."""
    if not study.gaze.required or gaze is None:
        return None
    record = lab.gaze_latency_record()
    if record is not None:
        return record
    if eye is None or lab.sensor is None or lab.sensor.port != "emulated" or display.context() is None:
        return None
    from studyapp.gaze.eye_to_light import measure_eye_to_light

    found = measure_eye_to_light(display, gaze, "emulated", eye.step_to, SIMULATED_STEPS)
    eye.step_to(0.0, clock.now_ns())
    return found


def upload_budget(
    display: Display, trials: Sequence[Trial], overrides: Mapping[str, str]
) -> tuple[UploadBudget | None, list[dict[str, str]]]:
    """What the display takes in, measured with the heaviest of ``trials``, and the override that was needed, if one
    was. Raises InputError where that trial asks for more without the override 'upload'."""
    budget = measure_upload(display, trials)
    problems = [] if budget is None else budget.problems()
    if not problems:
        return budget, []
    reason = overrides.get(UPLOAD_OVERRIDE, "").strip()
    if not reason:
        raise InputError(*[f"{line} (or --override {UPLOAD_OVERRIDE}=REASON)" for line in problems])
    return budget, [{"check": UPLOAD_OVERRIDE, "reason": reason}]


def budget_record(budget: UploadBudget) -> dict[str, Any]:
    """The budget as the session keeps it, JSON-ready."""
    return {**asdict(budget), "limit_bytes_s": budget.limit_bytes_s}


def room_warnings(study: Study, lab: Lab, certificate: Certificate) -> list[str]:
    """What the experimenter should hear of before a session: old measurements, and what the display warns of.

    Of the protocol's and the lab's age limits the shorter counts.
    """
    today = date.fromisoformat(clock.wall_clock_utc()[:10])
    limit = float(study.timing.photometry_max_age_days)
    if lab.photometry is not None:
        limit = min(limit, lab.photometry.max_age_days)
    found = [photometry_age_warning(lab.photometry_record(), limit, today)]
    latency = lab.gaze_latency_record() if study.gaze.required else None
    if latency is not None and lab.gaze_latency is not None:
        found.append(age_warning("eye to light", latency, lab.gaze_latency.max_age_days, today))
    elif study.gaze.required and lab.sensor is not None and lab.sensor.port != "emulated":
        found.append("eye to light was never measured (studyapp display --sensor PORT --eye DEVICE)")
    return [*(warning for warning in found if warning is not None), *certificate.warnings]


def screen_of(study: Study, lab: Lab, display: Display) -> ScreenGeometry:
    """The screen as gaze and pictures stand on it."""
    view = view_geometry(study, lab)
    return ScreenGeometry(view.width_m, view.height_m, view.distance_m, display.size_px)


def view_geometry(study: Study, lab: Lab) -> ViewGeometry:
    """The lab's screen; the protocol's where there is no lab file."""
    if lab.path is not None:
        return lab.display.geometry
    wide, high = study.display.panel_m(study.display.size_px)
    return ViewGeometry(wide, high, study.display.distance_m)


def session_style(study: Study, lab: Lab) -> Style:
    """The protocol's background, letters that can be read on it, and the light patch where the lab has its sensor."""
    corner = "lower_left" if lab.sensor is None else lab.sensor.patch_corner
    return style_on(round(255 * study.display.background), corner)
