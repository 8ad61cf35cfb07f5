"""What a planned test says is complete: levels, unit, correction and family are those of the numbers beside them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import analysis
from analysis.apa import sentences
from analysis.exclusions import apply_exclusions
from analysis.plan import run_plan
from analysis.plan_tests import RUNNERS
from analysis.planned_test import Plan, Result, Test, reported_p
from analysis.sessions import combine, read_sessions
from tests.analysis.fabricate import foveated_study
from tests.analysis.test_plan import RATING, planned, results_of

PAIR = {"a": "tdrt_240", "b": "vanilla_60", **RATING}
PLAN = Plan((), 0.05, "holm", True)


def test_shares_by_condition_name_the_condition_in_the_protocols_order(tmp_path: Path) -> None:
    one = {"name": "s", "test": "likert_summary", "question": "smooth", "separately_by": ["condition"]}
    table = planned(tmp_path, one)[0].table
    rated = combine(read_sessions([tmp_path])).query("kind == 'likert'")
    means = rated.groupby("condition")["rating_smooth"].mean()
    assert len(table) == len(means) > 1
    assert dict(zip(table["condition"], table["mean"], strict=True)) == pytest.approx(means.to_dict())


def test_levels_stand_as_the_plan_lists_them(tmp_path: Path) -> None:
    planned(tmp_path, {"name": "unused", "test": "friedman", **RATING})
    kept = combine(read_sessions([tmp_path]))
    test = Test("s", "likert_summary", options={"question": "smooth"}, separately_by=("condition",))
    order = ["vanilla_60", "taa_240", "tdrt_240"]
    plan = replace(PLAN, tests=(test,), scales={"smooth": (-3, 3)}, levels={"condition": order})
    found = run_plan(plan, kept)[0].table["condition"].tolist()
    assert found == [name for name in order if name in found]
    assert len(found) > 1


@pytest.mark.parametrize(("test", "more"), [("tost", {"low": -1.0, "high": 1.0}), ("wilcoxon", {})])
def test_paired_tests_name_what_is_taken_from_what(tmp_path: Path, test: str, more: dict[str, Any]) -> None:
    result = planned(tmp_path, {"name": "pair", "test": test, **PAIR, **more}, participants=8)[0]
    assert result.table["comparison"].tolist() == ["tdrt_240 − vanilla_60"]
    assert "pair, tdrt_240 − vanilla_60: " in sentences(result)[0]


def test_equivalence_is_told_with_the_t_of_its_p(tmp_path: Path) -> None:
    result = planned(tmp_path, {"name": "e", "test": "tost", "low": -1.0, "high": 3.0, **PAIR}, participants=8)[0]
    row = result.table.iloc[0]
    t = row["t_low"] if row["p_low"] > row["p_high"] else row["t_high"]
    assert f"t(7) = {t:.2f}".replace("-", "−") in sentences(result)[0]
    assert max(stats.t.sf(row["t_low"], 7), stats.t.cdf(row["t_high"], 7)) == pytest.approx(row["p"])


def test_abilities_are_differences_from_a_named_origin(tmp_path: Path) -> None:
    result = planned(tmp_path, {"name": "bt", "test": "bradley_terry", "dv": "choice", "unit": "jod"})[0]
    origin, *others = sentences(result)
    first = result.table["item"].iloc[0]
    assert f"{first} is the origin of the scale (0 logits)" in origin
    for said, row in zip(others, result.table.iloc[1:].to_dict("records"), strict=True):
        assert f"{row['item']} − {first}: {row['ability']:.2f} logits".replace("-", "−") in said


def test_a_family_of_one_level_is_that_level(tmp_path: Path) -> None:
    """Holm is taken within each scene where the plan names no family, and the sentence counts those tests only."""
    foveated_study(tmp_path, participants=4)
    kept = combine(read_sessions([tmp_path]))
    question = next(name for name in kept if name.startswith("rating_")).removeprefix("rating_")
    test = Test("p", "posthoc_t", within=("condition",), options={"question": question}, separately_by=("scene",))
    result = run_plan(replace(PLAN, tests=(test,)), kept)[0]
    per_scene = result.table.groupby("scene").size().iloc[0]
    assert len(result.table) > per_scene
    assert all(f"(family of {per_scene})" in said for said in sentences(result))


@pytest.mark.parametrize(("adjust", "label"), [("bonferroni", "p_Bonferroni"), ("fdr_bh", "p_Benjamini-Hochberg")])
def test_the_plans_own_adjustment_is_made_and_named(tmp_path: Path, adjust: str, label: str) -> None:
    result = planned(tmp_path, {"name": "p", "test": "posthoc_t", **RATING}, participants=8, adjust=adjust)[0]
    assert set(result.table["status"]) == {"ok"}
    np.testing.assert_allclose(result.table["p_adjusted"], analysis.adjust_p(result.table["p"], adjust))
    assert all(label in said for said in sentences(result))


def test_a_family_corrects_the_p_that_is_told(tmp_path: Path) -> None:
    tests = [
        {"name": "a", "test": "rm_anova", "family": "f", **RATING},
        {"name": "w", "test": "wilcoxon", "family": "f", **PAIR},
    ]
    anova, wilcoxon = planned(tmp_path, *tests, participants=8)
    row = anova.table.iloc[0].to_dict()
    assert row["eps_gg"] < 0.9999
    assert reported_p(row) == row["p_gg"]
    wanted = analysis.adjust_p([row["p_gg"], wilcoxon.table["p"].iloc[0]], "holm")
    found = [anova.table["p_family"].iloc[0], wilcoxon.table["p_family"].iloc[0]]
    np.testing.assert_allclose(found, wanted)
    assert all("p_Holm" in said and "(family of 2)" in said for said in [*sentences(anova), *sentences(wilcoxon)])


def test_aligned_ranks_say_nothing_of_mauchly(tmp_path: Path) -> None:
    foveated_study(tmp_path, participants=4)
    kept = combine(read_sessions([tmp_path]))
    dv = next(name for name in kept if name.startswith("rating_"))
    own = kept[np.isfinite(kept[dv].astype(float))]
    table = RUNNERS["aligned_rank_anova"](own, dv, Test("r", "aligned_rank_anova", within=("condition", "scene")), PLAN)
    assert np.isfinite(table["F"]).all()
    assert set(table["status"]) == {"ok"}
    assert not any(name.startswith("mauchly") for name in table)


def test_thresholds_have_errors_over_participants() -> None:
    rng = np.random.default_rng(4)
    levels = np.tile(np.linspace(-2, 2, 5), 40)
    shifts = np.repeat([-1.5, -0.5, 0.5, 1.5], 50)
    table = pd.DataFrame({"x": levels, "participant": np.repeat(list("abcd"), 50)})
    table["right"] = (rng.random(200) < 1 / (1 + np.exp(-2 * (levels - shifts)))).astype(float)
    test = Test("t", "psychometric", dv="correct", options={"x": "x"})
    found = RUNNERS["psychometric"](table, "right", test, PLAN)
    pooled = table.groupby("x")["right"].agg(k="sum", n="count").reset_index()
    wald = analysis.psychometric(pooled, x="x", k="k", n="n")
    assert found["estimate"].tolist() == pytest.approx(wald["estimate"].tolist())
    # participants differ by far more than their answers do
    assert found["se"].iloc[0] > 2 * wald["se"].iloc[0]
    assert "Jackknife over 4 participants" in found.attrs["method"]


def test_a_mixed_models_coefficients_say_what_is_taken_from_what_and_its_terms_come_first() -> None:
    rng = np.random.default_rng(4)
    p, c, s = (v.ravel() for v in np.indices((8, 3, 2)))
    table = pd.DataFrame({
        "participant": p, "condition": np.array(["fast", "slow", "slower"])[c], "scene": np.array(["bar", "car"])[s],
        "x": rng.normal(size=len(p)), "rating": c * s + rng.normal(size=8)[p] + rng.normal(size=len(p)),
    })  # fmt: skip
    made = analysis.linear_mixed(table, "rating ~ condition * scene + x", random="(1|participant)")
    said = sentences(Result(Test("m", "linear_mixed"), made, "", 8))
    f = {one["term"]: one for one in made.attrs["f_tests"]}["condition"]
    assert said[0].startswith(f"m, condition: F(2, {f['df2']:.1f}) = {f['F']:.2f}, p")
    b = made.set_index("term")["estimate"]
    wanted = [
        ("condition: slow − fast, at scene bar", "conditionslow"),
        ("condition: slower − fast, at scene bar", "conditionslower"),
        ("scene: car − bar, at condition fast", "scenecar"),
        ("x", "x"),
        ("condition: slow − fast × scene: car − bar", "conditionslow:scenecar"),
    ]
    for words, term in wanted:
        assert sum(one.startswith(f"m, {words}: b = {b[term]:.2f},".replace("-", "−")) for one in said) == 1
    plain = analysis.cumulative_link(table.assign(rating=np.digitize(table["rating"], [0, 1])), "rating ~ condition")
    assert sentences(Result(Test("o", "cumulative_link"), plain, "", 8))[0].startswith("o, condition: slow − fast: b")


def test_mcnemar_tells_counts_and_cochran_its_q() -> None:
    people = [f"p{i}" for i in range(9)]
    rows = [(p, "x", float(i < 7)) for i, p in enumerate(people)] + [
        (p, "y", float(i < 1)) for i, p in enumerate(people)
    ]
    own = pd.DataFrame(rows, columns=["participant", "condition", "right"])
    for kind, wanted in (
        ("mcnemar", "of 9 participants 6 said yes under x only and 0 under y only, exact McNemar test, p = .031"),
        ("cochran_q", "Cochran's Q(1) = 6.00, p = .014"),
    ):
        test = Test("n", kind, dv="correct", within=("condition",))
        table = RUNNERS[kind](own, "right", test, PLAN)
        assert wanted in sentences(Result(test, table, "", 9))[0]


def test_shares_of_several_answers_name_their_test(tmp_path: Path) -> None:
    one = {"name": "c", "test": "binomial_choice", "dv": "choice", "choice": "tdrt_240", "p0": 0.5}
    result = planned(tmp_path, one, participants=8)[0]
    row = result.table.iloc[0]
    assert row["unit"] == "participants"
    assert "Student's t test" in result.method
    shares = with_shares(tmp_path)
    t, p = stats.ttest_1samp(shares, 0.5)
    assert (row["t"], row["p"], row["df"]) == (pytest.approx(t), pytest.approx(p), 7)
    assert f"against .50: t(7) = {t:.2f}".replace("-", "−") in sentences(result)[0]


def with_shares(folder: Path) -> np.ndarray:
    """Each participant's share of comparisons with tdrt_240 that it won."""
    sessions = read_sessions([folder])
    table = apply_exclusions(combine(sessions), (), sessions).kept
    own = table[(table["winner"] == "tdrt_240") | (table["loser"] == "tdrt_240")]
    return (own["winner"] == "tdrt_240").groupby(own["participant"]).mean().to_numpy()


