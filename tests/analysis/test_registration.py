"""What differs from the registration is said, and tests that were not registered are called exploratory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from analysis.registration import compare, read_registration
from analysis.report import analyse, render_html
from analysis.sessions import read_sessions
from protocols.freeze import registration
from protocols.load import read_study
from stimuli.errors import InputError
from tests.analysis.fabricate import demo_study

TEST = {"name": "smooth", "test": "friedman", "question": "smooth", "within": ["condition"]}


def frozen(**changes: Any) -> dict[str, Any]:
    plan = {"alpha": 0.05, "adjust": "holm", "tests": [TEST], "exclusions": []}
    return {"study": "fabricated", "protocol_sha256": "0" * 64, "participants": 3, **plan, **changes}


def page_of(folder: Path, registration: dict[str, Any]) -> str:
    plan = {"alpha": 0.05, "adjust": "holm", "tests": [TEST, {**TEST, "name": "later"}], "exclusions": []}
    demo_study(folder, participants=3, analysis_plan=plan)
    return render_html(analyse([folder], registration=registration))


def test_only_registered_tests_are_not_exploratory(tmp_path: Path) -> None:
    page = page_of(tmp_path, frozen())
    assert "test later: not registered" in page
    assert "smooth (friedman)" in page
    assert "later (friedman, exploratory)" in page


def test_other_numbers_and_another_text_are_said(tmp_path: Path) -> None:
    page = page_of(tmp_path, frozen(participants=35, protocol_sha256="1" * 64))
    assert "participants: frozen 35, here 3" in page
    assert "is not the text that was registered" in page


def test_the_registration_of_another_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a registration of fabricated"):
        page_of(tmp_path, frozen(study="another"))


@pytest.mark.parametrize("text", ["{", "[]", json.dumps({"tests": []})])
def test_what_is_no_registration_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.freeze.json"
    path.write_text(text)
    with pytest.raises(InputError, match="registration"):
        read_registration(path)


def test_the_part_of_the_protocol_that_was_changed_is_named(tmp_path: Path) -> None:
    study, text = read_study("temporally_dense_2019")
    registered = {**registration(study, text), "study": "fabricated"}
    changed = text.replace("seed: 2019", "seed: 2020")
    assert changed != text
    demo_study(tmp_path, participants=2, header={"protocol_text": changed, "protocol_sha256": "1" * 64})
    sessions = read_sessions([tmp_path])
    lines = compare(registered, sessions, analysed=2).lines
    assert "seed: changed since it was frozen" in lines
    named = {line.split(":")[0] for line in lines if "changed since" in line}
    assert named == {"seed"}
