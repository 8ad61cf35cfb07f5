"""Refresh timing, achieved rates and gaze from streams with known answers."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from analysis.gaze import gaze_report
from analysis.manipulation import manipulation_checks
from analysis.sessions import combine, read_sessions
from analysis.timing import onset_statement, refresh_timing
from tests.analysis.fabricate import Model, cost_s, demo_study, likert_plan, write_session


def test_missed_refreshes_are_counted_and_the_worst_trial_is_traced(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=2, missed={5: 3, 7: 1})
    timing = refresh_timing(read_sessions([tmp_path]))
    assert timing.sessions["missed"].tolist() == [4, 4]
    assert timing.sessions["worst_trial_missed"].tolist() == [3, 3]
    assert timing.trace_of == "participant P01, trial 5"
    assert timing.trace["interval_ms"].max() == pytest.approx(4 * 1000 / 240, abs=0.1)
    assert timing.counts.sum() == 2 * 15 * 47


def test_achieved_rate_is_that_of_the_content(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=1)
    rates = refresh_timing(read_sessions([tmp_path])).panels.groupby("condition")["achieved_hz"].mean()
    assert rates["vanilla_60"] == pytest.approx(60, rel=2e-3)
    assert rates["tdrt_240"] == pytest.approx(240, rel=2e-3)
    assert rates["reference"] == pytest.approx(240, rel=2e-3)


def test_manipulation_checks_take_light_and_cost_from_the_clips(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=1)
    sessions = read_sessions([tmp_path])
    checks = manipulation_checks(sessions, refresh_timing(sessions), None).set_index("condition")
    for condition in ("tdrt_240", "vanilla_60", "reference"):
        assert checks.loc[condition, "cost_ms"] == pytest.approx(1000 * cost_s(condition))
        assert 0.2 <= checks.loc[condition, "luminance"] < 0.21
        assert checks.loc[condition, "rays"] == 2000
    assert np.isnan(checks["gaze_error_dva"]).all()


def test_a_light_sensor_replaces_the_software_stamp(tmp_path: Path) -> None:
    demo_study(tmp_path / "a", participants=1)
    demo_study(tmp_path / "b", participants=1, header={"certificate": {"light": {"mean_ms": 3.2, "sd_ms": 0.1}}})
    assert "software stamp" in onset_statement(read_sessions([tmp_path / "a"]))
    assert "light sensor: 3.20 ms" in onset_statement(read_sessions([tmp_path / "b"]))


def test_gaze_error_and_loss_are_those_of_the_generating_model(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    plan = likert_plan({"condition": ("a", "b"), "fixation": ("fixed", "free")}, ("clean",), rng, repetitions=4)
    write_session(tmp_path / "s.sqlite", "S", plan, Model(), rng, gaze_hz=500, gaze_error_dva=0.5, refreshes=240)
    sessions = read_sessions([tmp_path])
    gaze = gaze_report(sessions, combine(sessions))
    assert gaze is not None
    person = gaze.participants.iloc[0]
    # the median of a Rayleigh variable is sigma sqrt(2 ln 2)
    assert person["error_dva"] == pytest.approx(0.5 * np.sqrt(2 * np.log(2)), rel=0.05)
    assert person["valid_share"] == pytest.approx(0.97, abs=0.01)
    assert person["rate_hz"] == pytest.approx(500, rel=1e-3)
    known = gaze.trials.assign(known=gaze.trials["error_dva"].notna()).groupby("fixation")["known"].mean()
    assert known.to_dict() == {"fixed": 1.0, "free": 0.0}
    assert [one.name for one in gaze.maps] == ["all trials", "fixation: fixed", "fixation: free"]
    assert gaze.maps[0].share.sum() == pytest.approx(0.995, abs=0.01)


def test_half_a_million_gaze_samples_take_seconds(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    plan = likert_plan({"condition": ("a", "b")}, ("clean",), rng, repetitions=5)
    write_session(tmp_path / "s.sqlite", "S", plan, Model(), rng, gaze_hz=12_500, refreshes=960)
    sessions = read_sessions([tmp_path])
    began = time.process_time()
    gaze = gaze_report(sessions, combine(sessions))
    assert gaze is not None
    assert gaze.participants["samples"].sum() >= 490_000
    assert time.process_time() - began < 8


def test_no_gaze_gives_none(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=1)
    sessions = read_sessions([tmp_path])
    assert gaze_report(sessions, combine(sessions)) is None
