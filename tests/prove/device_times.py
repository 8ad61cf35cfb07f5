"""Times of the device path: press through the pseudo-terminal against the emulator's own stamp; a cut line noticed."""

from __future__ import annotations

import os
import signal
import sys
import time
import uuid
from dataclasses import dataclass

import numpy as np

from studyapp.clock import now_ns
from studyapp.devices.device import DeviceSpec
from studyapp.devices.device_reader import DeviceReader
from studyapp.devices.emulators import Emulator, box_emulator, gaze_emulator
from studyapp.devices.status_board import GONE
from studyapp.devices.tracker_emulators import gazepoint_emulator, pupil_emulator
from studyapp.gaze.angles import ScreenGeometry
from studyapp.seams import Press
from tests.evidence import write_evidence

SCREEN = ScreenGeometry(0.53, 0.30, 0.6)


@dataclass(frozen=True)
class RoundTrip:
    """Mapped time of each press less the moment the emulator wrote it, in ms; ``polled``: when the presenter had it.
    A box without a clock of its own is stamped when it is read: on a busy machine single presses are late."""

    kind: str
    presses: int
    mean_ms: float
    median_ms: float
    sd_ms: float
    worst_ms: float
    polled_mean_ms: float


def round_trip(kind: str, presses: int, drift_ppm: float = 50.0) -> RoundTrip:
    """``presses`` of the four first buttons, 80 ms or a little more apart."""
    box = box_emulator(kind, drift_ppm=drift_ppm)
    reader = DeviceReader([DeviceSpec("box", kind, box.port)])
    rng = np.random.default_rng(0)
    got: list[Press] = []
    polled = []
    try:
        assert reader.wait_until_there(20) == []
        time.sleep(2.0)  # the clock model's first round trips
        for n in range(presses):
            box.tell("press", str(1 + n % 4), now_ns() + int(rng.uniform(1e6, 6e6)))
            while len(got) <= n:
                new = reader.presses()
                if new:
                    polled.append(now_ns())
                    got += new
                time.sleep(0.0005)
            time.sleep(0.08)
        truth = [message[2] for message in box.heard() if message[0] == "pressed"]
    finally:
        reader.close()
        box.close()
    errors = np.array([(press.mapped_ns - at) * 1e-6 for press, at in zip(got, truth, strict=True)])
    seen = np.array([(at - true) * 1e-6 for at, true in zip(polled, truth, strict=True)])
    return RoundTrip(
        kind, presses, float(errors.mean()), float(np.median(errors)), float(errors.std()),
        float(np.abs(errors).max()), float(seen.mean()),
    )  # fmt: skip


def noticed_ms(kind: str) -> float:
    """Milliseconds from kill -9 of an emulator to its device being marked as gone."""
    emulator: Emulator
    if kind == "lsl":
        emulator = gaze_emulator(f"cut-{uuid.uuid4()}", 250.0, SCREEN)
    elif kind == "gazepoint":
        emulator = gazepoint_emulator(150.0, SCREEN)
    elif kind == "pupil":
        emulator = pupil_emulator(120.0, SCREEN)
    else:
        emulator = box_emulator(kind)
    reader = DeviceReader([DeviceSpec("device", kind, emulator.port, {"loopback": True}, screen=SCREEN)])
    try:
        assert reader.wait_until_there(20) == []
        time.sleep(0.5)
        cut_ns = now_ns()
        os.kill(emulator.pid, signal.SIGKILL)
        while reader.board.state(0) != GONE:
            time.sleep(0.001)
        return (now_ns() - cut_ns) * 1e-6
    finally:
        reader.close()
        emulator.close()


if __name__ == "__main__":
    trips = [round_trip(kind, 100) for kind in ("xid", "rb-820", "lines")]
    cuts = {kind: noticed_ms(kind) for kind in ("xid", "rb-820", "lsl", "gazepoint", "pupil")}
    print(*trips, cuts, sep="\n")
    write_evidence("device_times", {"round_trips": trips, "noticed_ms": cuts})
    sys.exit(any(abs(trip.mean_ms) >= 1 for trip in trips) or max(cuts.values()) > 250)
