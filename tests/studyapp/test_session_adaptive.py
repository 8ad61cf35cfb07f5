"""Adaptive blocks: what is asked next hangs on the answers, in simulations and in resumed sessions alike."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import time
from pathlib import Path

import pytest

from protocols.adaptive import procedure
from protocols.load import load_study
from studyapp.cli import main
from studyapp.session_file import read_header, verify
from tests.studyapp.test_session_run import started
from tests.studyapp.tiny_study import TINY

ADAPTIVE = TINY.replace("study: tiny", "study: adaptive").replace(
    "    repetitions: 2\n    questions: [which]",
    "    adaptive: {kind: active_pairs, trials: 150}\n    questions: [which]",
)


def chosen_in(path: Path) -> list[tuple[int, str]]:
    db = sqlite3.connect(path)
    rows = db.execute(
        "SELECT planned, chosen FROM trials JOIN responses USING (trial) "
        "WHERE block='pairs' AND status='ok' ORDER BY trial"
    ).fetchall()
    db.close()
    return rows


def test_a_simulated_session_follows_the_procedure(tmp_path: Path) -> None:
    protocol = tmp_path / "adaptive.yaml"
    protocol.write_text(ADAPTIVE)
    assert main(["simulate", str(protocol), "--participants", "1", "--data", str(tmp_path), "--jobs", "1"]) == 0
    path = tmp_path / "adaptive_p1_1.sqlite"
    chosen = dict(chosen_in(path))
    assert len(chosen) == 150
    # The stored plan is what the procedure gives when it is sent the stored answers.
    db = sqlite3.connect(path)
    stored = read_header(db)["plan"]
    db.close()
    again = procedure(load_study(protocol), 1)
    trials = [next(again)]
    while True:
        try:
            trials.append(again.send(chosen.get(trials[-1].index)))
        except StopIteration:
            break
    assert json.loads(json.dumps([trial.as_dict() for trial in trials])) == stored


def test_check_and_plan_say_that_trials_are_made_as_the_answers_come(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    protocol = tmp_path / "adaptive.yaml"
    protocol.write_text(ADAPTIVE)
    assert main(["check", str(protocol)]) == 0
    out = capsys.readouterr().out
    assert "152 trials each" in out
    assert "block pairs (forced_choice): at most 150 trials, made as the answers come (active_pairs)" in out
    assert main(["plan", str(protocol), "--participant", "1"]) == 0
    said = capsys.readouterr().out
    assert "at most 150 trials, made as the answers come (active_pairs)" in said


def test_a_killed_adaptive_session_goes_on_where_the_procedure_stood(tmp_path: Path) -> None:
    protocol, whole = tmp_path / "adaptive.yaml", tmp_path / "whole"
    protocol.write_text(ADAPTIVE)
    arguments = ["run", str(protocol), "--participant", "1", "--display", "virtual", "--observer", "simulated"]
    process, _ = started([*arguments, "--data", str(tmp_path)], tmp_path / "pids.json")
    time.sleep(0.15)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)
    path = tmp_path / "adaptive_p1_1.sqlite"
    assert main([*arguments, "--data", str(tmp_path), "--resume"]) == 0
    assert main(["simulate", str(protocol), "--participants", "1", "--data", str(whole), "--jobs", "1"]) == 0
    assert chosen_in(path) == chosen_in(whole / "adaptive_p1_1.sqlite")
    assert verify(path) == []
