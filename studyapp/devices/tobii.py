"""Tobii trackers through the Tobii Pro SDK: optional (extra ``tobii``), since its library is proprietary.

Without the library, any Tobii tracker works through LSL. The SDK stamps samples on a clock of this machine
(``system_time_stamp``, microseconds), which is asked for once a second.
"""

from __future__ import annotations

import importlib
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from studyapp.clock import now_ns
from studyapp.devices.clock_model import ClockFit, ClockModel
from studyapp.devices.device import Batch, DeviceGone, DeviceSpec, mapped_gaze, silence_limit_s

HELD = 1 << 14  # samples between two polls; the oldest fall out beyond (3 s at 5 kHz)
EYES = (("left", 1), ("right", 2))


def combine_eyes(datum: Mapping[str, Any]) -> tuple[float, float, float, bool, int]:
    """(x, y in 0..1 from the top left, pupil mm, valid, eye: 0 both, 1 left, 2 right) of one gaze datum; the mean of
    the eyes that are valid, nan where none is."""
    points, pupils, seen = [], [], []
    for name, code in EYES:
        if datum.get(f"{name}_gaze_point_validity") == 1:
            points.append(datum[f"{name}_gaze_point_on_display_area"])
            seen.append(code)
        if datum.get(f"{name}_pupil_validity") == 1:
            pupils.append(datum[f"{name}_pupil_diameter"])
    pupil = float(np.mean(pupils)) if pupils else float("nan")
    if not points:
        return float("nan"), float("nan"), pupil, False, 0
    x, y = (float(value) for value in np.mean(points, axis=0))
    return x, y, pupil, bool(np.isfinite([x, y]).all()), 0 if len(seen) == 2 else seen[0]


class TobiiPro:
    """A `Device`. ``spec.port``: the tracker's address or serial number ('': the first that is found); the lab file
    must give the screen, and the display area must be set up in Tobii's own manager."""

    descriptor: int | None = None

    def __init__(self, spec: DeviceSpec) -> None:
        if spec.screen is None:
            raise DeviceGone("tobii: needs the screen's size and distance (lab file: display)")
        self._spec, self._screen = spec, spec.screen
        try:
            self._sdk: Any = importlib.import_module("tobii_research")
        except ImportError as error:
            wanted = "install studyapp[tobii], or send its gaze through LSL"
            raise DeviceGone(f"tobii: the library tobii_research is not installed ({wanted})") from error
        found = [t for t in self._sdk.find_all_eyetrackers() if spec.port in ("", t.address, t.serial_number)]
        if not found:
            raise DeviceGone(f"tobii: no tracker {spec.port or 'at all'}")
        self._tracker = found[0]
        self._waiting: deque[tuple[Mapping[str, Any], int]] = deque(maxlen=HELD)
        self._clock = ClockModel("round_trip")
        self._fit: ClockFit | None = None
        self._asked_ns = 0
        self._last_ns = now_ns()
        self._calibration: Any = None
        self._tracker.subscribe_to(self._sdk.EYETRACKER_GAZE_DATA, self._came, as_dictionary=True)

    def _came(self, datum: Mapping[str, Any]) -> None:
        """Called on a thread of the SDK (this is the reader's process: it delays no refresh)."""
        self._waiting.append((datum, now_ns()))

    def poll(self) -> Batch:
        self._ask_time()
        rows = []
        while self._waiting:
            datum, host_ns = self._waiting.popleft()
            self._last_ns = host_ns
            x, y, pupil, valid, eye = combine_eyes(datum)
            x_dva, y_dva = self._screen.to_dva(x, y)
            device_s = datum["system_time_stamp"] * 1e-6
            rows.append((device_s, host_ns, host_ns, float(x_dva), float(y_dva), pupil, valid, eye))
        if not rows and now_ns() - self._last_ns > silence_limit_s(self._spec) * 1e9:
            raise DeviceGone(f"tobii {self._spec.port}: silent for {(now_ns() - self._last_ns) * 1e-9:.2f} s")
        return Batch(gaze=mapped_gaze(rows, self._fit))

    def _ask_time(self) -> None:
        asked_ns = now_ns()
        if asked_ns - self._asked_ns < self._clock.ask_again_ns:
            return
        self._asked_ns = asked_ns
        device_s = self._sdk.get_system_time_stamp() * 1e-6
        self._clock.round_trip(device_s, asked_ns, now_ns())
        self._fit = self._clock.fit()

    def fit(self) -> ClockFit | None:
        return self._fit

    def calibrate(self, step: str, points: np.ndarray) -> dict[str, Any] | None:
        """Host-paced (see `studyapp.gaze.calibrate`): begin, one point at a time while it is looked at, finish."""
        if step == "begin":
            self._calibration = self._sdk.ScreenBasedCalibration(self._tracker)
            self._calibration.enter_calibration_mode()
            return {"paced": "host"}
        if self._calibration is None:
            return {"failed": "no calibration is under way"}
        if step == "point":
            x, y = (float(value) for value in points[0])
            # A second try, as the SDK's own example does: the eye may have blinked.
            for _ in range(2):
                status = self._calibration.collect_data(x, y)
                if status == self._sdk.CALIBRATION_STATUS_SUCCESS:
                    return {"collected": [x, y]}
            return {"failed": f"no gaze at target {x:.2f}, {y:.2f}"}
        calibration, self._calibration = self._calibration, None
        result = calibration.compute_and_apply() if step == "finish" else None
        calibration.leave_calibration_mode()
        self._last_ns = now_ns()
        if result is None:
            return None
        good = result.status == self._sdk.CALIBRATION_STATUS_SUCCESS
        return {"result": {"status": str(result.status)}} if good else {"failed": str(result.status)}

    def close(self) -> None:
        self._tracker.unsubscribe_from(self._sdk.EYETRACKER_GAZE_DATA, self._came)
