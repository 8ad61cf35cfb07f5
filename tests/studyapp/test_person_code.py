"""Two people in one slot are never taken for one: codes, replacements, and what is refused."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from stimuli.errors import InputError
from studyapp.cli import main
from studyapp.person_code import person_code
from studyapp.session_file import SessionFile, read_header
from studyapp.withdraw import withdraw
from tests.studyapp.tiny_study import TINY


def sat(
    folder: Path, name: str, participant: str, slot: int | None, complete: bool = True, kind: str = "person"
) -> None:
    """A session that has begun."""
    file = SessionFile(folder / f"{name}.sqlite")
    header = {"study": "s", "participant": participant, "observer_kind": kind, "plan": []}
    header |= {"slot": slot} if slot is not None else {}
    file.header(header | ({"completed_utc": "2026-01-01T00:00:00"} if complete else {}))
    file.commit()
    file.close()


def test_the_code_is_the_slots_number_unless_one_is_given(tmp_path: Path) -> None:
    assert person_code(tmp_path, "s", 3, "", False) == ("3", 1)
    assert person_code(tmp_path, "s", 3, "AB7", False) == ("AB7", 1)
    assert person_code(tmp_path, "s", 3, "3", False) == ("3", 1)


def test_a_slot_that_somebody_completed_asks_who_comes_now(tmp_path: Path) -> None:
    sat(tmp_path, "s_p3_1", "3", None)  # as older versions wrote it
    with pytest.raises(InputError) as told:
        person_code(tmp_path, "s", 3, "", False)
    assert str(told.value) == (
        "participant: slot 3: got complete, by participant 3 (s_p3_1.sqlite), wanted --code 3 for the same person "
        "again, or another code for who replaces them"
    )
    assert person_code(tmp_path, "s", 3, "3", False) == ("3", 2)
    assert person_code(tmp_path, "s", 3, "K7", False) == ("K7", 1)
    assert person_code(tmp_path, "s", 4, "", False) == ("4", 1)
    # simulated observers are others than persons, and the same again
    assert person_code(tmp_path, "s", 3, "", True) == ("3", 1)


def test_an_interrupted_session_asks_nothing(tmp_path: Path) -> None:
    sat(tmp_path, "s_p3_1", "3", 3, complete=False)
    assert person_code(tmp_path, "s", 3, "", False) == ("3", 2)


@pytest.mark.parametrize("code", ["a b", "x" * 21, "../up", "ä"])
def test_a_code_is_letters_and_digits(tmp_path: Path, code: str) -> None:
    with pytest.raises(InputError, match="wanted 1 to 20 letters and digits"):
        person_code(tmp_path, "s", 1, code, False)


def test_one_code_sits_in_one_slot(tmp_path: Path) -> None:
    sat(tmp_path, "s_p3_1", "K7", 3)
    with pytest.raises(InputError, match=r"code K7: got the participant of slot 3 \(s_p3_1.sqlite\)"):
        person_code(tmp_path, "s", 4, "K7", False)
    with pytest.raises(InputError, match="code with a letter in it, or the slot's own number 4"):
        person_code(tmp_path, "s", 4, "3", False)


def test_who_takes_the_slot_of_somebody_who_withdrew_has_a_code_of_their_own(tmp_path: Path) -> None:
    sat(tmp_path, "s_p3_1", "3", 3)
    withdraw("3", tmp_path)
    with pytest.raises(InputError, match=r"slot 3: participant 3: got withdrawn on .*wanted --code"):
        person_code(tmp_path, "s", 3, "", False)
    assert person_code(tmp_path, "s", 3, "N1", False) == ("N1", 1)


def test_a_replacement_keeps_the_slots_order_and_is_somebody_else(tmp_path: Path) -> None:
    protocol, data = tmp_path / "tiny.yaml", tmp_path / "data"
    protocol.write_text(TINY)
    run = ["run", str(protocol), "--display", "virtual", "--observer", "simulated", "--data", str(data)]
    assert main([*run, "--participant", "2"]) == 0
    assert main([*run, "--participant", "2", "--code", "K7"]) == 0
    headers = []
    for number in (1, 2):
        db = sqlite3.connect(data / f"tiny_p2_{number}.sqlite")
        headers.append(read_header(db))
        db.close()
    assert [(h["participant"], h["slot"], h["run"]) for h in headers] == [("2", 2, 1), ("K7", 2, 1)]
    assert headers[0]["plan"] == headers[1]["plan"]
    assert headers[1]["recruitment"] == {"target": 12, "replace_excluded": True}


def test_resume_of_another_person_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    protocol, data = tmp_path / "tiny.yaml", tmp_path / "data"
    protocol.write_text(TINY)
    run = ["run", str(protocol), "--display", "virtual", "--observer", "simulated", "--data", str(data)]
    assert main([*run, "--participant", "2"]) == 0
    file = SessionFile(data / "tiny_p2_1.sqlite")
    file.header({"completed_utc": None})
    file.commit()
    file.close()
    assert main([*run, "--participant", "2", "--resume", "--code", "K7"]) == 2
    assert "--code: got K7, wanted the person it was begun with (2)" in capsys.readouterr().err
