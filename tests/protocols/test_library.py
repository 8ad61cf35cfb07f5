from __future__ import annotations

import pytest

from protocols import load_study
from protocols.check import size_problems, summarise
from protocols.design import plan
from protocols.load import LIBRARY
from protocols.simulated_table import simulated_rows

NAMES = sorted(file.stem for file in LIBRARY.glob("*.yaml"))


def test_all_seed_studies_are_there() -> None:
    wanted = {
        "demo",
        "temporally_dense_2019",
        "foveated_2016",
        "four_techniques",
        "adaptive_frameless_2005",
        "herr_2021",
    }
    assert wanted <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_study_is_valid_balanced_and_simulated(name: str) -> None:
    study = load_study(name)
    assert study.study == name
    assert size_problems(study) == []
    summary = summarise(study)
    for block in summary.blocks:
        for what, (least, most) in block.balance.items():
            assert most - least <= (1 if what == "first_minus_last_slot" else 0), (block.name, what)
    rows = simulated_rows(study, 3, 0)
    assert len({row["participant"] for row in rows}) == 3
    assert all(row["response"] is not None for row in rows)
    assert study.analysis.tests
    assert study.observer.source


@pytest.mark.parametrize("name", [n for n in NAMES if n != "demo"])
def test_a_seed_study_says_what_it_repeats_and_where_it_differs(name: str) -> None:
    replication = load_study(name).replication
    assert replication is not None
    assert replication.deviations or replication.kind == "proposal"


def test_the_foveated_study_has_the_papers_design() -> None:
    trials = plan(load_study("foveated_2016"), 1)
    shown = [t for t in trials if t.panels and not t.practice]
    assert len(shown) == 96
    assert len([t for t in trials if t.practice]) == 6
    assert {len({t.factors[f] for t in shown}) for f in ("scene", "frc")} == {4}
    assert {t.factors["fixation"] for t in shown} == {"fixed", "moving", "free"}
    assert all(t.panels[0].live == (t.fixation == "free") for t in shown)
    assert all([q.name for q in t.questions] == ["artifacts", "confidence"] for t in shown)
    assert {p.rate_hz for t in shown for p in t.panels} == {"80"}
    assert {p.params["configuration"] for t in shown for p in t.panels} == {"small", "medium", "large", "full"}


def test_the_temporally_dense_study_asks_each_person_once() -> None:
    study = load_study("temporally_dense_2019")
    (trial,) = [t for t in plan(study, 1) if t.panels]
    assert study.participants.target == 35
    assert trial.panels[1].role == "reference"
    assert trial.panels[1].params["spp"] == 256
    assert {p.rate_hz for p in trial.panels} == {"60", "240"}


def test_gaze_contingent_techniques_never_stand_side_by_side() -> None:
    trials = [t for t in plan(load_study("four_techniques"), 1) if t.panels]
    kinds = {t.kind for t in trials if {p.technique for p in t.panels} & {"foveated", "polar"}}
    assert kinds == {"two_interval", "likert"}


def test_the_demo_is_small_and_shows_60_beside_240() -> None:
    study = load_study("demo")
    summary = summarise(study)
    assert max(spec.size_px[0] * spec.size_px[1] for spec in summary.clips) <= 192 * 144
    assert all(spec.frame_count <= 120 for spec in summary.clips)
    shown = [t for n in (1, 2, 3) for t in plan(study, n) if t.kind == "side_by_side" and not t.catch]
    assert any({p.rate_hz for p in t.panels} == {"60", "240"} for t in shown)
    assert all(t.panels[1].role == "reference" for t in shown)
    assert "catalogue" not in {p.technique for t in shown for p in t.panels}
    assert {"foveated", "polar", "reference"}.isdisjoint(
        p.technique for t in shown for p in t.panels if p.role != "reference"
    )
