"""Slots of the design and the people in them: who is to be replaced, and that two runs are not one."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import numpy as np

import analysis
from analysis.exclusions import apply_exclusions, rules_of
from analysis.recruitment import recruitment_words
from analysis.report import analyse
from analysis.sessions import combine, read_sessions
from tests.analysis.fabricate import DEMO_CONDITIONS, Model, choice_plan, likert_plan, write_session


def sit(folder: Path, slot: int, code: str, *, biased: bool = False, replaces: bool = True, target: int = 3) -> None:
    """A session of ``code`` in ``slot``; ``biased``: always one side, which the plan excludes."""
    rng = np.random.default_rng(slot)
    plan = choice_plan(DEMO_CONDITIONS, ("a", "b", "c", "d"), rng, catch=0)
    path = folder / f"s_p{slot}_{code}.sqlite"
    write_session(path, code, plan, Model(side_bias=60.0 if biased else 0.0), rng)
    header = {
        "slot": slot,
        "recruitment": {"target": target, "replace_excluded": replaces},
        "analysis_plan": {"tests": [], "exclusions": [{"rule": "side_bias"}]},
    }
    with sqlite3.connect(path) as db:
        db.executemany("INSERT OR REPLACE INTO header VALUES (?, ?)", [(k, json.dumps(v)) for k, v in header.items()])
    db.close()


def words(folder: Path) -> str:
    sessions = read_sessions([folder])
    return " ".join(recruitment_words(sessions, apply_exclusions(combine(sessions), rules_of(sessions), sessions)))


def test_an_excluded_persons_slot_is_to_be_run_again_until_somebody_has(tmp_path: Path) -> None:
    sit(tmp_path, 1, "1")
    sit(tmp_path, 2, "2", biased=True)
    said = words(tmp_path)
    assert said.startswith("1 of the 3 slots of the protocol are filled")
    assert "again by somebody else" in said
    assert said.endswith(": 2 (of 2).")
    sit(tmp_path, 2, "K7")
    assert words(tmp_path) == "2 of the 3 slots of the protocol are filled by participants who are analysed."
    page = analyse([tmp_path])
    (section,) = [one for one in page["sections"] if one["id"] == "participants"]
    (table,) = [block for block in section["blocks"] if block.get("id") == "participants"]
    assert [(row["participant"], row["slot"], row["excluded"]) for row in table["rows"]] == [
        ("1", "1", False), ("2", "2", True), ("K7", "2", False),
    ]  # fmt: skip


def test_who_is_excluded_is_not_replaced_where_the_protocol_says_so(tmp_path: Path) -> None:
    sit(tmp_path, 1, "1", biased=True, replaces=False)
    assert words(tmp_path).endswith("is not replaced (replace_excluded: false).")


def test_two_people_of_one_slot_who_both_count_are_named(tmp_path: Path) -> None:
    sit(tmp_path, 1, "1")
    sit(tmp_path, 1, "K7")
    assert "orders are not balanced: 1 (1, K7)" in words(tmp_path)


def test_gaze_of_one_session_says_nothing_of_the_same_trials_in_another(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    plan = likert_plan({"condition": ("a", "b"), "fixation": ("fixed",)}, ("clean",), rng)
    for run, error in ((1, 8.0), (2, 0.3)):
        path = tmp_path / f"s_p1_{run}.sqlite"
        write_session(path, "1", plan, Model(), rng, gaze_hz=250, gaze_error_dva=error)
        rules = {"tests": [], "exclusions": [{"rule": "gaze_off_fixation", "limit": 3}]}
        with sqlite3.connect(path) as db:
            rows = [("run", json.dumps(run)), ("analysis_plan", json.dumps(rules))]
            db.executemany("INSERT OR REPLACE INTO header VALUES (?, ?)", rows)
        db.close()
    table = analysis.load_sessions(tmp_path)
    assert set(table.loc[table["run"] == 1, "excluded"]) == {True}
    assert set(table.loc[table["run"] == 2, "excluded"]) == {False}
