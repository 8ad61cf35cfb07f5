"""The log: what is acknowledged is on disk, whatever dies; a full or read-only disk is a clear stop."""

from __future__ import annotations

import os
import resource
import signal
import sqlite3
import subprocess
import sys
import time
import uuid
from pathlib import Path

import numpy as np
import pytest

from protocols.records import FLIP_DTYPE, TABLES, has_table
from studyapp import session_file
from studyapp.ring import RecordRing, spawn_context
from studyapp.session_file import EventRow, ResponseRow, SessionFile, TrialRow, read_header, verify
from studyapp.session_log import DirectLog, DurableLog, LogFailed


def trial_row(trial: int, planned: int | None = None, status: str = "ok") -> TrialRow:
    planned = trial if planned is None else planned
    return TrialRow(
        trial, planned, 0, "main", "likert", "bar", False, False, None, "[]", "{}", 10, 20, 4, 0, 0, status, "simulated"
    )


def response(trial: int) -> ResponseRow:
    return ResponseRow(trial, "q", "likert", "2", 2.0, None, 5, 15, "box", 0.5, b"\x01k", False)


def flip_rows(n: int, first: int = 0) -> np.ndarray:
    rows = np.zeros(n, FLIP_DTYPE)
    rows["refresh"] = np.arange(first, first + n)
    rows["submitted_ns"] = time.monotonic_ns()
    return rows


def test_a_ring_gives_records_back_in_order_across_its_end_and_counts_what_it_could_not_take() -> None:
    ring = RecordRing(np.dtype("<i8"), 5)
    assert ring.put_many(np.arange(4)) == 4
    assert ring.take().tolist() == [0, 1, 2, 3]
    assert ring.put_many(np.arange(10, 17)) == 5
    assert not ring.put(99)
    assert ring.take().tolist() == [10, 11, 12, 13, 14]
    assert ring.lost == 3
    assert ring.take().size == 0
    with pytest.raises(ValueError, match="capacity"):
        RecordRing(np.dtype("<i8"), 0)


def produce(ring: RecordRing, n: int) -> None:
    sent = 0
    while sent < n:
        block = np.arange(sent, min(sent + 37, n))
        free = ring.capacity - len(ring)
        if free >= len(block):
            ring.put_many(block)
            sent += len(block)


def test_a_ring_between_two_processes_loses_and_reorders_nothing() -> None:
    ring = RecordRing(np.dtype("<i8"), 1024)
    process = spawn_context().Process(target=produce, args=(ring, 200_000))
    process.start()
    got: list[np.ndarray] = []
    count = 0
    while count < 200_000:
        block = ring.take()
        got.append(block)
        count += len(block)
    process.join()
    assert np.array_equal(np.concatenate(got), np.arange(200_000))
    assert ring.lost == 0


def test_tables_appear_with_their_first_row(tmp_path: Path) -> None:
    file = SessionFile(tmp_path / "s.sqlite")
    file.header({"study": "x"})
    file.commit()
    db = sqlite3.connect(tmp_path / "s.sqlite")
    assert [table for table in TABLES if has_table(db, table)] == ["header"]
    file.trial(trial_row(0), [response(0)])
    file.commit()
    assert [table for table in TABLES if has_table(db, table)] == ["header", "trials", "responses"]
    db.close()
    file.close()


