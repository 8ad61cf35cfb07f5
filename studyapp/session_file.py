"""The session file as `protocols.records` defines it: one SQLite database, written by exactly one connection."""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from protocols.records import FLIP_DTYPE, GAZE_DTYPE, SCHEMA_VERSION, TABLES


@dataclass(frozen=True)
class TrialRow:
    """One row of ``trials``, field for field."""

    trial: int
    planned: int
    attempt: int
    block: str
    kind: str
    scene: str
    practice: bool
    catch: bool
    correct: str | None
    panels: str
    factors: str
    onset_ns: int
    offset_ns: int
    refreshes: int
    missed: int
    replays: int
    status: str
    observer_kind: str


@dataclass(frozen=True)
class ResponseRow:
    """One row of ``responses``, field for field."""

    trial: int
    question: str
    kind: str
    answer: str | None
    rating: float | None
    chosen: str | None
    rt_ns: int | None
    press_ns: int | None
    device: str
    device_stamp: float | None
    raw: bytes | None
    timed_out: bool


@dataclass(frozen=True)
class EventRow:
    """One row of ``events``: something a device or the session did. ``payload``: JSON text."""

    t_ns: int
    device: str
    kind: str
    payload: str
    raw: bytes | None = None


@dataclass(frozen=True)
class ClockFitRow:
    """One row of ``clock_fits``: session_ns = device_s * 1e9 * (1 + drift_ppm * 1e-6) + offset_ns."""

    t_ns: int
    device: str
    offset_ns: float
    drift_ppm: float
    uncertainty_ns: float
    n: int


class SessionFile:
    """An open session file. Rows go into one transaction until `commit`. A table is created by its first row.

    ``durable``: WAL with synchronous=FULL, a commit survives kill -9 and power loss; otherwise synchronous=OFF, for
    files that nobody reads before they are complete. Raises sqlite3.OperationalError on a full or read-only disk.
    """

    def __init__(self, path: Path, *, durable: bool = True) -> None:
        self.path = Path(path)
        self._db = sqlite3.connect(self.path, isolation_level=None, timeout=5.0)
        self._db.execute("PRAGMA journal_mode=WAL")
        self._db.execute(f"PRAGMA synchronous={'FULL' if durable else 'OFF'}")
        found = self._db.execute("SELECT name FROM sqlite_master WHERE type='table'").fetchall()
        self._tables = {name for (name,) in found}
        self._open = False
        self._chunks: dict[tuple[str, str | int], int] = {}

    def _insert(self, table: str, rows: Iterable[Sequence[Any]], *, replace: bool = False) -> None:
        rows = list(rows)
        if not rows:
            return
        if not self._open:
            self._db.execute("BEGIN IMMEDIATE")
            self._open = True
        if table not in self._tables:
            self._db.execute(TABLES[table])
            self._tables.add(table)
        marks = ",".join("?" * len(rows[0]))
        verb = "INSERT OR REPLACE" if replace else "INSERT"
        self._db.executemany(f"{verb} INTO {table} VALUES ({marks})", rows)

    def header(self, values: Mapping[str, Any]) -> None:
        """Set header keys; values become JSON."""
        rows = [(key, json.dumps(value, sort_keys=True)) for key, value in values.items()]
        self._insert("header", rows, replace=True)

    def trial(self, row: TrialRow, responses: Sequence[ResponseRow] = ()) -> None:
        """One presentation and its answers."""
        self._insert("trials", [_values(row)])
        self._insert("responses", [_values(response) for response in responses])

    def flips(self, trial: int, rows: np.ndarray) -> None:
        """A chunk of FLIP_DTYPE rows of presentation ``trial``."""
        if len(rows):
            chunk = self._next_chunk("flips", "trial", trial)
            self._insert("flips", [(trial, chunk, rows.astype(FLIP_DTYPE, copy=False).tobytes())])

    def gaze(self, device: str, rows: np.ndarray) -> None:
        """A chunk of GAZE_DTYPE rows of ``device``."""
        if len(rows):
            chunk = self._next_chunk("gaze", "device", device)
            self._insert("gaze", [(device, chunk, rows.astype(GAZE_DTYPE, copy=False).tobytes())])

    def events(self, rows: Sequence[EventRow]) -> None:
        """Device and session events."""
        self._insert("events", [_values(row) for row in rows])

    def clock_fits(self, rows: Sequence[ClockFitRow]) -> None:
        """Fits of device clocks."""
        self._insert("clock_fits", [_values(row) for row in rows])

    def clip(self, identity: str, manifest: str, cost: str) -> None:
        """A clip's manifest and cost, JSON as in the store."""
        self._insert("clips", [(identity, manifest, cost)], replace=True)

    def note(self, t_ns: int, text: str) -> None:
        """A sentence for whoever reads the data."""
        self._insert("notes", [(t_ns, text)])

    def about_self(self, name: str, value: str) -> None:
        """What a participant said about themselves (never anything that identifies)."""
        self._insert("answers_about_self", [(name, value)], replace=True)

    def commit(self) -> None:
        """End the transaction; with ``durable`` it is on the disk when this returns."""
        if self._open:
            self._db.execute("COMMIT")
            self._open = False

    def _next_chunk(self, table: str, column: str, key: str | int) -> int:
        known = self._chunks.get((table, key))
        if known is None:
            known = -1
            if table in self._tables:
                query = f"SELECT COALESCE(MAX(chunk), -1) FROM {table} WHERE {column}=?"
                known = self._db.execute(query, (key,)).fetchone()[0]
        self._chunks[(table, key)] = known + 1
        return known + 1

    def seal(self, values: Mapping[str, Any] | None = None) -> None:
        """Store a checksum per table (header key ``checksums``), the schema version and the last header ``values``, all
        in one transaction: a file that says it is complete is sealed."""
        self.commit()
        sealed = {"schema_version": SCHEMA_VERSION, "checksums": table_checksums(self._db)}
        self.header({**(values or {}), **sealed})
        self.commit()

    def close(self) -> None:
        """Fold the write-ahead log into the file and close. An open transaction is rolled back."""
        if self._open:
            self._db.execute("ROLLBACK")
            self._open = False
        self._db.close()


