"""EyeLink trackers through SR Research's pylink: optional (extra ``eyelink``), since its library is proprietary.

The tracker is calibrated on its own host computer (or by `studyapp.gaze.calibrate` with ``calibrate: map``). Pupil
sizes are in the tracker's own unit and are therefore not kept as millimetres.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from studyapp.clock import now_ns
from studyapp.devices.clock_model import ClockFit, ClockModel
from studyapp.devices.device import Batch, DeviceGone, DeviceSpec, mapped_gaze, silence_limit_s

DEFAULT_PORT = "100.1.1.1"
MISSING = -32768.0
"""What the tracker says for a coordinate that it does not have."""


def sample_point(sample: Any) -> tuple[float, float, bool, int]:
    """(x, y in pixels, valid, eye: 0 both, 1 left, 2 right) of a link sample; the mean of the eyes that have one."""
    points = []
    eyes = ((1, sample.isLeftSample, sample.getLeftEye), (2, sample.isRightSample, sample.getRightEye))
    for code, asked, given in eyes:
        if asked() or sample.isBinocular():
            x, y = given().getGaze()
            if x != MISSING and y != MISSING:
                points.append((code, float(x), float(y)))
    if not points:
        return float("nan"), float("nan"), False, 0
    x, y = np.mean([point[1:] for point in points], axis=0)
    return float(x), float(y), True, 0 if len(points) == 2 else points[0][0]


class EyeLink:
    """A `Device`. ``spec.port``: the host's address (default 100.1.1.1); option ``edf``: also record to a file of that
    name on the host (at most 8 letters). Screen pixels are those of the lab file's display."""

    descriptor: int | None = None

    def __init__(self, spec: DeviceSpec) -> None:
        if spec.screen is None:
            raise DeviceGone("eyelink: needs the screen's size and distance (lab file: display)")
        self._spec, self._screen = spec, spec.screen
        self._address = spec.port or DEFAULT_PORT
        try:
            self._sdk: Any = importlib.import_module("pylink")
        except ImportError as error:
            wanted = "install studyapp[eyelink], or send its gaze through LSL"
            raise DeviceGone(f"eyelink: the library pylink is not installed ({wanted})") from error
        width, height = spec.screen.size_px
        try:
            self._tracker = self._sdk.EyeLink(self._address)
            self._tracker.sendCommand(f"screen_pixel_coords = 0 0 {width - 1} {height - 1}")
            self._tracker.sendCommand("link_sample_data = LEFT,RIGHT,GAZE,AREA,STATUS")
            self._edf = str(spec.options.get("edf", ""))
            if self._edf:
                self._tracker.openDataFile(self._edf)
            # To the host's file only where one is open; samples over the link always.
            refused = self._tracker.startRecording(bool(self._edf), bool(self._edf), 1, 0)
        except RuntimeError as failed:
            raise DeviceGone(f"eyelink {self._address}: {failed}") from failed
        if refused:
            raise DeviceGone(f"eyelink {self._address}: recording did not start (error {refused})")
        self._clock = ClockModel("round_trip")
        self._fit: ClockFit | None = None
        self._asked_ns = 0
        self._last_ns = now_ns()

    def poll(self) -> Batch:
        rows = []
        try:
            self._ask_time()
            while kind := self._tracker.getNextData():
                if kind != self._sdk.SAMPLE_TYPE:
                    continue
                sample = self._tracker.getFloatData()
                host_ns = now_ns()
                self._last_ns = host_ns
                x, y, valid, eye = sample_point(sample)
                width, height = self._screen.size_px
                x_dva, y_dva = self._screen.to_dva(x / width, y / height)
                device_s = float(sample.getTime()) * 1e-3
                rows.append((device_s, host_ns, host_ns, float(x_dva), float(y_dva), np.nan, valid, eye))
            if not self._tracker.isConnected():
                raise DeviceGone(f"eyelink {self._address}: the link was cut")
        except RuntimeError as error:
            raise DeviceGone(f"eyelink {self._address}: {error}") from error
        if not rows and now_ns() - self._last_ns > silence_limit_s(self._spec) * 1e9:
            raise DeviceGone(f"eyelink {self._address}: silent for {(now_ns() - self._last_ns) * 1e-9:.2f} s")
        return Batch(gaze=mapped_gaze(rows, self._fit))

    def _ask_time(self) -> None:
        asked_ns = now_ns()
        if asked_ns - self._asked_ns < self._clock.ask_again_ns:
            return
        self._asked_ns = asked_ns
        device_s = float(self._tracker.trackerTimeUsec()) * 1e-6
        self._clock.round_trip(device_s, asked_ns, now_ns())
        self._fit = self._clock.fit()
        # The host's own file, if there is one, can be laid over the session by these.
        self._tracker.sendMessage(f"studyapp {asked_ns}")

    def fit(self) -> ClockFit | None:
        return self._fit

    def close(self) -> None:
        self._tracker.stopRecording()
        if self._edf:
            self._tracker.closeDataFile()
        self._tracker.close()