def test_who_lacks_a_level_is_named(tmp_path: Path) -> None:
    planned(tmp_path, {"name": "t", "test": "tost", "low": -1.0, "high": 1.0, **PAIR}, participants=8)
    assert results_of(tmp_path)[0].notes == ()
    kept = combine(read_sessions([tmp_path]))
    lost = kept[~((kept["participant"] == kept["participant"].iloc[0]) & (kept["condition"] == "vanilla_60"))]
    test = Test(
        "t", "wilcoxon", within=("condition",), options={"question": "smooth", "a": "tdrt_240", "b": "vanilla_60"}
    )
    notes = run_plan(replace(PLAN, tests=(test,)), lost)[0].notes
    assert notes == (f"left out: {kept['participant'].iloc[0]}: no value at vanilla_60",)


def test_a_pair_that_cannot_be_tested_is_named(tmp_path: Path) -> None:
    result = planned(tmp_path, {"name": "p", "test": "posthoc_t", **RATING}, participants=1)[0]
    said = sentences(result)
    pairs = [f"p, {a} − {b}: too few subjects" for a, b in zip(result.table["a"], result.table["b"], strict=True)]
    assert all(one.startswith(wanted) for one, wanted in zip(said, pairs, strict=True))
    assert len(set(said)) == len(pairs) > 1
    alone = planned(tmp_path / "w", {"name": "w", "test": "friedman", **RATING}, participants=1)[0]
    assert sentences(alone)[0].startswith("w: too few subjects")
