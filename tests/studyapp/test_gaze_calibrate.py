"""The calibration procedure: by the tracker's own server, by our map in the reader process, and what ends it."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from stimuli.errors import InputError
from studyapp.cli import JobFailed
from studyapp.clock import now_ns
from studyapp.devices.device import DeviceSpec
from studyapp.devices.device_reader import DeviceReader
from studyapp.devices.emulators import Emulator
from studyapp.devices.gazepoint import RecordStream, calibration_news
from studyapp.devices.tracker_emulators import gazepoint_emulator
from studyapp.display.offscreen_display import OffscreenDisplay
from studyapp.gaze import calibrate
from studyapp.gaze.angles import ScreenGeometry
from studyapp.gaze.calibrate import Calibrator
from studyapp.gaze.calibration import target_points
from studyapp.gaze.targets import TargetScreen
from studyapp.lab_file import Lab as LabFile
from studyapp.lab_file import LabDevice
from studyapp.session_devices import SessionCalibration, lab_devices

SCREEN = ScreenGeometry(0.53, 0.30, 0.6, (160, 90))
SKEW = (2.5, -1.5)


class Lab:
    """A Gazepoint emulator whose gaze is off, its reader, and a display with an escape key."""

    def __init__(self) -> None:
        self.emulator: Emulator = gazepoint_emulator(150.0, SCREEN)
        self.reader = DeviceReader(
            [DeviceSpec("eyes", "gazepoint", self.emulator.port, {"silence_s": 2.0}, screen=SCREEN)]
        )
        self.display = OffscreenDisplay(SCREEN.size_px, Fraction(240))
        self.screen = TargetScreen(self.display, SCREEN)
        self.follows = True
        assert self.reader.wait_until_there(20.0) == []
        self.emulator.tell("skew", *SKEW)

    def look(self, x_dva: float, y_dva: float) -> None:
        if self.follows:
            self.emulator.tell("look", x_dva, y_dva)

    def calibrator(self) -> Calibrator:
        return Calibrator(self.reader, "eyes", self.display, self.screen, SCREEN, self.look)

    def gaze_at(self, x_dva: float, y_dva: float) -> tuple[float, float]:
        """Mean gaze while the eye looks there."""
        self.emulator.tell("look", x_dva, y_dva)
        self.screen.show(0.5, 0.5, 0.3)
        rows: list[tuple[float, float]] = []

        def take() -> None:
            newest = self.reader.gaze("eyes").newest()
            assert newest is not None
            rows.append(newest[:2])

        self.screen.show(0.5, 0.5, 0.4, take)
        x, y = np.mean(rows, axis=0)
        return float(x), float(y)

    def close(self) -> None:
        self.screen.close()
        self.display.close()
        self.reader.close()
        self.emulator.close()


@pytest.fixture(scope="module")
def shared() -> Iterator[Lab]:
    lab = Lab()
    yield lab
    lab.close()


@pytest.fixture
def lab(shared: Lab, monkeypatch: pytest.MonkeyPatch) -> Lab:
    shared.follows = True
    shared.emulator.tell("skew", *SKEW)
    shared.reader.set_map("eyes", None)
    monkeypatch.setattr(calibrate, "SETTLE_S", 0.3)
    monkeypatch.setattr(calibrate, "LOOK_S", 0.2)
    return shared


def test_our_map_in_the_reader_takes_the_error_out_of_board_and_log(lab: Lab) -> None:
    before = lab.gaze_at(4.0, 3.0)
    assert before == pytest.approx((4 + SKEW[0], 3 + SKEW[1]), abs=0.15)
    record = lab.calibrator().run("map", target_points(5))
    assert record["seen"] == record["points"] == 5
    assert record["residual_deg"] < 0.3
    assert lab.gaze_at(4.0, 3.0) == pytest.approx((4.0, 3.0), abs=0.4)
    assert lab.reader.streams.gaze is not None
    logged = lab.reader.streams.gaze.take()["sample"][-20:]
    assert (logged["x_dva"].mean(), logged["y_dva"].mean()) == pytest.approx((4.0, 3.0), abs=0.4)
    lab.reader.set_map("eyes", None)
    assert lab.gaze_at(4.0, 3.0) == pytest.approx(before, abs=0.2)


def test_the_trackers_own_calibration_is_driven_target_by_target(lab: Lab) -> None:
    record = lab.calibrator().run("device", target_points(5))
    assert record["result"]["targets"] == 5
    assert record["result"]["left_valid"] == 5
    assert record["result"]["left_error"] == pytest.approx(0.01, abs=1e-3)
    assert lab.gaze_at(4.0, 3.0) == pytest.approx((4.0, 3.0), abs=0.15)


def test_eyes_that_look_elsewhere_fail_in_one_line(lab: Lab) -> None:
    lab.follows = False
    lab.emulator.tell("look", 70.0, 0.0)
    with pytest.raises(JobFailed, match="calibration of eyes failed: no target was seen"):
        lab.calibrator().run("device", target_points(5)[1:3])
    lab.emulator.tell("blink", True)
    lab.screen.show(0.5, 0.5, 0.1)
    with pytest.raises(JobFailed, match="calibration of eyes failed"):
        lab.calibrator().run("map", target_points(5))
    lab.emulator.tell("blink", False)


@pytest.mark.parametrize("style", ["device", "map"])
def test_escape_ends_it_at_once(lab: Lab, style: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pressed = iter([[]] * 5 + [[("escape", 0)]] * 100)
    monkeypatch.setattr(lab.display, "keys", lambda: next(pressed))
    began = now_ns()
    with pytest.raises(JobFailed, match="escape"):
        lab.calibrator().run(style, target_points(13))
    assert now_ns() - began < 3e9


def test_unknown_styles_are_refused(lab: Lab) -> None:
    with pytest.raises(InputError, match=r"device \| map"):
        lab.calibrator().run("magic", target_points(5))


def test_the_lab_file_asks_for_it(lab: Lab) -> None:
    entry = LabDevice(name="eyes", kind="gazepoint", port=lab.emulator.port, options={"calibrate": "map"})
    # The emulator serves one line at a time: the fixture's reader loses it, and takes it back afterwards.
    with lab_devices(lab.display, LabFile(devices=(entry,)), SCREEN) as devices:
        assert devices.calibrate == "map"
        calibration = SessionCalibration(devices, lab.display, SCREEN)
        with pytest.raises(JobFailed, match="calibration of eyes failed"):
            calibration.run(lab.screen, target_points(5))  # nobody looks at the targets
        assert calibration.record is None
    plain = LabDevice(name="eyes", kind="gazepoint", port=lab.emulator.port)
    with lab_devices(lab.display, LabFile(devices=(plain,)), SCREEN) as devices:
        assert devices.calibrate == ""


def test_the_mouse_stands_in_for_the_eyes_where_there_is_a_pointer(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    mouse = LabFile(devices=(LabDevice(name="pointer", kind="mouse"),))
    with pytest.raises(InputError, match="mouse as gaze"), lab_devices(lab.display, mouse, SCREEN):
        pass
    monkeypatch.setattr(lab.display, "pointer", lambda: (80.0, 45.0), raising=False)
    with lab_devices(lab.display, mouse, SCREEN) as devices:
        assert devices.gaze is not None
        newest = devices.gaze.newest()
        assert newest is not None
        assert newest[:2] == pytest.approx((0.0, 0.0), abs=1e-9)
    both = LabFile(devices=(*mouse.devices, LabDevice(name="eyes", kind="gazepoint", port="127.0.0.1:1")))
    with pytest.raises(InputError, match="the one or the other"), lab_devices(lab.display, both, SCREEN):
        pass


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<CAL ID="CALIB_START_PT" PT="1" CALX="0.5" CALY="0.25" />', {"target": [0.5, 0.25]}),
        ('<CAL ID="CALIB_START_PT" PT="1" CALX="nan" CALY="0.25" />', None),
        ('<CAL ID="CALIB_RESULT_PT" PT="1" />', None),
        ('<CAL ID="CALIB_RESULT" CALX1="0.5" CALY1="0.5" LV1="0" RV1="0" />', {"failed": "no target was seen"}),
        ('<CAL ID="CALIB_RESULT" />', {"failed": "no target was seen"}),
    ],
)
def test_calibration_records_are_read(text: str, said: dict[str, Any] | None) -> None:
    (record,) = RecordStream().feed(text.encode() + b"\r\n")
    assert calibration_news(record.values) == said
