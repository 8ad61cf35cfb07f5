"""``studyapp display``: exit codes, keys, mistakes in one line."""

from __future__ import annotations

import json

import pytest

from studyapp.cli import main

KEYS = {"locked", "reason", "nominal_hz", "measured_hz", "residual_sd_ms", "lost", "stamp_class"}


@pytest.fixture(autouse=True)
def no_lab(tmp_path, monkeypatch) -> None:
    monkeypatch.delenv("STUDYAPP_LAB", raising=False)
    monkeypatch.chdir(tmp_path)


def test_locked_display_gives_0_and_json(capsys, tmp_path) -> None:
    assert main(["display", "--display", "virtual", "--rate", "60000/1001", "--json", "--out", "c.json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed.keys() >= KEYS
    assert printed["locked"] is True
    assert printed["nominal_hz"] == pytest.approx(59.94, abs=0.001)
    assert json.loads((tmp_path / "c.json").read_text()) == printed


def test_words_for_a_person(capsys) -> None:
    assert main(["display", "--display", "virtual"]) == 0
    said = capsys.readouterr().out
    assert "LOCKED" in said
    assert "onset by software stamp" in said
    assert "no lab file" in said


def test_lab_file_is_read(capsys, tmp_path) -> None:
    (tmp_path / "lab.yaml").write_text("display: {kind: virtual, rate_hz: 120, settings: {vrr: 'off'}}\n")
    assert main(["display", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["nominal_hz"] == 120
    assert printed["settings"]["vrr"] == "off"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--size", "big"], "--size: size: got 'big', wanted WIDTHxHEIGHT"),
        (["--rate", "1/0"], "--rate: rate: got '1/0'"),
        (["--rate", "5"], "display: rate: got 5 Hz, wanted 20 to 1000 Hz"),
        (["--refreshes", "10"], "certificate: refreshes: got 10, wanted at least 480"),
        (["--lab", "none.yaml"], "none.yaml: lab file: got nothing there"),
        (["--sensor", "emulated"], "light sensor: display: got virtual display"),
        (["--photometry"], "photometry: display: got virtual display"),
    ],
)
def test_mistakes_are_one_line_and_2(capsys, arguments: list[str], said: str) -> None:
    assert main(["display", "--display", "virtual", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert said in lines[0]
