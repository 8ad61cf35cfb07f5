"""Withdrawal removes every trace of a code and leaves a tombstone that tells nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from studyapp.cli import main
from studyapp.session_file import SessionFile


def session(path: Path, participant: str) -> None:
    file = SessionFile(path)
    file.header({"study": "tiny", "participant": participant})
    file.commit()
    file.close()


def test_a_person_leaves_sessions_tables_and_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, exports = tmp_path / "data", tmp_path / "bids"
    data.mkdir()
    (exports / "sub-07" / "beh").mkdir(parents=True)
    (exports / "sub-17").mkdir()
    session(data / "tiny_p7_1.sqlite", "7")
    session(data / "renamed.sqlite", "7")
    session(data / "tiny_p17_1.sqlite", "17")
    (data / "other.sqlite").write_bytes(b"not a database")
    (exports / "participants.tsv").write_text("participant_id\tage\nsub-07\t7\nsub-17\t7\n")
    (exports / "trials.csv").write_text('participant,answer\n7,"a,b"\n17,7\n7,c\n')
    assert main(["withdraw", "7", "--data", str(data), "--exports", str(exports)]) == 0
    assert "removed 2 sessions, 3 rows and 1 folders" in capsys.readouterr().out
    assert sorted(p.name for p in data.iterdir()) == ["other.sqlite", "tiny_p17_1.sqlite", "withdrawn_7.json"]
    assert (exports / "participants.tsv").read_text() == "participant_id\tage\nsub-17\t7\n"
    assert (exports / "trials.csv").read_text() == "participant,answer\n17,7\n"
    assert (exports / "sub-17").is_dir()
    assert not (exports / "sub-07").exists()
    tombstone = json.loads((data / "withdrawn_7.json").read_text())
    assert tombstone["sessions_removed"] == 2
    assert tombstone["studies"] == ["tiny"]
    assert main(["withdraw", "7", "--data", str(data)]) == 2
    assert "withdrawn already" in capsys.readouterr().err


def test_unknown_codes_and_folders_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["withdraw", "7", "--data", str(tmp_path / "nowhere")]) == 2
    assert main(["withdraw", "7", "--data", str(tmp_path)]) == 2
    assert main(["withdraw", "../7", "--data", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 3
