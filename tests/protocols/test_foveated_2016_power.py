"""The generating model of foveated_2016 is recovered: a few studies of `tests.prove.foveated_2016_power`."""

from __future__ import annotations

from protocols.design import plan
from protocols.load import load_study
from tests.prove.foveated_2016_power import NAME, prove, true_means


def test_the_truth_is_what_the_paper_says() -> None:
    study = load_study(NAME)
    truth = true_means(study, plan(study, 1))
    assert abs(truth["fixation=moving"] - 0.99) < 0.005
    assert abs(truth["fixation=free"] - 0.43) < 0.005
    assert abs(truth["frc=small"] - (0.6167 - 0.72)) < 0.01


def test_a_few_studies_give_back_what_they_were_made_from() -> None:
    evidence = prove(studies=10, participants=15, jobs=1)
    assert evidence["faults"] == []
    assert evidence["found"]["frc"]["found"] == 1.0
    assert evidence["medium_equals_full"] >= 0.7
