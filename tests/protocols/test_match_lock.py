"""The lock of `studyapp match`: its values replace the protocol's, and it is refused where it is stale."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from protocols.design import plan
from protocols.load import load_study, match_file, read_study, read_unmatched
from protocols.match import Matched
from protocols.match_lock import MatchLock, SolvedKnob, asked_sha256, read_lock, write_lock
from stimuli.errors import InputError

PROTOCOL = """\
study: two
scenes: {bar: bar}
conditions:
  slow: {technique: vanilla, rate_hz: 60}
  budget: {technique: framed_low_resolution, params: {samples_per_s: 1000}}
match:
  - {cost: samples_per_s, conditions: [slow, budget], to: slow,
     knobs: [{condition: budget, parameter: samples_per_s, low: 1000, high: 10000000}]}
questions: {rate: {kind: likert, text: Was it clean?}}
blocks:
  - {name: r, kind: likert, factors: {condition: [slow, budget]}, questions: [rate]}
"""


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    file = tmp_path / "two.yaml"
    file.write_text(PROTOCOL)
    return file


def locked(protocol: Path, value: object = 378551.5, asked: str | None = None) -> Path:
    study, _ = read_unmatched(protocol)
    found = [
        Matched(condition=name, value=v, target=100.0, mismatch=v / 100 - 1, matched=v < 105)
        for name, v in (("slow", 100.0), ("budget", 108.0))
    ]
    lock = MatchLock(
        study="two", asked_sha256=asked or asked_sha256(study), machine="m", size_px=[96, 64], frames=8, scenes=["bar"],
        knobs=[SolvedKnob(condition="budget", parameter="samples_per_s", value=value)], found=[found],
    )  # fmt: skip
    path = match_file(protocol)
    write_lock(path, lock)
    assert read_lock(path) == lock
    return path


def test_the_plan_uses_the_solved_values(protocol: Path) -> None:
    locked(protocol)
    study, text = read_study(protocol)
    shown = {panel.condition: panel.params for trial in plan(study, 1) for panel in trial.panels}
    assert shown["budget"]["samples_per_s"] == 378551.5
    assert [row.matched for row in study.match[0].found] == [True, False]
    assert "# - {condition: budget, parameter: samples_per_s, value: 378551.5}" in text
    assert text.startswith(PROTOCOL.rstrip())


def test_without_a_lock_nothing_changes(protocol: Path) -> None:
    study, text = read_study(protocol)
    assert text == PROTOCOL
    assert study.match[0].found == []


def test_a_stale_lock_is_refused(protocol: Path) -> None:
    path = locked(protocol)
    protocol.write_text(PROTOCOL.replace("rate_hz: 60", "rate_hz: 120"))
    with pytest.raises(InputError, match="made before the protocol was changed"):
        load_study(protocol)
    protocol.write_text(PROTOCOL.replace("Was it clean?", "Was it all clean?"))
    assert load_study(protocol).match[0].found  # the words of a question change no match
    path.unlink()
    protocol.write_text(PROTOCOL.replace("rate_hz: 60", "rate_hz: 120"))
    assert load_study(protocol).match[0].found == []


@pytest.mark.parametrize("value", [-1.0, "many", None, True])
def test_a_value_that_the_technique_refuses_is_named(protocol: Path, value: object) -> None:
    path = locked(protocol, value)
    with pytest.raises(InputError, match=f"{path}: budget.samples_per_s"):
        load_study(protocol)


@pytest.mark.parametrize("text", ["", "[]", "format: 2", "study: two", "\0", "a: &a [*a]"])
def test_what_is_no_lock_is_an_input_error(protocol: Path, text: str) -> None:
    match_file(protocol).write_text(text)
    with pytest.raises(InputError):
        load_study(protocol)


def test_a_knob_has_a_range_or_values(protocol: Path) -> None:
    for knob in ("", "low: 1", "low: 2, high: 1", "low: 1, high: 2, values: [1, 2]", "values: [1]"):
        protocol.write_text(PROTOCOL.replace("low: 1000, high: 10000000", knob).replace("samples_per_s, }", "x}"))
        with pytest.raises(InputError):
            load_study(protocol)


def test_what_was_found_is_no_part_of_what_was_asked(protocol: Path) -> None:
    before, _ = read_unmatched(protocol)
    locked(protocol)
    found = load_study(protocol)
    assert json.dumps(found.as_dict()) != json.dumps(before.as_dict())
    assert asked_sha256(before.model_copy(update={"match": found.match})) == asked_sha256(before)
