"""Eye trackers: protocols decoded, noise survived, streams read from emulators on loopback."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable

import msgpack
import numpy as np
import pytest

from studyapp.clock import now_ns
from studyapp.devices.device import DeviceGone, DeviceSpec
from studyapp.devices.device_reader import DeviceReader
from studyapp.devices.emulators import Emulator
from studyapp.devices.gazepoint import RecordStream
from studyapp.devices.lsl import GazeLayout, gaze_layout
from studyapp.devices.mouse_gaze import MouseGaze
from studyapp.devices.pupil import annotation, decode_gaze
from studyapp.devices.tracker_emulators import gazepoint_emulator, pupil_emulator
from studyapp.gaze.angles import ScreenGeometry, separation_dva

SCREEN = ScreenGeometry(0.53, 0.30, 0.6)


def wait_for(condition: Callable[[], bool], limit_s: float = 10.0) -> bool:
    deadline = now_ns() + int(limit_s * 1e9)
    while not condition():
        if now_ns() > deadline:
            return False
        time.sleep(0.002)
    return True


def test_angles_go_there_and_back_and_agree_with_the_scalar_product() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.5, 1.5, 100), rng.uniform(-0.5, 1.5, 100)
    x_dva, y_dva = SCREEN.to_dva(x, y)
    back = SCREEN.from_dva(x_dva, y_dva)
    np.testing.assert_allclose(back, (x, y), atol=1e-12)
    points = np.column_stack([(x - 0.5) * 0.53, (0.5 - y) * 0.30, np.full(100, 0.6)])
    unit = points / np.linalg.norm(points, axis=1, keepdims=True)
    expected = np.degrees(np.arccos(np.clip((unit[:-1] * unit[1:]).sum(axis=1), -1, 1)))
    np.testing.assert_allclose(separation_dva(x_dva[:-1], y_dva[:-1], x_dva[1:], y_dva[1:]), expected, atol=1e-9)


def test_gazepoint_records_are_read_split_anywhere_and_without_spaces() -> None:
    stream = RecordStream()
    text = b'<REC CNT="1" TIME="2.5"TIME_TICK="7" BPOGX="0.25" BPOGY="0.5" BPOGV="1" />\r\n<ACK ID="X" FREQ="9"/>\r\n'
    records = [record for value in text for record in stream.feed(bytes([value]))]
    assert [record.kind for record in records] == ["REC", "ACK"]
    assert records[0].values["TIME_TICK"] == "7"
    assert records[0].values["BPOGX"] == "0.25"
    assert stream.malformed == 0


def test_gazepoint_noise_is_counted_and_the_next_record_read() -> None:
    rng = np.random.default_rng(1)
    stream = RecordStream()
    for _ in range(300):
        noise = rng.integers(0, 256, int(rng.integers(1, 300)), np.uint8).tobytes()
        stream.feed(noise + b"\r\n")
        (record,) = stream.feed(b'<REC TIME="1.0" BPOGX="0.1" BPOGY="0.2" BPOGV="1" />\r\n')
        assert record.values["TIME"] == "1.0"
    assert stream.malformed > 1000
    assert stream.feed(b"x" * 20_000) == []
    assert len(stream._text) <= 8192


def test_pupil_data_are_decoded_with_the_origin_at_the_top() -> None:
    datum = {"norm_pos": [0.25, 0.9], "confidence": 0.8, "timestamp": 12.5, "base_data": [{"diameter_3d": 3.1}]}
    assert decode_gaze(b"gaze.3d.0.", msgpack.packb(datum)) == pytest.approx((12.5, 0.25, 0.1, 0.8, 3.1))
    surface = {"gaze_on_surfaces": [{"norm_pos": [0.5, 0.5], "confidence": 1.0, "timestamp": 3}]}
    found = decode_gaze(b"surfaces.screen", msgpack.packb(surface))
    assert found is not None
    assert found[:4] == (3.0, 0.5, 0.5, 1.0)
    assert math.isnan(found[4])
    topic, packed = annotation("onset", 1.5)
    assert topic == b"annotation"
    assert msgpack.unpackb(packed)["label"] == "onset"


@pytest.mark.parametrize("seed", range(3))
def test_malformed_msgpack_gives_no_sample_and_no_crash(seed: int) -> None:
    rng = np.random.default_rng(seed)
    good = msgpack.packb({"norm_pos": [0.25, 0.9], "confidence": 0.8, "timestamp": 12.5})
    for _ in range(2000):
        noise = rng.integers(0, 256, int(rng.integers(0, 80)), np.uint8).tobytes()
        assert decode_gaze(b"gaze.", noise) is None
        cut = good[: int(rng.integers(0, len(good)))]
        assert decode_gaze(b"gaze.", cut) is None
    for broken in ({"norm_pos": [math.nan, 0.5], "confidence": 1, "timestamp": 1}, {"norm_pos": "ab"}, [1], 3, None):
        assert decode_gaze(b"gaze.", msgpack.packb(broken)) is None


@pytest.mark.parametrize(("kind", "emulator"), [("gazepoint", gazepoint_emulator), ("pupil", pupil_emulator)])
def test_a_tracker_is_read_from_its_emulator_and_its_loss_is_noticed(
    kind: str, emulator: Callable[..., Emulator]
) -> None:
    tracker = emulator(150.0, SCREEN, drift_ppm=50.0)
    reader = DeviceReader([DeviceSpec("eyes", kind, tracker.port, screen=SCREEN)])
    try:
        assert reader.wait_until_there(20) == []
        gaze = reader.gaze("eyes")
        tracker.tell("look", -4.0, 2.0)
        assert wait_for(lambda: (s := gaze.newest()) is not None and abs(s[0] + 4) < 0.6 and abs(s[1] - 2) < 0.6)
        noise = np.random.default_rng(0).integers(0, 256, 5000, np.uint8).tobytes() + b"\r\n"
        tracker.tell("raw", noise) if kind == "gazepoint" else tracker.tell("raw", b"gaze.3d.01.", noise)
        time.sleep(0.3)
        assert reader.streams.gaze is not None
        samples = reader.streams.gaze.take()["sample"]
        assert len(samples) > 20
        assert np.all(np.abs(samples["x_dva"][samples["valid"] == 1]) < 10)
        assert np.all(samples["mapped_ns"] <= samples["host_ns"])
        tracker.tell("blink", True)
        assert wait_for(lambda: (s := gaze.newest()) is not None and not s[3])
        os.kill(tracker.pid, signal.SIGKILL)
        assert wait_for(lambda: not gaze.alive(), 3.0)
    finally:
        reader.close()
        tracker.close()


def test_lsl_layouts_follow_the_convention() -> None:
    both = [{"type": kind, "eye": "both", "unit": "pixels"} for kind in ("ScreenX", "ScreenY", "Confidence")]
    left = [{"type": kind, "eye": "left", "unit": "pixels"} for kind in ("ScreenX", "ScreenY")]
    assert gaze_layout(left + both) == GazeLayout(2, 3, "pixels", -1, 4, -1, False, 0)
    assert gaze_layout(left).eye == 1
    directions = [{"type": f"Direction{axis}", "eye": "both"} for axis in "XYZ"]
    assert gaze_layout(directions).unit == "direction"
    with pytest.raises(DeviceGone, match="wanted ScreenX"):
        gaze_layout([{"type": "PupilX"}])


def test_lsl_values_become_degrees_and_bad_ones_are_not_valid() -> None:
    centre = GazeLayout(0, 1, "pixels", -1, 2).samples(
        np.array([[960.0, 540.0, 0.9], [math.nan, 1.0, 0.9], [960.0, 540.0, 0.1]]), SCREEN
    )
    assert centre["valid"].tolist() == [1, 0, 0]
    assert (centre["x_dva"][0], centre["y_dva"][0]) == (0.0, 0.0)
    ahead = GazeLayout(0, 1, "direction", 2).samples(np.array([[1.0, 0.0, 1.0], [0.0, 0.0, -1.0]]), None)
    assert ahead["x_dva"][0] == pytest.approx(45.0)
    assert ahead["valid"].tolist() == [1, 0]
    with pytest.raises(DeviceGone, match="lab file"):
        GazeLayout(0, 1, "pixels").samples(np.zeros((1, 2)), None)


def test_the_mouse_is_gaze_inside_the_window() -> None:
    at = [(960.0, 540.0)]
    mouse = MouseGaze(lambda: at[0], SCREEN)
    newest = mouse.newest()
    assert newest is not None
    assert newest[:2] == (0.0, 0.0)
    assert newest[3]
    at[0] = (-1.0, 0.0)
    outside = mouse.newest()
    assert outside is not None
    assert not outside[3]
