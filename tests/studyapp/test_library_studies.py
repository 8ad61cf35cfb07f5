"""Every shipped study goes check -> plan -> simulate (3 participants, session files) -> analyze; its report names every
planned test and effect."""

from __future__ import annotations

import json
from html import unescape
from pathlib import Path

import pytest

from analysis.__main__ import main as analyze
from protocols.load import LIBRARY, load_study
from studyapp.cli import main

NAMES = sorted(file.stem for file in LIBRARY.glob("*.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_study_goes_from_check_to_report(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", name]) == 0
    assert main(["plan", name, "--participant", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.partition("\n[")[2].join(["[", ""]))
    assert main(["simulate", name, "--participants", "3", "--data", str(tmp_path), "--jobs", "1"]) == 0
    assert len(list(tmp_path.glob("*.sqlite"))) == 3
    report, results = tmp_path / "report.html", tmp_path / "results.json"
    assert analyze([str(tmp_path), "--report", str(report), "--json", str(results), "--quiet"]) == 0
    page, found = report.read_text(encoding="utf-8"), results.read_text(encoding="utf-8")
    assert json.loads(found)
    for test in load_study(name).analysis.tests:
        assert test.name in page, test.name
        for effect in test.effects:
            names = (effect, ":".join(reversed(effect.split(":"))))
            said = [form for one in names for form in (one, one.replace(":", " × "), one.replace(":", " x "))]
            assert any(form in page for form in said), (test.name, effect)
    assert "SIMULATED" in page.upper()
    # What it repeats, how closely, and each row of paper / here / why.
    replication = load_study(name).replication
    if replication is not None:
        said = " ".join(unescape(page).split())
        kind = "Proposal: " if replication.kind == "proposal" else f"{replication.kind.capitalize()} replication of "
        assert f"{kind}{replication.of}" in said
        for row in replication.deviations:
            for words in (row.paper, row.here, row.why):
                assert " ".join(words.split()) in said, words
