"""What the report says beside its tables holds for these data: methods, blocks, triads, units, captions."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from analysis.answer_sections import likert_section, preference_section
from analysis.comparisons import adaptive_level
from analysis.exclusions import apply_exclusions
from analysis.matching import unmatched_comparisons
from analysis.observers import circular_triads, triads_by_block
from analysis.plan import run_plan
from analysis.plan_tests import RUNNERS
from analysis.planned_test import Plan, Test
from analysis.quality import response_effects
from analysis.r_script import r_script
from analysis.report import analyse
from analysis.sections import design_blocks, participants_section
from analysis.sessions import Session, combine, read_sessions
from tests.analysis.fabricate import demo_study

PLAN = Plan((), 0.05, "holm", True)


def paragraphs(results: dict[str, Any], section: str) -> str:
    own = next(one for one in results["sections"] if one["id"] == section)
    return " ".join(said for block in own["blocks"] for said in block.get("paragraphs", ()))


def test_methods_speak_of_bootstraps_only_where_one_was_made(tmp_path: Path) -> None:
    scale = {"name": "s", "test": "thurstone", "dv": "choice", "unit": "jod"}
    other = {"name": "s", "test": "bradley_terry", "dv": "choice"}
    for place, test in enumerate((scale, other)):
        demo_study(tmp_path / str(place), participants=4, analysis_plan={"tests": [test]})
    said = [paragraphs(analyse([tmp_path / name]), "methods") for name in ("0", "1")]
    assert "2,000 resamples" in said[0]
    assert "resamples" not in said[1]


def test_methods_do_not_say_that_modelled_trials_were_averaged(tmp_path: Path) -> None:
    test = {"name": "m", "test": "linear_mixed", "question": "smooth", "within": ["condition"]}
    demo_study(tmp_path, participants=4, analysis_plan={"tests": [test]})
    assert "or modelled with random effects" in paragraphs(analyse([tmp_path]), "methods")


def test_triads_of_one_block_know_nothing_of_another() -> None:
    """A over B and B over C in one block, C over A in another, is no circle."""
    rows = [("p", "one", "a", "b"), ("p", "one", "b", "c"), ("p", "two", "c", "a")]
    rows += [("p", "two", "c", "d"), ("q", "one", "a", "b"), ("q", "one", "b", "c"), ("q", "one", "a", "c")]
    kept = pd.DataFrame(rows, columns=["participant", "block", "winner", "loser"])
    found = triads_by_block(kept)
    assert found[["block", "observer", "circular", "judged"]].to_numpy().tolist() == [["one", "q", 0, 1]]
    assert found["p"].isna().all()  # three conditions: nothing is tested, and the row says so
    assert (found["status"] == "undefined").all()


def test_random_choices_between_five_are_counted_exactly() -> None:
    """120 of the 1,024 outcomes of five items' ten pairs hold no circle (Kendall & Babington Smith 1940, table 9)."""
    pairs = pd.DataFrame(list(itertools.combinations("abcde", 2)), columns=["winner", "loser"])
    pairs["who"] = "p"
    row = circular_triads(pairs, winner="winner", loser="loser", observer="who").iloc[0]
    assert row["circular"] == 0
    assert row["p"] == pytest.approx(120 / 1024, rel=1e-12)


def test_a_slower_later_block_is_no_fatigue() -> None:
    rng = np.random.default_rng(8)
    rows = []
    for person in range(10):
        for trial in range(40):
            base = 0.5 if trial < 20 else 2.0
            rows.append((str(person), trial, "a" if trial < 20 else "b", base * float(np.exp(rng.normal(0, 0.2)))))
    kept = pd.DataFrame(rows, columns=["participant", "trial", "block", "rt_s"])
    kept = kept.assign(
        side=None, session="s", rating=np.nan, winner=None, loser=None, kind="likert", condition="x", scene="s"
    )
    found = response_effects(kept, []).set_index("effect").loc["practice or fatigue"]
    assert found["p"] > 0.01
    assert abs(found["mean"]) < 1.0  # pooled over blocks it was 5 log seconds in 100 trials


def test_a_question_of_two_blocks_is_shown_by_block(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=4)
    sessions = read_sessions([tmp_path])
    kept = apply_exclusions(combine(sessions), (), sessions).kept
    rated = np.isfinite(kept["rating_smooth"].astype(float))
    one = likert_section(kept, sessions)
    later = kept[rated].assign(block="later", rating_smooth=3.0)
    both = likert_section(pd.concat([kept, later], ignore_index=True), sessions)
    assert one is not None
    assert both is not None
    summary = [block for block in both["blocks"] if block.get("id", "").startswith("summary-smooth")]
    assert [block["rows"] for block in one["blocks"] if block.get("id") == "summary-smooth"] == [summary[0]["rows"]]
    assert {row["mean"] for row in summary[1]["rows"]} == {3.0}
    assert len({block.get("id") for block in both["blocks"] if "id" in block}) == sum("id" in b for b in both["blocks"])


