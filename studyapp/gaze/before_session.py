"""What a session asks of the eye tracker before its first trial: accuracy, precision, loss, latency."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from protocols.conditions import Gaze
from stimuli.errors import InputError, problem
from studyapp.gaze.angles import ScreenGeometry
from studyapp.gaze.calibration import target_points
from studyapp.gaze.targets import TargetScreen
from studyapp.gaze.validation import validate
from studyapp.seams import Display, GazeSource

VALIDATION_OVERRIDE, LATENCY_OVERRIDE, TRACKER_OVERRIDE = "gaze_validation", "gaze_latency", "gaze_tracker"


def check_gaze(
    limits: Gaze,
    gaze: GazeSource | None,
    display: Display,
    geometry: ScreenGeometry,
    overrides: Mapping[str, str],
    on_target: Callable[[float, float], None] | None = None,
    background: float = 119 / 255,
    calibrate: Callable[[TargetScreen, np.ndarray], None] | None = None,
    eye_to_light: Mapping[str, Any] | None = None,
) -> tuple[dict[str, Any] | None, list[dict[str, str]]]:
    """Validate where the protocol requires gaze; (measures, overrides that were needed).

    ``calibrate`` is called first, with the screen and its targets. (None, []) where it requires none. On the virtual
    display, whose clock is not the tracker's, nothing can be validated: only the tracker's presence is checked.
    ``eye_to_light``: what was measured of it (`studyapp.gaze.eye_to_light`), held against the same limit as the
    newest sample's age. Raises InputError for every limit that is missed without its override.
    """
    if not limits.required:
        return None, []
    used: list[dict[str, str]] = []
    problems: list[str] = []

    def need(check: str, lines: list[str]) -> None:
        if lines and overrides.get(check, "").strip():
            used.append({"check": check, "reason": overrides[check]})
        else:
            problems.extend(f"{line} (or --override {check}=REASON)" for line in lines)

    measures = None
    if gaze is None:
        need(TRACKER_OVERRIDE, [problem("gaze", "eye tracker", "none in the lab file", "one, as the protocol asks")])
    elif display.stamp_class != "virtual":
        screen = TargetScreen(display, geometry, background)
        try:
            if calibrate is not None:
                calibrate(screen, target_points(limits.points))
            found = validate(screen, gaze, geometry, target_points(limits.points), on_target)
        finally:
            screen.close()
        measures = {**found.as_dict(), "eye_to_light": None if eye_to_light is None else dict(eye_to_light)}
        need(VALIDATION_OVERRIDE, found.failures(limits))
        late = {"age at flip (p95)": found.age_p95_ms}
        if eye_to_light is not None:
            late["eye to light (p95)"] = float(eye_to_light["p95_ms"])
        wanted = f"at most {limits.latency_p95_ms:g} ms"
        need(
            LATENCY_OVERRIDE,
            [
                problem("gaze", what, f"{value:.1f} ms", wanted)
                for what, value in late.items()
                if not value <= limits.latency_p95_ms
            ],
        )
    if problems:
        raise InputError(*problems)
    return measures, used
