"""Each rule leaves out exactly what it names, with its reason."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from analysis.exclusions import apply_exclusions, compare_with_lock, exclusion_lock, parse_rules, rules_of
from analysis.sessions import combine, read_sessions
from stimuli.errors import InputError
from tests.analysis.fabricate import DEMO_CONDITIONS, Model, choice_plan, demo_study, likert_plan, write_session


def excluded(folder: Path, *rules: dict) -> dict[tuple[str, int], str]:
    sessions = read_sessions([folder])
    result = apply_exclusions(combine(sessions), parse_rules(rules), sessions)
    always = result.table["practice"] | result.table["catch"]
    rows = result.table[result.table["excluded"] & ~always]
    return {(row.participant, row.trial): row.reason for row in rows.itertuples()}


def test_missed_refreshes_leaves_out_that_trial_only(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=2, missed={5: 2, 6: 1})
    found = excluded(tmp_path, {"rule": "missed_refreshes", "limit": 1})
    assert found == {(p, 5): "more than 1 missed refreshes" for p in ("P01", "P02")}


def test_a_trial_whose_timing_failed_is_never_analysed(tmp_path: Path) -> None:
    path = demo_study(tmp_path, participants=1)[0]
    with sqlite3.connect(path) as db:
        db.execute("UPDATE trials SET status = 'timing_failed' WHERE trial = 4")
    assert excluded(tmp_path) == {("P01", 4): "not shown whole: timing_failed"}


@pytest.mark.parametrize(("rule", "nanoseconds"), [("too_fast", 1), ("too_slow", 70_000_000_000)])
def test_response_times_out_of_range(tmp_path: Path, rule: str, nanoseconds: int) -> None:
    path = demo_study(tmp_path, participants=1)[0]
    with sqlite3.connect(path) as db:
        db.execute("UPDATE responses SET rt_ns = ? WHERE trial = 4", (nanoseconds,))
    assert list(excluded(tmp_path, {"rule": rule})) == [("P01", 4)]


def test_an_answer_in_time_is_needed(tmp_path: Path) -> None:
    path = demo_study(tmp_path, participants=1)[0]
    with sqlite3.connect(path) as db:
        db.execute("UPDATE responses SET timed_out = 1, answer = NULL, chosen = NULL WHERE trial = 4")
        db.execute("DELETE FROM responses WHERE trial = 5")
    assert excluded(tmp_path) == {("P01", 4): "no answer in time", ("P01", 5): "no answer"}


def test_failed_catch_trials_exclude_the_participant(tmp_path: Path) -> None:
    path = demo_study(tmp_path, participants=2)[0]
    with sqlite3.connect(path) as db:
        catch = "SELECT trial FROM trials WHERE catch = 1"
        db.execute(f"UPDATE responses SET answer = 'neither', chosen = NULL WHERE trial IN ({catch})")
    found = excluded(tmp_path, {"rule": "catch", "limit": 0.6})
    assert {participant for participant, _ in found} == {"P01"}
    assert len(found) == 12
    assert set(found.values()) == {"participant excluded: 0 of 2 catch trials right, 60% needed"}


def test_one_side_always_is_found_by_side_bias_and_straight_lining(tmp_path: Path) -> None:
    model = Model(side_bias=60.0)
    for name, own in (("biased", model), ("fair", Model())):
        rng = np.random.default_rng(3)
        plan = choice_plan(DEMO_CONDITIONS, ("a", "b", "c", "d"), rng, catch=0)
        write_session(tmp_path / f"{name}.sqlite", name, plan, own, rng)
    for rule in ("side_bias", "straight_lining"):
        assert {participant for participant, _ in excluded(tmp_path, {"rule": rule})} == {"biased"}


def test_an_unfinished_session_is_incomplete(tmp_path: Path) -> None:
    path = demo_study(tmp_path, participants=2)[0]
    with sqlite3.connect(path) as db:
        db.execute("DELETE FROM trials WHERE trial > 8")
        db.execute("DELETE FROM responses WHERE trial > 8")
    assert {participant for participant, _ in excluded(tmp_path, {"rule": "incomplete"})} == {"P01"}


def gaze_study(folder: Path) -> None:
    for name, error in (("steady", 0.3), ("wandering", 8.0)):
        rng = np.random.default_rng(4)
        plan = likert_plan({"condition": ("a", "b"), "fixation": ("fixed", "free")}, ("clean",), rng)
        write_session(folder / f"{name}.sqlite", name, plan, Model(), rng, gaze_hz=250, gaze_error_dva=error)


def test_gaze_off_fixation_looks_only_where_a_mark_was_shown(tmp_path: Path) -> None:
    gaze_study(tmp_path)
    found = excluded(tmp_path, {"rule": "gaze_off_fixation", "limit": 3})
    assert len(found) == 2
    assert {participant for participant, _ in found} == {"wandering"}
    people = excluded(tmp_path, {"rule": "gaze_off_fixation", "limit": 3, "of": "participant"})
    assert len(people) == 4


def test_lost_gaze_excludes_the_trials(tmp_path: Path) -> None:
    gaze_study(tmp_path)
    assert len(excluded(tmp_path, {"rule": "gaze_loss", "limit": 0.0})) == 8
    assert excluded(tmp_path, {"rule": "gaze_loss", "limit": 0.5}) == {}


def test_unknown_rules_and_keys_are_all_named() -> None:
    with pytest.raises(InputError) as caught:
        parse_rules([{"rule": "mood"}, {"rule": "catch", "minimum": 1}, {"rule": "catch", "of": "trial"}])
    assert len(caught.value.problems) == 3


def test_rules_come_from_the_sessions_plan(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=2, analysis_plan={"exclusions": [{"rule": "too_fast", "limit": 0.1}]})
    assert [(rule.name, rule.limit) for rule in rules_of(read_sessions([tmp_path]))] == [("too_fast", 0.1)]


def test_the_lock_notices_other_exclusions(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=2, missed={5: 2})
    sessions = read_sessions([tmp_path])
    table = combine(sessions)
    loose, strict = (apply_exclusions(table, parse_rules(r), sessions) for r in ([], [{"rule": "missed_refreshes"}]))
    lock = exclusion_lock(strict, sessions)
    assert compare_with_lock(lock, exclusion_lock(strict, sessions)) == []
    assert len(compare_with_lock(lock, exclusion_lock(loose, sessions))) == 2