def test_staircases_give_a_psychometric_function() -> None:
    """An adaptive block's value stands in the test's name, and right is to choose the standard."""
    assert adaptive_level("full|less@1.6e+06") == 1.6e6
    assert np.isnan(adaptive_level("full|less"))
    from analysis.plan import rows_of

    rng = np.random.default_rng(3)
    rows = []
    for person in "abcdef":
        for level in (1, 2, 3, 4, 5) * 12:
            right = rng.random() < 0.5 + 0.5 / (1 + np.exp(2 * (level - 3)))
            pair = ["full", f"less@{level}"]
            rows.append((person, "|".join(pair), pair[not right], pair[int(right)]))
    kept = pd.DataFrame(rows, columns=["participant", "condition", "winner", "loser"])
    kept = kept.assign(correct=None, side="first", response=kept["winner"], block="stair")
    test = Test("t", "psychometric", dv="correct", options={"x": "samples_per_s", "p0": 0.5, "block": "stair"})
    own, dv = rows_of(kept, test)
    assert own[dv].tolist() == [float(one == "full") for one in kept["winner"]]
    found = RUNNERS["psychometric"](own, dv, test, PLAN).set_index("parameter")
    assert found.loc["threshold", "ci_low"] < 3 < found.loc["threshold", "ci_high"]
    assert found.loc["slope", "estimate"] < 0


def test_mixed_models_do_not_count_repetitions_as_participants() -> None:
    """Observers who differ in their preference: the error of a condition's mean is between them."""
    rng = np.random.default_rng(5)
    rows = []
    for person in range(8):
        base, shift = rng.normal(0, 4), rng.normal(0, 1.5)
        for condition in ("x", "y"):
            mean = base + shift * (condition == "y")
            rows += [(str(person), condition, "s", mean + rng.normal(0, 0.3)) for _ in range(20)]
    own = pd.DataFrame(rows, columns=["participant", "condition", "scene", "rating"])
    test = Test("m", "linear_mixed", within=("condition",))
    found = RUNNERS["linear_mixed"](own, "rating", test, PLAN).set_index("term").loc["conditiony"]
    assert found["df"] == pytest.approx(7, abs=0.5)
    means = own.groupby(["participant", "condition"])["rating"].mean().unstack()
    error = (means["y"] - means["x"]).std(ddof=1) / np.sqrt(8)
    assert found["se"] == pytest.approx(error, rel=1e-3)


def test_catch_trials_are_no_unmatched_comparison() -> None:
    def trial(*conditions: str, **more: bool) -> dict[str, Any]:
        return {"block": "b", "panels": [{"role": "candidate", "condition": name} for name in conditions], **more}

    session = Session.__new__(Session)
    plan = [trial("z", "y"), trial("y", "bad", catch=True), trial("worse", "x", practice=True), trial("x", "y")]
    object.__setattr__(session, "header", {"plan": plan})
    assert unmatched_comparisons([session]) == [("b", ["x", "y", "z"])]


def test_nothing_left_out_is_no_empty_table(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=2)
    sessions = read_sessions([tmp_path])
    table = combine(sessions)
    whole = apply_exclusions(table[~table["practice"].astype(bool) & ~table["catch"].astype(bool)], (), sessions)
    assert len(whole.reasons) == 0
    assert "reasons" not in {block.get("id") for block in participants_section(whole, sessions)["blocks"]}


def test_a_proposal_without_deviations_is_said_in_words() -> None:
    text = "replication:\n  of: nobody asked this\n  kind: proposal\n"
    session = Session.__new__(Session)
    object.__setattr__(session, "header", {"protocol_text": text})
    blocks = design_blocks([session])
    assert [block["paragraphs"] for block in blocks] == [["Proposal: nobody asked this."]]


