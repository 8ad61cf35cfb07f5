"""Effects that are not the pictures': found where the generating model has them, at the level where it has not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from analysis.exclusions import apply_exclusions
from analysis.quality import response_effects
from analysis.sessions import combine, read_sessions
from analysis.within_means import cell_means, one_sample
from tests.analysis.fabricate import DEMO_CONDITIONS, Model, choice_plan, write_session


def effects(folder: Path, side_bias: float) -> pd.DataFrame:
    for number in range(12):
        rng = np.random.default_rng([number, 77])
        plan = choice_plan(DEMO_CONDITIONS, tuple("abcdefgh"), rng, catch=0)
        write_session(folder / f"{number}.sqlite", str(number), plan, Model(side_bias=side_bias), rng, refreshes=4)
    sessions = read_sessions([folder])
    kept = apply_exclusions(combine(sessions), (), sessions).kept
    return response_effects(kept, sessions).set_index(["effect", "measure"])


def test_a_side_bias_is_found(tmp_path: Path) -> None:
    row = effects(tmp_path, 1.0).loc[("side", "share of 'right'")]
    assert row["mean"] == pytest.approx(1 / (1 + np.exp(-1)), abs=0.07)
    assert row["p"] < 1e-4


def test_without_a_bias_none_is_found(tmp_path: Path) -> None:
    found = effects(tmp_path, 0.0)
    assert (found["p"] > 0.01).all()
    assert found.loc[("side", "share of 'right'"), "ci_low"] < 0.5 < found.loc[("side", "share of 'right'"), "ci_high"]


def test_one_sample_says_what_is_undefined() -> None:
    assert one_sample([0.5], 0.5)["status"] == "too_few_subjects"
    assert one_sample([0.5, 0.5, 0.5], 0.5)["status"] == "zero_error_variance"
    assert one_sample([np.nan, 1.0, 2.0], 0.0)["n"] == 2


def test_cousineau_morey_interval_of_two_cells_is_that_of_the_paired_difference() -> None:
    rng = np.random.default_rng(1)
    level = rng.normal(0, 10, 9)
    a, b = level + rng.normal(0, 1, 9), level + 2 + rng.normal(0, 1, 9)
    table = pd.DataFrame({"participant": [*range(9)] * 2, "c": ["a"] * 9 + ["b"] * 9, "y": [*a, *b]})
    cells = cell_means(table, "y", ["c"])
    # for two cells the half width is that of the difference over sqrt(2)
    difference = np.std(a - b, ddof=1) / np.sqrt(9)
    half = (cells["ci_high"] - cells["ci_low"]) / 2
    assert np.allclose(half, 2.306004135 * difference / np.sqrt(2))


def test_a_participant_without_a_cell_leaves_the_interval_but_not_the_mean() -> None:
    table = pd.DataFrame({"participant": [1, 1, 2, 2, 3], "c": list("ababa"), "y": [1.0, 2.0, 2.0, 4.0, 9.0]})
    cells = cell_means(table, "y", ["c"]).set_index("c")
    assert cells.loc["a", "n"] == 3
    assert cells.loc["a", "mean"] == pytest.approx(4.0)
    assert np.isfinite(cells.loc["a", "ci_low"])


def test_one_answer_a_participant_is_tested_exactly() -> None:
    sides = ["second"] * 6 + ["first"]
    table = pd.DataFrame({"participant": list("abcdefg"), "side": sides, "kind": "two_interval", "condition": "x|y"})
    table = table.assign(session=table["participant"], trial=0, winner=None, rating=np.nan, rt_s=np.nan, block="b")
    found = response_effects(table, []).set_index("effect").loc["interval"]
    assert found["p"] == pytest.approx(16 / 128)
    assert 0 < found["ci_low"] < 0.5 < found["mean"] < found["ci_high"] < 1
    assert np.isnan(found["df"])
    assert np.isnan(one_sample([0.5], 0.5)["df"])
