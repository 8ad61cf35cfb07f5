from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest

from protocols.freeze import differences, registration
from protocols.load import LIBRARY, read_study
from protocols.schema import protocol_schema
from protocols.yaml_source import read_yaml
from studyapp.cli import main
from tests.protocols.tiny import TEXT

PLAN = """\
analysis:
  tests:
    - {name: t, test: tost, block: rating, within: [condition], a: full, b: half, low: -1, high: 1, hypothesis: Equal.}
"""


def test_a_registration_holds_what_was_planned() -> None:
    study, text = read_study("foveated_2016")
    made = registration(study, text)
    assert made["participants"] == 15
    assert made["bounds"]["medium_equals_full"] == [-0.5, 0.5]
    assert made["families"]["frc"] == ["frc_pairs"]
    assert differences(made, registration(study, text + "# a comment\n")) == []


def test_freeze_refuses_a_change_without_a_reason_and_keeps_what_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(TEXT + PLAN)
    assert main(["freeze", str(file)]) == 0
    assert main(["freeze", str(file)]) == 0
    assert "nothing has changed" in capsys.readouterr().out
    file.write_text(TEXT + PLAN.replace("high: 1", "high: 2") + "participants: {target: 5}\n")
    assert main(["freeze", str(file)]) == 2
    err = capsys.readouterr().err
    assert "participants: frozen 12, now 5" in err
    assert "test t: changed" in err
    assert main(["freeze", str(file), "--amend", "the room was closed"]) == 0
    stored = json.loads((tmp_path / "s.freeze.json").read_text())
    assert stored["participants"] == 5
    assert stored["amendments"][0]["before"]["participants"] == 12
    assert stored["amendments"][0]["reason"] == "the room was closed"


def test_a_study_without_a_plan_cannot_be_frozen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(TEXT)
    assert main(["freeze", str(file)]) == 2
    assert "analysis.tests" in capsys.readouterr().err


@pytest.mark.parametrize("file", sorted(LIBRARY.glob("*.yaml")), ids=lambda f: f.stem)
def test_shipped_protocols_fit_the_schema(file: Path) -> None:
    jsonschema.Draft202012Validator(protocol_schema()).validate(read_yaml(file).plain())


def test_the_schema_refuses_what_the_loader_refuses() -> None:
    data = read_yaml(LIBRARY / "demo.yaml").plain()
    validator = jsonschema.Draft202012Validator(protocol_schema())
    assert not validator.is_valid({**data, "sede": 1})
    assert not validator.is_valid({**data, "seed": "one"})
    assert not validator.is_valid({k: v for k, v in data.items() if k != "scenes"})
