"""The writer process: drains the rings every `POLL_S`, commits streams every `STREAM_COMMIT_S`, acknowledges trials."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from protocols.records import FLIP_DTYPE
from studyapp import clock
from studyapp.devices.records import EVENT_RING_DTYPE, FIT_RING_DTYPE, GAZE_RING_DTYPE, events_from_ring, fits_from_ring
from studyapp.ring import RecordRing, leave_interrupts_to_the_session
from studyapp.session_file import SessionFile

if TYPE_CHECKING:  # pylsl is loaded only where markers are asked for
    from studyapp.devices.lsl import MarkerOutlet

FLIP_RING_DTYPE = np.dtype([("trial", "<i8"), ("flip", FLIP_DTYPE)])
POLL_S = 0.05
STREAM_COMMIT_S = 0.1


@dataclass(frozen=True)
class StreamRings:
    """The rings that device readers fill and the writer drains; ``devices`` name the indices in their records."""

    devices: tuple[str, ...] = ()
    events: RecordRing | None = None
    gaze: RecordRing | None = None
    fits: RecordRing | None = None

    @staticmethod
    def create(devices: Sequence[str], seconds: float = 10.0) -> StreamRings:
        """Rings that hold ``seconds`` of 4,000 gaze samples and 4,000 events per second."""
        capacity = int(4000 * seconds)
        return StreamRings(
            tuple(devices),
            RecordRing(EVENT_RING_DTYPE, capacity),
            RecordRing(GAZE_RING_DTYPE, capacity),
            RecordRing(FIT_RING_DTYPE, 4096),
        )


@dataclass(frozen=True)
class LogStatistics:
    """What the writer measured of itself: seconds of CPU and wall, worst lag of a stream record, records lost."""

    cpu_s: float
    wall_s: float
    worst_lag_s: float
    lost: int
    rows: Mapping[str, int] = field(default_factory=dict)


class _Writer:
    """The writer process's side: rings in, commits out."""

    def __init__(self, path: str, flips: RecordRing, streams: StreamRings) -> None:
        self.file = SessionFile(Path(path))
        self.flips, self.streams = flips, streams
        self.oldest_ns: int | None = None
        self.worst_lag_s = 0.0
        self.commits = 0
        self.rows: dict[str, int] = {"flips": 0, "events": 0, "gaze": 0, "clock_fits": 0}
        self.held: list[np.ndarray] = []
        self.markers: MarkerOutlet | None = None

    def drain(self) -> None:
        """Move whatever the rings hold into the open transaction (gaze is held until the commit: larger chunks)."""
        taken = self.flips.take()
        if len(taken):
            for trial in np.unique(taken["trial"]):
                self.file.flips(int(trial), taken["flip"][taken["trial"] == trial])
            self._seen("flips", len(taken), int(taken["flip"]["submitted_ns"].min()))
        if self.streams.events is not None and len(events := self.streams.events.take()):
            self.file.events(events_from_ring(events, self.streams.devices))
            self._seen("events", len(events), int(events["t_ns"].min()))
        if self.streams.fits is not None and len(fits := self.streams.fits.take()):
            self.file.clock_fits(fits_from_ring(fits, self.streams.devices))
            self._seen("clock_fits", len(fits), None)
        if self.streams.gaze is not None and len(gaze := self.streams.gaze.take()):
            self.held.append(gaze)
            self._seen("gaze", len(gaze), int(gaze["sample"]["host_ns"].min()))

    def _seen(self, table: str, n: int, oldest_ns: int | None) -> None:
        self.rows[table] += n
        if oldest_ns is not None:
            self.oldest_ns = oldest_ns if self.oldest_ns is None else min(oldest_ns, self.oldest_ns)

    def commit(self) -> None:
        """Put everything drained so far on the disk."""
        if self.held:
            gaze = np.concatenate(self.held)
            self.held = []
            for index in np.unique(gaze["device"]):
                self.file.gaze(self.streams.devices[int(index)], gaze["sample"][gaze["device"] == index])
        self.file.commit()
        # What had waited for the writer to start is no lag of the writer's.
        if self.oldest_ns is not None and self.commits:
            self.worst_lag_s = max(self.worst_lag_s, (clock.now_ns() - self.oldest_ns) * 1e-9)
        self.oldest_ns = None
        self.commits += 1

    def mark(self, operations: Sequence[tuple[str, tuple[Any, ...]]]) -> None:
        """Say what was committed to other recorders, stamped with when it happened."""
        if self.markers is None:
            return
        for method, arguments in operations:
            if method == "trial":
                row, responses = arguments
                self.markers.send(f"onset {row.trial} {row.block}", row.onset_ns)
                self.markers.send(f"offset {row.trial} {row.status}", row.offset_ns)
                for response in responses:
                    at_ns = response.press_ns if response.press_ns is not None else row.offset_ns
                    self.markers.send(f"answer {row.trial} {response.question} {response.answer}", at_ns)

    @property
    def lost(self) -> int:
        rings = (self.flips, self.streams.events, self.streams.gaze, self.streams.fits)
        return sum(ring.lost for ring in rings if ring is not None)


def write_session(pipe: Connection, path: str, flips: RecordRing, streams: StreamRings, markers: str) -> None:
    """The writer process: runs until told to finish or until the presenter's process is gone."""
    leave_interrupts_to_the_session()
    started_ns = clock.now_ns()
    try:
        writer = _Writer(path, flips, streams)
        if markers:
            # Its threads are the library's own, and in this process they delay no refresh.
            from studyapp.devices.lsl import MarkerOutlet

            writer.markers = MarkerOutlet("studyapp markers", markers)
        pipe.send(("ok", None))
        _serve(pipe, writer, started_ns)
    except sqlite3.Error as error:
        _answer(pipe, ("failed", str(error)))


def _answer(pipe: Connection, message: tuple[str, object]) -> None:
    # Where nobody is left to be told, nothing is lost by not telling.
    with contextlib.suppress(OSError):
        pipe.send(message)


def _serve(pipe: Connection, writer: _Writer, started_ns: int) -> None:
    next_commit_ns = 0
    while True:
        message: Any = None
        try:
            if pipe.poll(POLL_S):
                message = pipe.recv()
        except (EOFError, OSError):
            # The presenter is gone: keep what it had put, and leave the file whole.
            writer.drain()
            writer.commit()
            writer.file.close()
            return
        writer.drain()
        if isinstance(message, tuple):  # ("finish", the last header values)
            writer.commit()
            writer.file.seal(message[1])
            writer.file.close()
            wall_s = (clock.now_ns() - started_ns) * 1e-9
            times = os.times()
            statistics = LogStatistics(times.user + times.system, wall_s, writer.worst_lag_s, writer.lost, writer.rows)
            _answer(pipe, ("ok", statistics))
            return
        if message is not None:
            for method, arguments in message:
                getattr(writer.file, method)(*arguments)
            writer.commit()
            _answer(pipe, ("ok", None))
            writer.mark(message)
        elif clock.now_ns() >= next_commit_ns:
            writer.commit()
            next_commit_ns = clock.now_ns() + int(STREAM_COMMIT_S * 1e9)