def _values(row: Any) -> tuple[Any, ...]:
    return tuple(int(value) if isinstance(value, bool) else value for value in vars(row).values())


def table_checksums(db: sqlite3.Connection) -> dict[str, str]:
    """sha256 (hex) of each table's rows in rowid order, header excepted."""
    sums = {}
    for table in sorted(TABLES):
        found = db.execute("SELECT 1 FROM sqlite_master WHERE type='table' AND name=?", (table,)).fetchone()
        if table == "header" or found is None:
            continue
        digest = hashlib.sha256()
        for row in db.execute(f"SELECT * FROM {table} ORDER BY rowid"):
            for value in row:
                data = value if isinstance(value, bytes) else repr(value).encode()
                digest.update(len(data).to_bytes(8, "little"))
                digest.update(data)
        sums[table] = digest.hexdigest()
    return sums


def read_header(db: sqlite3.Connection) -> dict[str, Any]:
    """Header keys of a session file, JSON decoded; {} where it has none."""
    found = db.execute("SELECT 1 FROM sqlite_master WHERE type='table' AND name='header'").fetchone()
    if found is None:
        return {}
    return {key: json.loads(value) for key, value in db.execute("SELECT key, value FROM header")}


def verify(path: Path) -> list[str]:
    """Problems of a session file, one line each; [] where SQLite and the stored checksums agree."""
    db = sqlite3.connect(path)
    try:
        problems = [f"{path}: {text}" for (text,) in db.execute("PRAGMA integrity_check") if text != "ok"]
        stored = read_header(db).get("checksums")
        if stored is None:
            return [*problems, f"{path}: checksums: got none, wanted a sealed session (was it interrupted?)"]
        actual = table_checksums(db)
        for table in sorted(set(stored) | set(actual)):
            if stored.get(table) != actual.get(table):
                problems.append(f"{path}: table {table}: got other rows than were sealed, wanted {stored.get(table)}")
        return problems
    finally:
        db.close()
