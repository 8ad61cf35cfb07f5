"""2,000 Hz gaze, 1,000 Hz box and 240 flips a second against the emulators: 0 lost, the writer's share of a core.

The gaze goes through a real LSL stream, the box's bytes through a pseudo-terminal, the flips through the ring from a
loop paced like the off-screen display, at real-time priority where the system grants it. What was sent is counted at
the senders, what arrived in the file; the same loop with nothing but its log says what the machine itself loses.
"""

from __future__ import annotations

import os
import sqlite3
import sys
import tempfile
import time
import uuid
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from protocols.records import FLIP_DTYPE, GAZE_DTYPE
from studyapp.clock import now_ns
from studyapp.devices.device import DeviceSpec
from studyapp.devices.device_reader import DeviceReader
from studyapp.devices.emulators import box_emulator, gaze_emulator
from studyapp.display.vblank import grid_time_ns
from studyapp.gaze.angles import ScreenGeometry
from studyapp.present.frame_loop import ask_realtime, children_stay_normal, leave_realtime
from studyapp.session_devices import EMULATOR_SILENCE_S
from studyapp.session_log import DurableLog
from tests.evidence import write_evidence

SCREEN = ScreenGeometry(0.53, 0.30, 0.6)
ALONE_S = 60.0
GAZE_HZ, EDGES_HZ, FLIP_HZ = 2000.0, 1000.0, Fraction(240)


@dataclass(frozen=True)
class Streams:
    """Counts and shares. ``gaze_gaps``: jumps in the gaze's own stamps; ``missed_flips``: refreshes that the pacing
    loop came too late for; ``missed_share`` of all, and of the loop alone for `ALONE_S`; ``writer_core_share``: CPU
    seconds of the writer over wall seconds; ``load``: the machine's at the end, mean of a minute."""

    seconds: float
    gaze_received: int
    gaze_expected: int
    gaze_gaps: int
    edges_sent: int
    edges_received: int
    flips_sent: int
    flips_received: int
    ring_lost: int
    vanished: int
    writer_core_share: float
    worst_lag_s: float
    missed_flips: int
    late_p99_ms: float
    missed_share: float
    missed_share_alone: float | None
    priority: str
    load: float


def stream(seconds: float, folder: Path, alone_s: float = 0.0, priority: str = "normal") -> Streams:
    """Run the pacing loop alone for ``alone_s``, then all three for ``seconds``, and count."""
    path = folder / "streams.sqlite"
    missed_share_alone = None
    if alone_s:
        lonely = DurableLog(folder / "alone.sqlite")
        sent, missed, _ = _flip(lonely, None, alone_s)
        lonely.finish({})
        missed_share_alone = missed / (sent + missed)
    box = box_emulator("rb-820")
    eyes = gaze_emulator(f"streams-{uuid.uuid4()}", GAZE_HZ, SCREEN, 0)
    specs = [
        DeviceSpec("box", "rb-820", box.port),
        # As in a session: an emulator that shares the processor may stutter without having gone.
        DeviceSpec("eyes", "lsl", eyes.port, {"loopback": True, "silence_s": EMULATOR_SILENCE_S}, screen=SCREEN),
    ]
    reader = DeviceReader(specs)
    try:
        missing = reader.wait_until_there(30)
        if missing:
            raise RuntimeError("; ".join(missing))
        log = DurableLog(path, reader.streams)
        log.begin_trial(0)
        box.tell("flood", EDGES_HZ, seconds)
        sent, missed, late_ms = _flip(log, reader, seconds)
        time.sleep(1.0)
        edges = int(EDGES_HZ * seconds)
        statistics = log.finish({"completed_utc": "streams"})
    finally:
        reader.close()
        eyes.close()
        box.close()
    db = sqlite3.connect(path)
    gaze = np.concatenate([np.frombuffer(b, GAZE_DTYPE) for (b,) in db.execute("SELECT data FROM gaze ORDER BY chunk")])
    flips = np.concatenate(
        [np.frombuffer(b, FLIP_DTYPE) for (b,) in db.execute("SELECT data FROM flips ORDER BY chunk")]
    )
    kinds = dict(db.execute("SELECT kind, COUNT(*) FROM events GROUP BY kind").fetchall())
    db.close()
    span_s = float(gaze["device_s"][-1] - gaze["device_s"][0])
    return Streams(
        seconds, len(gaze), round(span_s * GAZE_HZ) + 1, int(np.sum(np.diff(gaze["device_s"]) > 1.5 / GAZE_HZ)), edges,
        kinds.get("press", 0) + kinds.get("release", 0), sent, len(flips), statistics.lost, kinds.get("vanished", 0),
        statistics.cpu_s / statistics.wall_s, statistics.worst_lag_s, missed, late_ms,
        missed / (sent + missed), missed_share_alone, priority, os.getloadavg()[0],
    )  # fmt: skip


def _flip(log: DurableLog, reader: DeviceReader | None, seconds: float) -> tuple[int, int, float]:
    """The presenter's share of the work: a row a refresh, presses and gaze polled; (flips, missed, p99 of lateness)."""
    responder = None if reader is None else reader.responder()
    gaze = None if reader is None else reader.gaze("eyes")
    row = np.zeros(1, FLIP_DTYPE)
    start_ns, index, missed = now_ns(), 0, 0
    lateness = []
    while index < seconds * float(FLIP_HZ):
        due_ns = grid_time_ns(start_ns, index, FLIP_HZ)
        while (left := due_ns - now_ns()) > 0:
            if left > 600_000:
                time.sleep((left - 500_000) * 1e-9)
        late_ns = now_ns() - due_ns
        lateness.append(late_ns * 1e-6)
        lost = int(late_ns * FLIP_HZ / 1_000_000_000)
        missed += lost
        index += lost
        row["refresh"], row["due_ns"], row["submitted_ns"], row["shown_ns"] = index, due_ns, due_ns, now_ns()
        log.put(row)
        if responder is not None and gaze is not None:
            responder.poll()
            gaze.newest()
        index += 1
    return index - missed, missed, float(np.percentile(lateness, 99))


if __name__ == "__main__":
    granted = ask_realtime()
    children_stay_normal()
    with tempfile.TemporaryDirectory() as name:
        found = stream(float(sys.argv[1]) if len(sys.argv) > 1 else 600.0, Path(name), ALONE_S, granted)
    leave_realtime()
    write_evidence("streams", found)
    print(found)
    whole = (
        found.gaze_received == found.gaze_expected
        and found.gaze_gaps == 0
        and found.edges_received == found.edges_sent
        and found.flips_received == found.flips_sent
        and found.ring_lost == 0
    )
    sys.exit(not whole)
