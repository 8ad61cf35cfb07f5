"""Whole sessions: answers are decoded from bytes on a real line, cut lines stop, resume completes the design once."""

from __future__ import annotations

import json
import os
import resource
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from protocols.load import load_study
from protocols.observer import answer, draw_observer, trial_stream
from protocols.records import FLIP_DTYPE, GAZE_DTYPE, has_table
from protocols.trial import Trial
from studyapp.cli import main
from studyapp.devices.decoders import XidDecoder
from studyapp.session_file import read_header, verify
from tests.studyapp.tiny_study import TINY

ROOT = Path(__file__).parents[2]


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(TINY)
    return path


def run_arguments(protocol: Path, *more: str) -> list[str]:
    fixed = ["--participant", "1", "--display", "virtual", "--observer", "simulated"]
    return ["run", str(protocol), *fixed, "--data", str(protocol.parent / "data"), *more]


def session_path(protocol: Path, run: int = 1) -> Path:
    return protocol.parent / "data" / f"tiny_p1_{run}.sqlite"


def completed_cells(path: Path) -> Counter[int]:
    db = sqlite3.connect(path)
    planned = (
        [p for (p,) in db.execute("SELECT planned FROM trials WHERE status='ok'")] if has_table(db, "trials") else []
    )
    db.close()
    return Counter(planned)


