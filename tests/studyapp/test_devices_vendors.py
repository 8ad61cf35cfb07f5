"""Tobii and EyeLink adapters against stand-ins for the vendors' libraries, which cannot be shipped."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from studyapp.cli import main
from studyapp.clock import now_ns
from studyapp.devices.device import Calibrates, DeviceGone, DeviceSpec
from studyapp.devices.device_reader import TRACKER_KINDS
from studyapp.devices.eyelink import MISSING, EyeLink, sample_point
from studyapp.devices.reader_process import open_device
from studyapp.devices.tobii import TobiiPro, combine_eyes
from studyapp.gaze.angles import ScreenGeometry

SCREEN = ScreenGeometry(0.53, 0.30, 0.6, (1920, 1080))


def spec(kind: str, port: str = "", **options: Any) -> DeviceSpec:
    return DeviceSpec("eyes", kind, port, options, screen=SCREEN)


class FakeTobii(ModuleType):
    """As the SDK's documentation has it; its clock is 7 s ahead of ours."""

    EYETRACKER_GAZE_DATA = "gaze"
    CALIBRATION_STATUS_SUCCESS = "ok"

    def __init__(self) -> None:
        super().__init__("tobii_research")
        self.callbacks: list[Any] = []
        self.calibrated: list[Any] = []
        self.blink = 0
        self.tracker = SimpleNamespace(
            address="tet-tcp://1", serial_number="TX-1", subscribe_to=self.subscribe, unsubscribe_from=self.unsubscribe
        )

    def find_all_eyetrackers(self) -> tuple[Any, ...]:
        return (self.tracker,)

    def subscribe(self, kind: str, callback: Any, as_dictionary: bool) -> None:
        assert (kind, as_dictionary) == ("gaze", True)
        self.callbacks.append(callback)

    def unsubscribe(self, kind: str, callback: Any) -> None:
        self.callbacks.remove(callback)

    def get_system_time_stamp(self) -> int:
        return now_ns() // 1000 + 7_000_000

    def ScreenBasedCalibration(self, tracker: Any) -> Any:
        assert tracker is self.tracker
        return self

    def enter_calibration_mode(self) -> None:
        self.calibrated.append("enter")

    def leave_calibration_mode(self) -> None:
        self.calibrated.append("leave")

    def collect_data(self, x: float, y: float) -> str:
        self.calibrated.append((x, y))
        self.blink -= 1
        return "ok" if self.blink < 0 else "failed"

    def compute_and_apply(self) -> Any:
        return SimpleNamespace(status=self.CALIBRATION_STATUS_SUCCESS)

    def say(self, **datum: Any) -> None:
        for callback in self.callbacks:
            callback({"system_time_stamp": self.get_system_time_stamp(), **datum})


def both(left: Any, right: Any, valid: tuple[int, int] = (1, 1)) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, point, seen in (("left", left, valid[0]), ("right", right, valid[1])):
        out |= {f"{name}_gaze_point_on_display_area": point, f"{name}_gaze_point_validity": seen}
        out |= {f"{name}_pupil_diameter": 3.0 if name == "left" else 4.0, f"{name}_pupil_validity": seen}
    return out


@pytest.fixture
def tobii(monkeypatch: pytest.MonkeyPatch) -> FakeTobii:
    fake = FakeTobii()
    monkeypatch.setitem(sys.modules, "tobii_research", fake)
    return fake


def test_tobii_eyes_are_combined() -> None:
    nan = float("nan")
    assert combine_eyes(both((0.4, 0.5), (0.6, 0.7))) == pytest.approx((0.5, 0.6, 3.5, True, 0))
    assert combine_eyes(both((0.4, 0.5), (nan, nan), (1, 0))) == pytest.approx((0.4, 0.5, 3.0, True, 1))
    assert combine_eyes(both((nan, nan), (0.6, 0.7), (0, 1))) == pytest.approx((0.6, 0.7, 4.0, True, 2))
    assert combine_eyes(both((nan, nan), (nan, nan), (0, 0)))[3] is False
    assert combine_eyes({})[3] is False


def test_tobii_samples_are_mapped_onto_the_sessions_clock(tobii: FakeTobii) -> None:
    device = open_device(spec("tobii", "TX-1"))
    for _ in range(5):
        device.poll()
    began = now_ns()
    tobii.say(**both((0.5, 0.5), (0.5, 0.5)))
    tobii.say(**both((1.0, 0.5), (1.0, 0.5)))
    gaze = device.poll().gaze
    x_dva, _ = SCREEN.to_dva(1.0, 0.5)
    assert gaze["x_dva"] == pytest.approx([0.0, float(x_dva)], abs=1e-4)
    assert gaze["valid"].tolist() == [1, 1]
    assert gaze["pupil_mm"] == pytest.approx([3.5, 3.5])
    assert gaze["device_s"] == pytest.approx(began * 1e-9 + 7, abs=0.5)
    assert np.all(np.abs(gaze["mapped_ns"] - began) < 20_000_000)
    assert len(device.poll().gaze) == 0
    device.close()
    assert tobii.callbacks == []


def test_tobii_is_calibrated_target_by_target(tobii: FakeTobii) -> None:
    device = TobiiPro(spec("tobii"))
    assert isinstance(device, Calibrates)
    points = np.array([[0.5, 0.5], [0.1, 0.9]])
    assert device.calibrate("point", points[:1]) == {"failed": "no calibration is under way"}
    assert device.calibrate("begin", points) == {"paced": "host"}
    tobii.blink = 1
    for point in points:
        assert device.calibrate("point", point[None]) == {"collected": point.tolist()}
    assert device.calibrate("finish", points) == {"result": {"status": "ok"}}
    assert tobii.calibrated == ["enter", (0.5, 0.5), (0.5, 0.5), (0.1, 0.9), "leave"]
    device.calibrate("begin", points)
    tobii.blink = 5
    assert device.calibrate("point", points[:1]) == {"failed": "no gaze at target 0.50, 0.50"}
    assert device.calibrate("abort", points) is None
    assert tobii.calibrated[-1] == "leave"
    device.close()


