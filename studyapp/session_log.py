"""The session log: a writer process that commits, and says when it has; and a direct log for simulated sessions.

The presenter's process only stores records in shared memory and sends small messages between trials. The writer drains
the rings every `POLL_S`, commits streams every `STREAM_COMMIT_S` (so that they are at most 250 ms behind), and
acknowledges a trial once SQLite has it on the disk (synchronous=FULL). Killing any other process loses nothing that was
acknowledged; killing the writer fails the session with a clear line.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from protocols.records import FLIP_DTYPE
from studyapp import clock
from studyapp.devices.records import EVENT_RING_DTYPE, FIT_RING_DTYPE, GAZE_RING_DTYPE, events_from_ring, fits_from_ring
from studyapp.ring import RecordRing, leave_interrupts_to_the_session, spawn_context
from studyapp.session_file import EventRow, ResponseRow, SessionFile, TrialRow

if TYPE_CHECKING:  # pylsl is loaded only where markers are asked for
    from studyapp.devices.lsl import MarkerOutlet

FLIP_RING_DTYPE = np.dtype([("trial", "<i8"), ("flip", FLIP_DTYPE)])
POLL_S = 0.05
STREAM_COMMIT_S = 0.1
ACKNOWLEDGE_LIMIT_S = 30.0


class LogFailed(RuntimeError):
    """The session file could not be written; what was acknowledged before is safe."""


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


class SessionLog(Protocol):
    """Where a session goes. Every method may raise LogFailed."""

    path: Path

    def put(self, row: np.ndarray) -> None:
        """(N,) FLIP_DTYPE rows of the trial begun last (this is the presenter's FlipSink)."""
        ...

    def begin_trial(self, trial: int) -> None:
        """Flips that follow belong to presentation ``trial``."""
        ...

    def header(self, values: Mapping[str, Any]) -> None:
        """Set header keys; on disk when this returns."""
        ...

    def commit_trial(self, row: TrialRow, responses: Sequence[ResponseRow]) -> None:
        """A presentation, its answers and all its flips; on disk when this returns."""
        ...

    def event(self, device: str, kind: str, payload: str, raw: bytes | None = None) -> None:
        """Something that happened; on disk with the next commit."""
        ...

    def note(self, text: str) -> None:
        """A sentence for whoever reads the data; on disk with the next commit."""
        ...

    def clip(self, identity: str, manifest: str, cost: str) -> None:
        """A clip's manifest and cost; on disk with the next commit."""
        ...

    def about_self(self, name: str, value: str) -> None:
        """An answer about the participant; on disk with the next commit."""
        ...

    def finish(self, values: Mapping[str, Any]) -> LogStatistics:
        """Last header keys, checksums, close."""
        ...

    def close(self) -> None:
        """Give up without sealing (harmless after `finish`)."""
        ...


class DurableLog:
    """The log of `run`: a writer process behind a shared-memory ring and a pipe.

    ``markers``: source id of an LSL stream on which the writer says each committed trial ('': none). Raises LogFailed
    where the file cannot be created or a commit fails, with SQLite's own words.
    """

    def __init__(
        self, path: Path, streams: StreamRings | None = None, *, flip_seconds: float = 60.0, markers: str = ""
    ) -> None:
        self.path = Path(path)
        context = spawn_context()
        self._ring = RecordRing(FLIP_RING_DTYPE, int(500 * flip_seconds))
        self._record = np.zeros((), FLIP_RING_DTYPE)
        self._pending: list[tuple[str, tuple[Any, ...]]] = []
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=write_session,
            args=(theirs, str(self.path), self._ring, streams or StreamRings(), markers),
            name="session writer",
            daemon=True,
        )
        self._process.start()
        theirs.close()
        self._await("create the session file")

    @property
    def pid(self) -> int:
        """The writer's process id."""
        return int(self._process.pid)

    def put(self, row: np.ndarray) -> None:
        if len(row) == 1:
            self._record["flip"] = row[0]
            self._ring.put(self._record)
            return
        # A block comes from the virtual display, between whose phases there is time to allocate.
        records = np.empty(len(row), FLIP_RING_DTYPE)
        records["trial"], records["flip"] = self._record["trial"], row
        self._ring.put_many(records)

    def begin_trial(self, trial: int) -> None:
        self._record["trial"] = trial

    def header(self, values: Mapping[str, Any]) -> None:
        self._commit(("header", (dict(values),)))

    def commit_trial(self, row: TrialRow, responses: Sequence[ResponseRow]) -> None:
        self._commit(("trial", (row, tuple(responses))))

    def event(self, device: str, kind: str, payload: str, raw: bytes | None = None) -> None:
        self._pending.append(("events", ([EventRow(clock.now_ns(), device, kind, payload, raw)],)))

    def note(self, text: str) -> None:
        self._pending.append(("note", (clock.now_ns(), text)))

    def clip(self, identity: str, manifest: str, cost: str) -> None:
        self._pending.append(("clip", (identity, manifest, cost)))

    def about_self(self, name: str, value: str) -> None:
        self._pending.append(("about_self", (name, value)))

    def finish(self, values: Mapping[str, Any]) -> LogStatistics:
        self._commit(("header", (dict(values),)))
        self._send("finish")
        statistics = self._await("seal the session file")
        self.close()
        return statistics

    def close(self) -> None:
        if self._pending and self._process.is_alive():
            self._send_pending()
        self._pipe.close()
        self._process.join(ACKNOWLEDGE_LIMIT_S)

    def _send_pending(self) -> None:
        try:
            self._commit()
        except LogFailed:
            self._pending = []  # already said where it first failed

    def _commit(self, *operations: tuple[str, tuple[Any, ...]]) -> None:
        pending, self._pending = [*self._pending, *operations], []
        self._send(pending)
        self._await("write the session file")

    def _send(self, message: object) -> None:
        try:
            self._pipe.send(message)
        except OSError as error:
            # The writer may have said why before it went.
            self._await("write the session file")
            raise LogFailed(
                f"{self.path}: session writer: got a closed pipe ({error}), wanted a running writer"
            ) from error

    def _await(self, doing: str) -> Any:
        try:
            if not self._pipe.poll(ACKNOWLEDGE_LIMIT_S):
                raise LogFailed(f"{self.path}: {doing}: got no answer in {ACKNOWLEDGE_LIMIT_S:g} s, wanted a commit")
            kind, value = self._pipe.recv()
        except (EOFError, ConnectionResetError) as error:
            raise LogFailed(
                f"{self.path}: {doing}: got a dead session writer, wanted a commit; "
                "every acknowledged trial is on disk: go on with --resume"
            ) from error
        if kind == "failed":
            raise LogFailed(
                f"{self.path}: {doing}: got '{value}', wanted a commit; every acknowledged trial is on disk"
            )
        return value


