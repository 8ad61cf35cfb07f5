"""Six scenes or more are a random factor; what ``match`` makes equal is compared with the cost that clips carry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import analysis
from analysis.matching import match_checks, measured, unmatched_comparisons
from analysis.report import analyse
from analysis.sessions import read_sessions
from tests.analysis.fabricate import cost_s, demo_study

PLAN = {
    "tests": [
        {"name": "smooth", "test": "rm_anova", "question": "smooth", "within": ["condition"]},
        {"name": "dense", "test": "binomial_choice", "dv": "choice", "choice": "tdrt_240",
         "where": {"condition": ["tdrt_240|vanilla_60"]}},
    ]
}  # fmt: skip
PROTOCOL = """
study: fabricated
match:
  - {cost: ms_on_machine, conditions: [tdrt_240, vanilla_60], to: vanilla_60, tolerance: 0.05}
  - {quality: flip, conditions: [taa_240], target: 0.05}
"""


def blocks(results: dict[str, Any], identity: str) -> list[dict[str, Any]]:
    return next(one["blocks"] for one in results["sections"] if one["id"] == identity)


def test_six_scenes_are_a_random_factor(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=5, scenes=[f"s{i}" for i in range(6)], analysis_plan=PLAN)
    tests = blocks(analyse([tmp_path]), "tests")
    tables = {block["caption"]: block for block in tests if block["type"] == "table"}
    model = next(block for caption, block in tables.items() if caption.startswith("smooth, scenes random"))
    assert "(1|scene)" in model["note"]
    assert "condition: F(" in model["note"]
    trials = analysis.load_sessions(tmp_path).query("kind == 'likert'")
    random = ["(1|scene)", "(1|scene:condition)", "(1|participant)", "(1|participant:condition)"]
    direct = analysis.linear_mixed(trials, "rating_smooth ~ condition", random=random)
    assert model["rows"][1]["estimate"] == pytest.approx(direct["estimate"].iloc[1], rel=1e-9)
    assert any(caption.startswith("dense, scenes random") for caption in tables)
    assert any("a random factor" in " ".join(block.get("paragraphs", ())) for block in tests)


def test_fewer_scenes_are_these_scenes_only(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=3, analysis_plan=PLAN)
    tests = blocks(analyse([tmp_path]), "tests")
    assert any("these scenes only" in " ".join(block.get("paragraphs", ())) for block in tests)
    assert not any("scenes random" in block.get("caption", "") for block in tests)


def test_match_is_compared_with_the_cost_of_the_clips(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=2, header={"protocol_text": PROTOCOL})
    made = match_checks(read_sessions([tmp_path]))
    dense = made[made["condition"] == "tdrt_240"]
    assert dense["scene"].tolist() == ["bar", "toy_car"]
    assert dense["difference"].tolist() == pytest.approx([cost_s("tdrt_240") / cost_s("vanilla_60") - 1] * 2)
    assert dense["matched"].tolist() == ["no", "no"]
    assert made[made["condition"] == "vanilla_60"]["matched"].tolist() == ["yes", "yes"]
    unseen = made[made["measure"] == "flip"].iloc[0]
    assert unseen["status"] == "undefined"
    assert "no pictures" in unseen["note"]
    words = [" ".join(b.get("paragraphs", ())) for b in blocks(analyse([tmp_path]), "manipulation")]
    assert any("Not equal within the stated tolerance: tdrt_240, bar: ms_on_machine" in text for text in words)


def test_measures_of_a_cost_file() -> None:
    frames = [{"rays": {"primary": 100, "shadow": 50}, "seconds": {"total": s}} for s in (0.001, 0.002, 0.009)]
    assert measured({"frames": frames}, "samples_per_s", 240) == 24_000
    assert measured({"frames": frames}, "rays_per_s", 60) == 9_000
    assert measured({"frames": frames}, "ms_on_machine", 60) == 2.0
    assert measured({}, "rays_per_s", 60) != measured({}, "rays_per_s", 60)


def test_a_comparison_that_nothing_makes_equal_is_labelled(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=2)
    said = [" ".join(b.get("paragraphs", ())) for b in blocks(analyse([tmp_path]), "manipulation")]
    (label,) = [text for text in said if text.startswith("Unmatched comparison")]
    for condition in ("tdrt_240", "vanilla_60", "taa_240"):
        assert condition in label
    # What a match names is not called so, whether it was reached or not.
    header = {"protocol_text": PROTOCOL}
    demo_study(tmp_path / "matched", participants=2, header=header)
    loose = dict(unmatched_comparisons(read_sessions([tmp_path / "matched"])))
    assert not {"tdrt_240", "vanilla_60", "taa_240"} & {name for names in loose.values() for name in names}