def test_a_run_holds_answers_decoded_from_bytes_and_gaze_from_the_stream(
    tiny: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(run_arguments(tiny)) == 0
    assert "complete" in capsys.readouterr().out
    path = session_path(tiny)
    assert verify(path) == []
    db = sqlite3.connect(path)
    header = read_header(db)
    assert header["observer_kind"] == "simulated"
    assert header["stamp_class"] == "virtual"
    assert header["protocol_text"] == TINY
    assert header["completed_utc"]
    plan = [Trial.from_dict(trial) for trial in header["plan"]]
    assert completed_cells(path) == Counter(range(len(plan)))
    assert db.execute("SELECT DISTINCT observer_kind FROM trials").fetchall() == [("simulated",)]
    # Every answer is what its own bytes say, and what the observer's model meant.
    observer = draw_observer(load_study(tiny), 1, header["seed"])
    rows = db.execute("SELECT trial, question, answer, raw, device, rt_ns FROM responses ORDER BY trial").fetchall()
    assert len(rows) == 8
    for number, name, said, raw, device, rt_ns in rows:
        trial = plan[number]
        (meant,) = answer(trial, observer, trial_stream(header["seed"], 1, trial))
        assert (name, said, device) == (meant.question, meant.answer, "box")
        (change,) = XidDecoder().feed(raw, 0.0)
        keys = list(trial.questions[0].keys.values())
        assert keys[int(change.key) - 1] == said
        assert rt_ns * 1e-9 == pytest.approx(meant.rt_s, abs=0.02)
    flips = [np.frombuffer(b, FLIP_DTYPE) for (b,) in db.execute("SELECT data FROM flips ORDER BY trial, chunk")]
    assert np.all(np.diff(np.concatenate(flips)["refresh"]) == 1)
    gaze = np.concatenate([np.frombuffer(b, GAZE_DTYPE) for (b,) in db.execute("SELECT data FROM gaze")])
    assert len(gaze) > 20
    assert db.execute("SELECT COUNT(*) FROM clips").fetchone()[0] == 3
    db.close()


def test_the_same_run_again_is_a_new_file_and_gives_the_same_answers(tiny: Path) -> None:
    assert main(run_arguments(tiny)) == 0
    assert main(["simulate", str(tiny), "--participants", "1", "--data", str(tiny.parent / "data"), "--jobs", "1"]) == 0
    answers = []
    for run in (1, 2):
        db = sqlite3.connect(session_path(tiny, run))
        answers.append(db.execute("SELECT trial, question, answer, rating, chosen FROM responses").fetchall())
        db.close()
    assert answers[0] == answers[1]


def started(arguments: list[str], pids: Path) -> tuple[subprocess.Popen[str], dict[str, int]]:
    """A run in a process of its own, and the processes it has started."""
    process = subprocess.Popen(
        [sys.executable, "-m", "studyapp", *arguments, "--pids", str(pids)],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < deadline:
        try:
            return process, json.loads(pids.read_text())
        except (FileNotFoundError, json.JSONDecodeError):
            time.sleep(0.005)
    raise AssertionError(process.communicate(timeout=10)[1])


@pytest.mark.parametrize(("victim", "words"), [("emulator_0", "box"), ("emulator_1", "eyes")])
def test_a_cut_line_fails_the_session_with_one_line(tiny: Path, victim: str, words: str) -> None:
    # Long enough to be cut: thirty repetitions.
    tiny.write_text(TINY.replace("repetitions: 2", "repetitions: 200"))
    process, pids = started(run_arguments(tiny), tiny.parent / "pids.json")
    time.sleep(0.3)
    os.kill(pids[victim], signal.SIGKILL)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 1
    (line,) = said.strip().splitlines()
    assert "device lost" in line
    assert words in line
    assert "--resume" in line
    db = sqlite3.connect(session_path(tiny))
    assert "device_lost" in [s for (s,) in db.execute("SELECT status FROM trials")]
    assert "vanished" in [k for (k,) in db.execute("SELECT kind FROM events")]
    db.close()


@pytest.mark.parametrize("victim", ["presenter", "writer", "reader"])
def test_a_killed_process_loses_no_committed_trial_and_resume_completes_each_cell_once(tiny: Path, victim: str) -> None:
    tiny.write_text(TINY.replace("repetitions: 2", "repetitions: 40"))
    process, pids = started(run_arguments(tiny), tiny.parent / "pids.json")
    time.sleep(0.25)
    os.kill(process.pid if victim == "presenter" else pids[victim], signal.SIGKILL)
    process.communicate(timeout=60)
    path = session_path(tiny)
    if victim == "reader" and process.returncode == 0:
        # The reader was started again and the trial in hand repeated.
        assert set(completed_cells(path).values()) == {1}
        return
    assert process.returncode != 0
    before = completed_cells(path)
    db = sqlite3.connect(path)
    # What was shown is on record with the trial that showed it: every pair has two clips.
    panels = "SELECT DISTINCT panels FROM trials WHERE panels != '[]'"
    shown = len(db.execute(panels).fetchall()) if has_table(db, "trials") else 0  # none yet on a machine that is slow
    known = db.execute("SELECT COUNT(*) FROM clips").fetchone()[0] if has_table(db, "clips") else 0
    db.close()
    assert known >= min(2, 2 * shown)
    assert main(run_arguments(tiny, "--resume")) == 0
    after = completed_cells(path)
    assert all(after[planned] == 1 for planned in before)
    assert after == Counter(range(len(after)))
    assert len(after) == 1 + 120 + 2
    assert verify(path) == []
    db = sqlite3.connect(path)
    assert any("resumed" in text for (text,) in db.execute("SELECT text FROM notes"))
    flips = {trial for (trial,) in db.execute("SELECT DISTINCT trial FROM flips")}
    assert flips <= {trial for (trial,) in db.execute("SELECT trial FROM trials")}
    db.close()


def test_a_session_cut_off_before_its_seal_is_sealed_by_resume(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(run_arguments(tiny)) == 0
    path = session_path(tiny)
    db = sqlite3.connect(path)
    db.execute("DELETE FROM header WHERE key IN ('completed_utc', 'checksums')")
    db.commit()
    db.close()
    before = completed_cells(path)
    capsys.readouterr()
    assert main(run_arguments(tiny, "--resume")) == 0
    assert "0 presentations" in capsys.readouterr().out
    assert completed_cells(path) == before
    assert verify(path) == []


def test_resume_refuses_a_changed_protocol_a_complete_session_and_none_at_all(
    tiny: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(run_arguments(tiny, "--resume")) == 2
    assert "session to resume" in capsys.readouterr().err
    assert main(run_arguments(tiny)) == 0
    capsys.readouterr()
    assert main(run_arguments(tiny, "--resume")) == 2
    assert "complete since" in capsys.readouterr().err
    db = sqlite3.connect(session_path(tiny))
    db.execute("DELETE FROM header WHERE key='completed_utc'")
    db.commit()
    db.close()
    tiny.write_text(TINY.replace("Which one?", "Which?"))
    assert main(run_arguments(tiny, "--resume")) == 2
    assert "the protocol has changed" in capsys.readouterr().err


def test_a_person_on_the_virtual_display_needs_the_named_override(
    tiny: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["run", str(tiny), "--participant", "1", "--display", "virtual", "--data", str(tiny.parent)]
    assert main(arguments) == 2
    assert "--override stamp_class=REASON" in capsys.readouterr().err


def test_bad_input_is_one_line_each_and_exit_2(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(tiny), "--participant", "0", "--display", "virtual"]) == 2
    assert main(run_arguments(tiny, "--override", "x")) == 2
    assert main(run_arguments(tiny, "--about", "vision=yes")) == 0  # a simulated observer answers by itself
    assert main(["simulate", str(tiny), "--participants", "0"]) == 2
    assert main(["run", str(tiny), "--participant", "1", "--display", "offscreen", "--observer", "simulated",
                 "--store", str(tiny.parent / "empty"), "--data", str(tiny.parent)]) == 2  # fmt: skip
    said = capsys.readouterr().err.splitlines()
    assert "studyapp render" in said[3]
    assert not any("Traceback" in line for line in said)


def test_a_data_folder_that_cannot_be_written_stops_before_anything_is_shown(
    tiny: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = run_arguments(tiny)
    arguments[arguments.index("--data") + 1] = "/proc/nowhere"
    assert main(arguments) in (1, 2)
    assert "/proc/nowhere" in capsys.readouterr().err


def test_a_disk_that_fills_up_is_one_line_and_resume_completes(tiny: Path) -> None:
    tiny.write_text(TINY.replace("repetitions: 2", "repetitions: 40"))
    process, pids = started(run_arguments(tiny), tiny.parent / "pids.json")
    resource.prlimit(pids["writer"], resource.RLIMIT_FSIZE, (300_000, 300_000))
    _, said = process.communicate(timeout=60)
    assert process.returncode == 1
    (line,) = said.strip().splitlines()
    assert "every acknowledged trial is on disk" in line
    before = completed_cells(session_path(tiny))
    assert main(run_arguments(tiny, "--resume")) == 0
    after = completed_cells(session_path(tiny))
    assert set(before) <= set(after)
    assert after == Counter(range(123))
    assert verify(session_path(tiny)) == []
