"""The session log: a writer process that commits, and says when it has; and a direct log for simulated sessions.

The presenter's process only stores records in shared memory and sends small messages between trials. The writer drains
the rings every `POLL_S`, commits streams every `STREAM_COMMIT_S` (so that they are at most 250 ms behind), and
acknowledges a trial once SQLite has it on the disk (synchronous=FULL). Killing any other process loses nothing that was
acknowledged; killing the writer fails the session with a clear line.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from studyapp import clock
from studyapp.ring import RecordRing, spawn_context
from studyapp.session_file import EventRow, ResponseRow, SessionFile, TrialRow
from studyapp.session_writer import FLIP_RING_DTYPE, LogStatistics, StreamRings, write_session

ACKNOWLEDGE_LIMIT_S = 30.0


class LogFailed(RuntimeError):
    """The session file could not be written; what was acknowledged before is safe."""


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
        self._commit()
        self._send(("finish", dict(values)))
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
            self._file.seal(values)
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
