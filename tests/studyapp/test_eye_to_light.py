"""Eye to light: each step of an eye against the light that follows it, and what a session makes of the figure."""

from __future__ import annotations

import json
import uuid
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from protocols.conditions import Gaze
from stimuli.errors import InputError
from studyapp.cli import main
from studyapp.devices.device import DeviceSpec
from studyapp.devices.device_reader import DeviceReader
from studyapp.devices.emulators import gaze_emulator
from studyapp.display.choose import open_display
from studyapp.display.offscreen_display import OffscreenDisplay
from studyapp.gaze import validation
from studyapp.gaze.angles import ScreenGeometry
from studyapp.gaze.before_session import check_gaze
from studyapp.gaze.eye_to_light import follow, measure_eye_to_light
from studyapp.light_sensor import EYE, OFF, ON, LogEvent, parse_events

SCREEN = ScreenGeometry(0.53, 0.30, 0.6, (64, 64))


def events(latencies_ms: list[float], spurious_us: tuple[int, ...] = ()) -> list[LogEvent]:
    """An eye that steps every 300 ms, and light that follows so much later (nan: never)."""
    found = []
    for n, late_ms in enumerate(latencies_ms):
        found.append(LogEvent(1000 + n * 300_000, EYE))
        if np.isfinite(late_ms):
            found.append(LogEvent(1000 + n * 300_000 + round(late_ms * 1000), ON if n % 2 == 0 else OFF))
    return [*found, *(LogEvent(at, ON) for at in spurious_us)]


def test_latency_is_from_each_step_to_the_light_that_follows_it() -> None:
    found = follow(events([float(ms) for ms in range(20, 40)], spurious_us=(5,)))
    assert (found.steps, found.unseen) == (20, 0)
    assert found.mean_ms == pytest.approx(29.5)
    assert found.p95_ms == pytest.approx(np.percentile(np.arange(20, 40), 95))
    assert found.worst_ms == 39.0


def test_a_step_that_light_does_not_follow_is_counted_and_many_are_refused() -> None:
    found = follow(events([30.0] * 19 + [np.nan]))
    assert (found.steps, found.unseen, found.sd_ms) == (20, 1, 0.0)
    with pytest.raises(InputError, match="steps that light followed: got 50%"):
        follow(events([30.0, np.nan] * 10))
    with pytest.raises(InputError, match="steps of the eye: got 9"):
        follow(events([30.0] * 9))


def test_the_loggers_own_lines_are_read() -> None:
    found, rest, other = parse_events(b"12:EY\r\n30:PD\r\n31:i\r\n40:pd\r\n5")
    assert found == [LogEvent(12, EYE), LogEvent(30, ON), LogEvent(40, OFF)]
    assert (rest, other) == (b"5", 1)


def test_emulated_eye_and_sensor_on_the_off_screen_display() -> None:
    eyes = gaze_emulator(f"eye-{uuid.uuid4()}", 1000.0, SCREEN)
    spec = DeviceSpec("eyes", "lsl", eyes.port, {"loopback": True, "silence_s": 2.0}, screen=SCREEN)
    reader = DeviceReader([spec])
    display = open_display("offscreen", SCREEN.size_px, 240)
    try:
        assert reader.wait_until_there(30.0) == []
        found = measure_eye_to_light(display, reader.gaze("eyes"), "emulated", eyes.step_to, steps=12)
    finally:
        display.close()
        reader.close()
        eyes.close()
    assert (found["steps"], found["tracker"], found["sensor"]) == (12, "eyes", "emulated")
    # Never sooner than the sensor's own 3 ms after a flip; sample, reader, refresh and light on a busy machine.
    assert 3.0 < found["median_ms"] < 100.0
    json.dumps(found, allow_nan=False)


class Eyes:
    """A tracker whose eye stands at the target, a new sample at every look."""

    name = "eyes"
    at = (0.0, 0.0)

    def __init__(self, display: OffscreenDisplay) -> None:
        self._display = display

    def newest(self) -> tuple[float, float, int, bool]:
        return *self.at, self._display.now_ns(), True

    def alive(self) -> bool:
        return True


def test_a_session_is_refused_beyond_the_protocols_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validation, "SETTLE_S", 0.02)
    monkeypatch.setattr(validation, "LOOK_S", 0.05)
    display = OffscreenDisplay(SCREEN.size_px, Fraction(240))
    eyes = Eyes(display)

    def look(x_dva: float, y_dva: float) -> None:
        eyes.at = (x_dva, y_dva)

    limits, slow = Gaze(required=True, points=5), {"p95_ms": 60.1, "steps": 60, "date": "2026-01-01"}
    with pytest.raises(InputError, match=r"eye to light \(p95\): got 60.1 ms, wanted at most 60 ms .*gaze_latency"):
        check_gaze(limits, eyes, display, SCREEN, {}, look, eye_to_light=slow)
    measures, used = check_gaze(limits, eyes, display, SCREEN, {"gaze_latency": "a pilot"}, look, eye_to_light=slow)
    assert used == [{"check": "gaze_latency", "reason": "a pilot"}]
    assert measures is not None
    assert measures["eye_to_light"] == slow
    quick = {**slow, "p95_ms": 59.9}
    assert check_gaze(limits, eyes, display, SCREEN, {}, look, eye_to_light=quick)[1] == []
    display.close()


def test_wrong_requests_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    fixed = ["display", "--display", "offscreen", "--size", "64x64", "--refreshes", "480"]
    assert main([*fixed, "--eye", "lsl:emulated"]) == 2
    assert "--sensor PORT beside it" in capsys.readouterr().err
    assert main(["display", "--display", "virtual", "--eye", "magic", "--sensor", "emulated"]) == 2
    capsys.readouterr()
    (tmp_path / "lab.yaml").write_text("gaze_latency: {file: nowhere.json}\n")
    from studyapp.lab_file import find_lab

    with pytest.raises(InputError, match=r"gaze_latency.file: got nowhere.json, which is not there"):
        find_lab(None, tmp_path).gaze_latency_record()
    (tmp_path / "nowhere.json").write_text("{}")
    with pytest.raises(InputError, match="keys date, p95_ms, steps"):
        find_lab(None, tmp_path).gaze_latency_record()
