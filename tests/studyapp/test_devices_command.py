"""``studyapp devices``: emulators are tested live, unreachable devices are one line."""

from __future__ import annotations

import pytest

from studyapp.cli import main


def test_an_emulated_box_shows_its_presses_and_bytes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--test", "rb-820:emulated", "--seconds", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == ["1", "2", "3"]
    assert "bytes 01" in lines[0]


def test_an_unreachable_device_fails_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--test", "nonsense"]) == 2
    assert main(["devices", "--test", "pst:/dev/null", "--seconds", "0"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert "KIND:PORT" in said[0]
