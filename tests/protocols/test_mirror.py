"""Mirrored layouts: a setting like any other, told where it changes nothing or turns sides round."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocols import load_study
from protocols.check import summarise
from protocols.design import plan
from protocols.schema import protocol_schema
from stimuli.errors import InputError
from tests.protocols.tiny import TEXT, pairs, rating, tiny


def test_it_cascades_to_every_trial_and_is_none_where_nobody_asks() -> None:
    study = tiny(blocks=[pairs(set={"mirror": "pictures"}), rating()])
    found = {(trial.block, trial.settings["mirror"]) for trial in plan(study, 1) if trial.panels}
    assert found == {("pairs", "pictures"), ("rating", "none")}


def test_check_tells_what_is_turned_round_and_what_is_not() -> None:
    notes = " ".join(summarise(tiny(defaults={"mirror": "sides"})).notes)
    assert "block pairs: mirror: sides: slot left stands on the right" in notes
    assert "block rating: mirror: sides changes nothing" in notes
    assert "mirror" not in " ".join(summarise(tiny()).notes)


def test_another_word_is_an_error_at_its_line(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(TEXT + "defaults: {mirror: both}\n")
    with pytest.raises(InputError, match=r"s\.yaml:\d+:12: defaults\.mirror: got 'both', wanted .*pictures"):
        load_study(file)


def test_editors_are_told_the_words() -> None:
    mirror = protocol_schema()["$defs"]["Settings"]["properties"]["mirror"]
    assert mirror["anyOf"][0]["enum"] == ["none", "sides", "pictures"]
