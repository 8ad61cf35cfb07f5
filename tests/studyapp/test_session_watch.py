"""The experimenter's view of a session: read from the file while it is written, and after its end."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from stimuli.errors import InputError
from studyapp.cli import main
from studyapp.session_watch import look
from tests.studyapp.test_session_run import run_arguments, session_path, started
from tests.studyapp.tiny_study import TINY


def test_gaze_and_progress_are_seen_while_the_session_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    protocol = tmp_path / "tiny.yaml"
    protocol.write_text(TINY.replace("repetitions: 2", "repetitions: 200"))
    process, _ = started(run_arguments(protocol), tmp_path / "pids.json")
    seen = []
    try:
        while process.poll() is None:
            seen.append(look(session_path(protocol)))
            if seen[-1].gaze and seen[-1].done > 3:
                break
    finally:
        process.kill()
        process.communicate(timeout=60)
    now = seen[-1]
    assert now.planned == 603
    assert 3 < now.done < 603
    assert not now.complete
    (eyes,) = now.gaze
    assert eyes.device == "eyes"
    assert abs(eyes.x_dva) < 30
    # A stream is at most 250 ms behind; the test's machine is shared.
    assert eyes.age_s < 3
    assert main(["devices", "--watch", str(session_path(protocol)), "--seconds", "0.1"]) == 0
    line = capsys.readouterr().out.splitlines()[0]
    assert "of 603 trials done" in line
    assert "% valid" in line


def test_what_is_no_session_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing there"):
        look(tmp_path / "none.sqlite")
    (tmp_path / "text.sqlite").write_text("not a database at all, but long enough to be read as one" * 40)
    with pytest.raises(InputError, match="not a database"):
        look(tmp_path / "text.sqlite")
    empty = sqlite3.connect(tmp_path / "empty.sqlite")
    empty.execute("CREATE TABLE something (x)")
    empty.close()
    state = look(tmp_path / "empty.sqlite")
    assert (state.planned, state.done, state.gaze) == (0, 0, ())
    assert main(["devices", "--watch", str(tmp_path), "--seconds", "nan"]) == 2
