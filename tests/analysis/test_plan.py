"""The stated plan decides; every planned test is in the results; without one a design gives its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import analysis
from analysis.apa import sentences
from analysis.exclusions import apply_exclusions
from analysis.plan import plan_of, run_plan
from analysis.planned_test import Result
from analysis.sessions import combine, read_sessions
from stimuli.errors import InputError
from tests.analysis.fabricate import demo_study, foveated_study


def results_of(folder: Path) -> list[Result]:
    sessions = read_sessions([folder])
    kept = apply_exclusions(combine(sessions), (), sessions).kept
    return run_plan(plan_of(sessions, kept), kept)


def planned(folder: Path, *tests: dict[str, Any], participants: int = 6, **plan: Any) -> list[Result]:
    demo_study(folder, participants=participants, analysis_plan={"tests": list(tests), **plan})
    return results_of(folder)


RATING = {"question": "smooth", "within": ["condition"]}


def test_a_stated_test_is_the_function_on_its_rows(tmp_path: Path) -> None:
    result = planned(tmp_path, {"name": "t", "test": "rm_anova", **RATING})[0]
    sessions = read_sessions([tmp_path])
    rated = combine(sessions).query("kind == 'likert'")
    direct = analysis.rm_anova(rated, dv="rating_smooth", within=["condition"], subject="participant")
    assert result.table["F"].iloc[0] == pytest.approx(direct["F"].iloc[0], rel=1e-12)
    assert result.n_subjects == 6


@pytest.mark.parametrize(
    "test",
    [
        {"test": "friedman", **RATING},
        {"test": "posthoc_t", **RATING},
        {"test": "aligned_rank_anova", **RATING},
        {"test": "wilcoxon", "a": "tdrt_240", "b": "vanilla_60", **RATING},
        {"test": "tost", "a": "tdrt_240", "b": "taa_240", "low": -1.0, "high": 1.0, **RATING},
        {"test": "likert_summary", "question": "smooth", "separately_by": ["condition"]},
        {
            "test": "linear_mixed",
            "question": "smooth",
            "formula": "rating_smooth ~ condition",
            "random": "(1|participant)",
        },
        {"test": "cumulative_link", "question": "smooth", "formula": "rating_smooth ~ condition"},
        {"test": "binomial_choice", "dv": "choice", "choice": "tdrt_240", "p0": 0.5},
        {"test": "binomial_mixed", "dv": "choice", "choice": "tdrt_240"},
        {"test": "bradley_terry", "dv": "choice"},
        {"test": "thurstone", "dv": "choice", "unit": "jod"},
        {"test": "agreement", "question": "smooth"},
        {"test": "dprime", "dv": "choice", "choice": "tdrt_240"},
    ],
    ids=lambda test: test["test"],
)
def test_every_kind_of_test_gives_a_table(tmp_path: Path, test: dict[str, Any]) -> None:
    result = planned(tmp_path, {"name": "one", **test}, participants=8)[0]
    assert len(result.table) > 0
    assert not (result.table["status"] == "undefined").all(), result.table["note"].tolist()


def test_what_cannot_be_computed_stays_with_its_reason(tmp_path: Path) -> None:
    found = planned(
        tmp_path,
        {"name": "a", "test": "rm_anova", "within": ["weather"], "question": "smooth"},
        {"name": "b", "test": "friedman", "block": "nowhere", **RATING},
        {"name": "c", "test": "tost", **RATING},
        {"name": "d", "test": "friedman", **RATING},
    )
    assert [result.test.name for result in found] == ["a", "b", "c", "d"]
    notes = [result.table["note"].iloc[0] for result in found]
    assert "'weather'" in notes[0]
    assert "no analysed trial" in notes[1]
    assert "both bounds" in notes[2]
    assert found[3].table["status"].iloc[0] == "ok"


def test_separately_by_gives_one_table_with_its_levels(tmp_path: Path) -> None:
    found = planned(tmp_path, {"name": "t", "test": "friedman", "separately_by": ["scene"], **RATING})
    assert len(found) == 1
    assert found[0].table["scene"].tolist() == ["bar", "toy_car"]


def test_sentences_name_the_levels_that_a_test_is_made_for(tmp_path: Path) -> None:
    found = planned(tmp_path, {"name": "pairs", "test": "posthoc_t", "separately_by": ["scene"], **RATING})
    said = sentences(found[0])
    assert [one.split(": t(")[0].rsplit(", ", 1)[0] for one in said] == ["pairs, bar"] * 3 + ["pairs, toy_car"] * 3
    assert len(set(said)) == 6


def test_f_is_told_where_only_mauchlys_test_needs_more_participants(tmp_path: Path) -> None:
    test = {"test": "rm_anova", "question": "smooth", "within": ["condition", "scene"]}
    found = planned(tmp_path, {"name": "t", **test}, participants=2)[0]
    row = found.table.set_index("effect").loc["condition"]
    assert row["status"] == "too_few_subjects"
    assert np.isfinite(row["p"])
    said = next(one for one in sentences(found) if "t, condition: " in one)
    assert "F(" in said
    assert said.endswith(f"({row['note']}).")


def test_a_summary_by_the_condition_under_another_name_names_it_once(tmp_path: Path) -> None:
    summary = {"test": "likert_summary", "question": "smooth"}
    tests = [{"name": "t", "separately_by": ["scene"], **summary}, {"name": "u", "separately_by": ["look"], **summary}]
    demo_study(tmp_path, participants=3, analysis_plan={"tests": tests})
    sessions = read_sessions([tmp_path])
    kept = apply_exclusions(combine(sessions), (), sessions).kept
    by_scene, by_look = run_plan(plan_of(sessions, kept), kept.assign(look=kept["condition"]))
    assert list(by_scene.table)[:2] == ["scene", "condition"]
    assert "condition" not in by_look.table
    assert by_look.table["look"].tolist() == ["taa_240", "tdrt_240", "vanilla_60"]


def test_where_chooses_rows(tmp_path: Path) -> None:
    test = {"name": "t", "test": "posthoc_t", "where": {"condition": ["tdrt_240", "taa_240"]}, **RATING}
    assert len(planned(tmp_path, test)[0].table) == 1


def test_a_family_is_adjusted_together(tmp_path: Path) -> None:
    pairs = [("tdrt_240", "taa_240"), ("tdrt_240", "vanilla_60"), ("taa_240", "vanilla_60")]
    tests = [{"name": a + b, "test": "wilcoxon", "a": a, "b": b, "family": "pairs", **RATING} for a, b in pairs]
    found = planned(tmp_path, *tests, participants=10)
    p = np.array([float(result.table["p"].iloc[0]) for result in found])
    adjusted = np.array([float(result.table["p_family"].iloc[0]) for result in found])
    assert np.allclose(adjusted, analysis.adjust_p(p, "holm"))
    assert "3 tests of family 'pairs'" in found[0].notes[-1]


def test_an_unknown_test_is_the_users_mistake(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown test"):
        planned(tmp_path, {"name": "t", "test": "tarot"})


def test_without_a_plan_the_design_gives_the_tests(tmp_path: Path) -> None:
    foveated_study(tmp_path, participants=5, refreshes=8)
    found = results_of(tmp_path)
    assert [result.test.test for result in found][:4] == ["rm_anova", "aligned_rank_anova", "friedman", "posthoc_t"]
    anova = found[0].table.set_index("effect")
    assert len(anova) == 7
    assert anova.loc["condition", "p"] < 1e-3