def test_no_interval_is_cut_off_at_the_scales_end(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=4)
    sessions = read_sessions([tmp_path])
    kept = apply_exclusions(combine(sessions), (), sessions).kept
    whole = np.isfinite(kept["rating_smooth"].astype(float))
    # as far apart as the scale allows: intervals reach beyond it
    high = (kept["participant"].map(hash) + kept["condition"].map(hash)) % 2 == 0
    kept.loc[whole, "rating_smooth"] = np.where(high[whole], 3.0, -3.0)
    made = likert_section(kept, sessions)
    assert made is not None
    means = [block for block in made["blocks"] if block.get("plot") == "means"]
    reached = [
        value for block in means for one in block["data"]["series"] for value in one["high"] if value is not None
    ]
    assert max(reached) > 3.2
    for block in means:
        low, top = block["data"]["y_limits"]
        assert all(value < top for one in block["data"]["series"] for value in one["high"] if value is not None)
        assert all(value > low for one in block["data"]["series"] for value in one["low"] if value is not None)


def test_a_question_that_nobody_answered_is_named(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=2)
    sessions = read_sessions([tmp_path])
    kept = apply_exclusions(combine(sessions), (), sessions).kept.assign(rating_smooth=np.nan)
    made = likert_section(kept, sessions)
    assert made is not None
    said = [words for block in made["blocks"] for words in block.get("paragraphs", ())]
    assert sum("(smooth): no analysed presentation has an answer to it." in words for words in said) == 1


def test_where_nothing_is_left_the_planned_tests_say_so(tmp_path: Path) -> None:
    plan = {
        "tests": [{"name": "t", "test": "friedman", "question": "smooth", "within": ["condition"]}],
        "exclusions": [{"rule": "too_slow", "limit": 0.000001}],
    }
    demo_study(tmp_path, participants=2, analysis_plan=plan)
    assert "none of the 1 planned tests could be made" in paragraphs(analyse([tmp_path]), "tests")


def test_the_r_script_keeps_blocks_apart() -> None:
    def asked(block: str, *names: str) -> dict[str, Any]:
        return {"block": block, "questions": [{"name": name} for name in names]}

    session = Session.__new__(Session)
    plan = [asked("first", "clean", "sure"), asked("again", "clean")]
    object.__setattr__(session, "header", {"study": "s", "plan": plan, "observer_kind": "person"})
    script = r_script([session], {"clean": {"text": "c"}, "sure": {"text": "s"}}, ["condition"], False)
    assert [line for line in script.splitlines() if "rated$block" in line] == [
        'rated <- rated[rated$block == "first", ]',
        'rated <- rated[rated$block == "again", ]',
    ]
    assert 'keep("clean, block again: ANOVA"' in script
    assert 'keep("sure: ANOVA"' in script


def staircase_answers() -> pd.DataFrame:
    """Six participants' trials of a staircase block, and of a block whose pairs were chosen as answers came."""
    rng, rows = np.random.default_rng(4), []
    for person in "abcdef":
        for level in (1, 2, 3) * 6:
            pair = ["full", f"less@{level}"]
            won = int(rng.random() < 0.4)
            rows.append((person, "stairs", "|".join(pair), pair[won], pair[1 - won]))
            rows.append((person, "pairs", "x|y", *(("x", "y") if rng.random() < 0.6 else ("y", "x"))))
    table = pd.DataFrame(rows, columns=["participant", "block", "condition", "winner", "loser"])
    return table.assign(correct=None, side="first", response=table["winner"], kind="two_interval", scene="s")


def test_trials_that_a_staircase_chose_are_counted_and_not_tested() -> None:
    kept = staircase_answers()
    checks = pd.DataFrame({"condition": [], "cost_ms": []})
    found = preference_section(kept, checks, {"stairs": "staircase", "pairs": "active_pairs"})
    assert found is not None
    blocks = {block.get("id"): block for block in found["blocks"]}
    assert [row["answers"] for row in blocks["staircase"]["rows"]] == [36, 36, 36]
    assert {row["a"] for row in blocks["pairs-pairs"]["rows"]} <= {"x", "y"}
    assert any("active_pairs" in " ".join(block.get("paragraphs", ())) for block in found["blocks"])
    tests = [
        Test(name, name, dv="choice", options={"block": block})
        for name, block in (("bradley_terry", "stairs"), ("binomial_choice", "stairs"), ("binomial_choice", "pairs"))
    ]
    tests.append(Test("t", "psychometric", dv="correct", options={"block": "stairs"}))
    plan = Plan(tuple(tests), 0.05, "holm", True, adaptive={"pairs": "active_pairs"})
    scale, share, pair, threshold = run_plan(plan, kept)
    for refused in (scale, share):
        assert refused.table["status"].tolist() == ["undefined"]
        assert "sets the shares itself" in refused.table["note"].iloc[0]
    assert any("active_pairs" in note for note in pair.notes)
    assert "guess 0.5" in threshold.method
