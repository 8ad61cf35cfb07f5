"""Session files to one row a trial; kinds never mixed; damaged files refused in one line."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from analysis import load_sessions
from analysis.sessions import TRIAL_COLUMNS, read_session, session_paths
from analysis.streams import read_flips, read_gaze
from stimuli.errors import InputError
from tests.analysis.fabricate import DEMO_CONDITIONS, DEMO_MODEL, choice_plan, demo_study, foveated_study, write_session


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("sessions")
    demo_study(where, participants=3, gaze_hz=60)
    return where


def test_one_row_a_trial_with_the_columns_of_the_contract(folder: Path) -> None:
    table = load_sessions(folder)
    assert len(table) == 3 * 15
    assert list(table.columns[: len(TRIAL_COLUMNS)]) == TRIAL_COLUMNS
    wanted = (
        "participant observer_kind trial block kind scene technique side response rating rt_s missed excluded reason"
    )
    assert set(wanted.split()) <= set(table.columns)
    assert set(table["participant"]) == {"P01", "P02", "P03"}


def test_a_choice_names_winner_and_loser_and_the_slot(folder: Path) -> None:
    table = load_sessions(folder)
    chosen = table[table["winner"].notna()]
    for row in chosen.to_dict("records"):
        assert row[f"slot_{row['side']}"] == row["winner"] == row["response"]
        assert sorted([row["winner"], row["loser"]]) == row["condition"].split("|")


def test_every_question_of_a_rating_trial_is_kept(folder: Path) -> None:
    rated = load_sessions(folder).query("kind == 'likert'")
    assert (rated["rating"] == rated["rating_artifact_free"]).all()
    assert rated["rating_smooth"].between(-3, 3).all()
    assert (rated["rt_s_smooth"] > 0).all()


def test_practice_and_catch_trials_are_left_out_with_their_reason(folder: Path) -> None:
    table = load_sessions(folder)
    assert set(table.loc[table["practice"], "reason"]) == {"practice"}
    assert set(table.loc[table["catch"], "reason"]) == {"catch trial (tested, not analysed)"}
    assert not table.loc[~table["practice"] & ~table["catch"], "excluded"].any()


def test_design_factors_are_columns(tmp_path: Path) -> None:
    foveated_study(tmp_path, participants=1, refreshes=8)
    table = load_sessions(tmp_path)
    assert table.groupby(["condition", "scene", "fixation"]).size().eq(2).all()
    assert len(table) == 96


def test_person_and_simulated_are_never_mixed(folder: Path, tmp_path: Path) -> None:
    demo_study(tmp_path, participants=1, observer_kind="person")
    with pytest.raises(InputError, match="answers are never mixed"):
        load_sessions([folder, tmp_path])


def test_a_trial_of_the_other_kind_inside_a_file_is_refused(tmp_path: Path) -> None:
    path = demo_study(tmp_path, participants=1)[0]
    with sqlite3.connect(path) as db:
        db.execute("UPDATE trials SET observer_kind = 'person' WHERE trial = 3")
    with pytest.raises(InputError, match="trial 3: observer_kind"):
        read_session(path)


def test_the_same_run_twice_is_refused(folder: Path, tmp_path: Path) -> None:
    first = session_paths([folder])[0]
    copy = tmp_path / "copy.sqlite"
    shutil.copy(first, copy)
    with pytest.raises(InputError, match="the same run twice"):
        load_sessions([first, copy])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "without a header"),
        (b"no database, though long enough for one" * 9, "not a readable session"),
    ],
)
def test_what_is_no_session_is_said_in_one_line(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "broken.sqlite"
    path.write_bytes(content)
    with pytest.raises(InputError, match=said) as caught:
        read_session(path)
    assert "\n" not in str(caught.value)


def test_a_missing_path_and_an_empty_folder_are_both_named(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        session_paths([tmp_path / "nowhere", tmp_path])
    assert len(caught.value.problems) == 2


def test_another_schema_version_is_refused(tmp_path: Path) -> None:
    path = demo_study(tmp_path, participants=1, header={"schema_version": 99})[0]
    with pytest.raises(InputError, match="schema_version: got 99"):
        read_session(path)


def test_a_session_without_answers_still_loads(tmp_path: Path) -> None:
    path = demo_study(tmp_path, participants=1)[0]
    with sqlite3.connect(path) as db:
        db.execute("DROP TABLE responses")
    table = load_sessions(path)
    assert len(table) == 15
    assert table["excluded"].all()


def test_a_session_without_trials_still_loads(tmp_path: Path) -> None:
    path = demo_study(tmp_path, participants=1)[0]
    with sqlite3.connect(path) as db:
        for name in ("trials", "responses", "flips"):
            db.execute(f"DROP TABLE {name}")
    assert len(load_sessions(path)) == 0


def test_streams_come_back_as_written(folder: Path) -> None:
    session = read_session(session_paths([folder])[0])
    flips = read_flips(session)
    assert sorted(flips) == list(range(15))
    assert all(len(record) == 48 for record in flips.values())
    gaze = read_gaze(session)["tracker"]
    assert np.all(np.diff(gaze["mapped_ns"]) > 0)


def test_a_read_only_folder_is_enough(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    path = write_session(tmp_path / "a.sqlite", "A", choice_plan(DEMO_CONDITIONS, ("bar",), rng), DEMO_MODEL, rng)
    path.chmod(0o444)
    before = sorted(tmp_path.iterdir())
    assert len(load_sessions(path)) > 0
    assert sorted(tmp_path.iterdir()) == before