class DirectLog:
    """The log of `simulate`: the same rows, in this process, one transaction, renamed into place when complete."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._part = self.path.with_name(self.path.name + ".part")
        self._part.unlink(missing_ok=True)
        self._file = self._said("create the session file", lambda: SessionFile(self._part, durable=False))
        self._trial = 0
        self._flips: list[np.ndarray] = []
        self._closed = False

    def _said(self, doing: str, action: Callable[[], Any]) -> Any:
        try:
            return action()
        except sqlite3.Error as error:
            raise LogFailed(f"{self.path}: {doing}: got '{error}', wanted a writable disk") from error

    def put(self, row: np.ndarray) -> None:
        self._flips.append(row.copy())

    def begin_trial(self, trial: int) -> None:
        self._flush()
        self._trial = trial

    def _flush(self) -> None:
        if self._flips:
            rows, self._flips = np.concatenate(self._flips), []
            self._said("write flips", lambda: self._file.flips(self._trial, rows))

    def header(self, values: Mapping[str, Any]) -> None:
        self._said("write the header", lambda: self._file.header(values))

    def commit_trial(self, row: TrialRow, responses: Sequence[ResponseRow]) -> None:
        self._flush()
        self._said("write a trial", lambda: self._file.trial(row, responses))

    def event(self, device: str, kind: str, payload: str, raw: bytes | None = None) -> None:
        self._said("write an event", lambda: self._file.events([EventRow(clock.now_ns(), device, kind, payload, raw)]))

    def note(self, text: str) -> None:
        self._said("write a note", lambda: self._file.note(clock.now_ns(), text))

    def clip(self, identity: str, manifest: str, cost: str) -> None:
        self._said("write a clip", lambda: self._file.clip(identity, manifest, cost))

    def about_self(self, name: str, value: str) -> None:
        self._said("write an answer", lambda: self._file.about_self(name, value))

    def finish(self, values: Mapping[str, Any]) -> LogStatistics:
        def seal() -> None:
            self._flush()
            self._file.header(values)
            self._file.seal()
            self._file.close()

        self._said("seal the session file", seal)
        self._closed = True
        os.replace(self._part, self.path)
        return LogStatistics(0.0, 0.0, 0.0, 0)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._file.close()
            self._part.unlink(missing_ok=True)


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
        if message == "finish":
            writer.commit()
            writer.file.seal()
            writer.file.close()
            wall_s = (clock.now_ns() - started_ns) * 1e-9
            times = os.times()
            statistics = LogStatistics(times.user + times.system, wall_s, writer.worst_lag_s, writer.lost, writer.rows)
            pipe.send(("ok", statistics))
            return
        if message is not None:
            for method, arguments in message:
                getattr(writer.file, method)(*arguments)
            writer.commit()
            pipe.send(("ok", None))
            writer.mark(message)
        elif clock.now_ns() >= next_commit_ns:
            writer.commit()
            next_commit_ns = clock.now_ns() + int(STREAM_COMMIT_S * 1e9)