def test_tobii_that_is_not_there_or_silent_is_gone(tobii: FakeTobii) -> None:
    with pytest.raises(DeviceGone, match="no tracker TX-9"):
        TobiiPro(spec("tobii", "TX-9"))
    device = TobiiPro(spec("tobii", silence_s=0.0))
    with pytest.raises(DeviceGone, match="silent"):
        device.poll()


class FakeSample:
    """Left and right gaze in pixels, None: that eye is not tracked."""

    def __init__(self, ms: float, left: Any, right: Any) -> None:
        self.ms, self.left, self.right = ms, left, right

    def isBinocular(self) -> bool:
        return self.left is not None and self.right is not None

    def isLeftSample(self) -> bool:
        return self.left is not None

    def isRightSample(self) -> bool:
        return self.right is not None

    def getLeftEye(self) -> Any:
        return SimpleNamespace(getGaze=lambda: self.left)

    def getRightEye(self) -> Any:
        return SimpleNamespace(getGaze=lambda: self.right)

    def getTime(self) -> float:
        return self.ms


class FakePylink(ModuleType):
    """A link whose clock began 100 s ago."""

    SAMPLE_TYPE = 200

    def __init__(self) -> None:
        super().__init__("pylink")
        self.commands: list[str] = []
        self.queue: list[Any] = []
        self.connected, self.refuse, self.zero_ns = True, False, now_ns() - 100_000_000_000

    def EyeLink(self, address: str) -> Any:
        if self.refuse:
            raise RuntimeError("Link terminated")
        self.commands.append(address)
        return self

    def sendCommand(self, text: str) -> None:
        self.commands.append(text)

    def openDataFile(self, name: str) -> None:
        self.commands.append(f"open {name}")

    def closeDataFile(self) -> None:
        self.commands.append("close file")

    def startRecording(self, *which: int) -> int:
        self.commands.append(f"record {which}")
        return 0

    def stopRecording(self) -> None:
        self.commands.append("stop")

    def sendMessage(self, text: str) -> None:
        assert text.startswith("studyapp ")

    def close(self) -> None:
        self.connected = False

    def trackerTimeUsec(self) -> float:
        return (now_ns() - self.zero_ns) / 1000

    def isConnected(self) -> bool:
        return self.connected

    def getNextData(self) -> int:
        self.held = self.queue.pop(0) if self.queue else None
        return 0 if self.held is None else 200 if isinstance(self.held, FakeSample) else 5

    def getFloatData(self) -> Any:
        return self.held


@pytest.fixture
def pylink(monkeypatch: pytest.MonkeyPatch) -> FakePylink:
    fake = FakePylink()
    monkeypatch.setitem(sys.modules, "pylink", fake)
    return fake


def test_eyelink_eyes_are_combined() -> None:
    gone = (MISSING, MISSING)
    assert sample_point(FakeSample(0, (100, 200), (300, 400))) == (200, 300, True, 0)
    assert sample_point(FakeSample(0, (100, 200), gone)) == (100, 200, True, 1)
    assert sample_point(FakeSample(0, None, (300, 400))) == (300, 400, True, 2)
    assert sample_point(FakeSample(0, gone, gone))[2] is False


def test_every_eyelink_sample_is_kept_on_the_sessions_clock(pylink: FakePylink) -> None:
    device = open_device(spec("eyelink", edf="study1"))
    assert pylink.commands[:2] == ["100.1.1.1", "screen_pixel_coords = 0 0 1919 1079"]
    assert pylink.commands[-2:] == ["open study1", "record (True, True, 1, 0)"]
    device.poll()
    began = now_ns()
    ms = pylink.trackerTimeUsec() / 1000
    pylink.queue = [FakeSample(ms, (960, 540), (960, 540)), "an event", FakeSample(ms + 1, (0, 540), (0, 540))]
    gaze = device.poll().gaze
    assert len(gaze) == 2
    x_dva, _ = SCREEN.to_dva(0.0, 0.5)
    assert gaze["x_dva"] == pytest.approx([0.0, float(x_dva)], abs=1e-4)
    assert abs(int(gaze["mapped_ns"][0]) - began) < 20_000_000
    assert np.isnan(gaze["pupil_mm"]).all()
    pylink.connected = False
    with pytest.raises(DeviceGone, match="the link was cut"):
        device.poll()
    device.close()
    assert pylink.commands[-2:] == ["stop", "close file"]


def test_eyelink_that_does_not_answer_is_gone(pylink: FakePylink) -> None:
    pylink.refuse = True
    with pytest.raises(DeviceGone, match="Link terminated"):
        EyeLink(spec("eyelink"))


@pytest.mark.parametrize("kind", ["tobii", "eyelink"])
def test_without_the_vendors_library_one_line_names_the_extra(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert kind in TRACKER_KINDS
    # None in sys.modules: as if it were not installed, whether or not it is.
    monkeypatch.setitem(sys.modules, {"tobii": "tobii_research", "eyelink": "pylink"}[kind], None)
    with pytest.raises(DeviceGone, match=rf"studyapp\[{kind}\]"):
        open_device(spec(kind))


def test_vendors_have_no_emulator(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--test", "tobii:emulated"]) == 2
    assert "has no emulator" in capsys.readouterr().err