def test_a_changed_cell_breaks_the_checksum(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    file = SessionFile(path)
    file.trial(trial_row(0), [response(0)])
    file.flips(0, flip_rows(3))
    file.events([EventRow(1, "box", "press", "{}", b"\x00")])
    file.seal()
    file.close()
    assert verify(path) == []
    db = sqlite3.connect(path)
    db.execute("UPDATE responses SET rating = 3.0")
    db.commit()
    db.close()
    assert len(verify(path)) == 1
    assert "responses" in verify(path)[0]


def test_a_file_that_says_it_is_complete_is_sealed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "s.sqlite"
    file = SessionFile(path)
    file.trial(trial_row(0))

    def killed(db: sqlite3.Connection) -> dict[str, str]:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(session_file, "table_checksums", killed)
        with pytest.raises(KeyboardInterrupt):
            file.seal({"completed_utc": "now"})
    file.close()
    db = sqlite3.connect(path)
    assert read_header(db) == {}
    assert db.execute("SELECT trial FROM trials").fetchall() == [(0,)]
    db.close()
    again = SessionFile(path)
    again.seal({"completed_utc": "now"})
    again.close()
    assert verify(path) == []


def test_the_durable_log_holds_trial_answers_and_every_flip_when_it_acknowledges(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    log = DurableLog(path)
    log.header({"participant": "3"})
    log.note("a note")
    for trial in range(3):
        log.begin_trial(trial)
        for row in flip_rows(50, 100 * trial):
            log.put(row.reshape(1))
        log.put(flip_rows(50, 100 * trial + 50))
        log.commit_trial(trial_row(trial), [response(trial)])
        db = sqlite3.connect(path)
        assert db.execute("SELECT COUNT(*) FROM trials").fetchone() == (trial + 1,)
        blobs = db.execute("SELECT data FROM flips WHERE trial=? ORDER BY chunk", (trial,)).fetchall()
        rows = np.concatenate([np.frombuffer(blob, FLIP_DTYPE) for (blob,) in blobs])
        assert rows["refresh"].tolist() == list(range(100 * trial, 100 * trial + 100))
        assert db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        db.close()
    statistics = log.finish({"completed_utc": "now"})
    assert statistics.lost == 0
    assert statistics.rows["flips"] == 300
    assert verify(path) == []
    assert not path.with_name("s.sqlite-wal").exists()


def test_the_direct_log_writes_the_same_rows_and_leaves_nothing_half_done(tmp_path: Path) -> None:
    for name, kind in (("a", DurableLog), ("b", DirectLog)):
        log = kind(tmp_path / f"{name}.sqlite")
        log.header({"participant": "3"})
        log.begin_trial(0)
        for row in flip_rows(10):
            row["submitted_ns"] = 0
            log.put(row.reshape(1))
        log.commit_trial(trial_row(0), [response(0)])
        if kind is DirectLog:
            assert not log.path.exists()
        log.finish({"completed_utc": "now"})
    dumps = []
    for name in "ab":
        db = sqlite3.connect(tmp_path / f"{name}.sqlite")
        dumps.append([db.execute(f"SELECT * FROM {table}").fetchall() for table in ("trials", "responses", "flips")])
        db.close()
    assert dumps[0] == dumps[1]
    abandoned = DirectLog(tmp_path / "c.sqlite")
    abandoned.close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.sqlite", "b.sqlite"]


def test_a_killed_writer_is_a_clear_failure_and_loses_no_acknowledged_trial(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    log = DurableLog(path)
    log.commit_trial(trial_row(0), [response(0)])
    os.kill(log.pid, signal.SIGKILL)
    with pytest.raises(LogFailed, match="writer"):
        log.commit_trial(trial_row(1), [response(1)])
    log.close()
    db = sqlite3.connect(path)
    assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert db.execute("SELECT trial FROM trials").fetchall() == [(0,)]
    db.close()


def test_a_killed_presenter_leaves_its_last_flips_and_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    program = f"""
import os, signal, sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from pathlib import Path
from studyapp.session_log import DurableLog
from tests.studyapp.test_session_log import flip_rows, response, trial_row
if __name__ == "__main__":
    log = DurableLog(Path({str(path)!r}))
    log.commit_trial(trial_row(0), [response(0)])
    log.begin_trial(1)
    for row in flip_rows(50):
        log.put(row.reshape(1))
    os.kill(os.getpid(), signal.SIGKILL)
"""
    script = tmp_path / "presenter.py"
    script.write_text(program)
    assert subprocess.run([sys.executable, str(script)], check=False, timeout=60).returncode == -signal.SIGKILL
    deadline = time.monotonic() + 20
    while path.with_name("s.sqlite-wal").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    db = sqlite3.connect(path)
    assert db.execute("SELECT trial FROM trials").fetchall() == [(0,)]
    assert sum(len(b) for (b,) in db.execute("SELECT data FROM flips WHERE trial=1")) == 50 * FLIP_DTYPE.itemsize
    db.close()


def test_a_presenter_killed_before_its_answer_leaves_the_trial_and_no_words(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    program = f"""
import os, signal, sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from pathlib import Path
from studyapp.session_log import DurableLog
from tests.studyapp.test_session_log import response, trial_row
if __name__ == "__main__":
    log = DurableLog(Path({str(path)!r}))
    log._pipe.send([("trial", (trial_row(0), (response(0),)))])
    os.kill(os.getpid(), signal.SIGKILL)
"""
    script = tmp_path / "presenter.py"
    script.write_text(program)
    # The words of the writer, which outlives it for a moment, come through the same line.
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (-signal.SIGKILL, "")
    assert not path.with_name("s.sqlite-wal").exists()
    db = sqlite3.connect(path)
    assert db.execute("SELECT trial FROM trials").fetchall() == [(0,)]
    db.close()


def test_a_full_disk_stops_with_one_line_and_keeps_what_was_acknowledged(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    log = DurableLog(path)
    resource.prlimit(log.pid, resource.RLIMIT_FSIZE, (300_000, 300_000))
    acknowledged: list[int] = []

    def fill_the_disk() -> None:
        for trial in range(1000):
            log.begin_trial(trial)
            for row in flip_rows(100):
                log.put(row.reshape(1))
            log.commit_trial(trial_row(trial), [response(trial)])
            acknowledged.append(trial)

    with pytest.raises(LogFailed, match="every acknowledged trial is on disk"):
        fill_the_disk()
    log.close()
    db = sqlite3.connect(path)
    assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    kept = [trial for (trial,) in db.execute("SELECT trial FROM trials ORDER BY trial")]
    assert len(acknowledged) > 3
    assert kept[: len(acknowledged)] == acknowledged
    db.close()


def test_a_folder_that_cannot_be_written_is_a_clear_stop() -> None:
    for kind in (DurableLog, DirectLog):
        with pytest.raises(LogFailed, match="unable to open"):
            kind(Path("/proc/nowhere.sqlite"))


def test_markers_say_each_committed_trial_with_its_own_stamp(tmp_path: Path) -> None:
    pylsl = pytest.importorskip("pylsl")
    from studyapp.devices.lsl import keep_to_this_machine

    keep_to_this_machine()
    source = f"markers-{uuid.uuid4()}"
    log = DurableLog(tmp_path / "s.sqlite", markers=source)
    try:
        (info,) = pylsl.resolve_byprop("source_id", source, 1, 20.0)
        inlet = pylsl.StreamInlet(info)
        inlet.open_stream(10.0)
        log.commit_trial(trial_row(0), [response(0)])
        said = [inlet.pull_sample(timeout=10.0) for _ in range(3)]
    finally:
        log.close()
    assert [text for (text,), _ in said] == ["onset 0 main", "offset 0 ok", "answer 0 q 2"]
    stamps = [stamp for _, stamp in said]
    assert stamps[1] - stamps[0] == pytest.approx(10e-9, abs=1e-6)
