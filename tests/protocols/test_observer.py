from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from protocols.design import plan
from protocols.observer import answer, draw_observer, latent_mean, trial_stream
from protocols.simulated_table import simulated_rows
from protocols.trial import is_right
from tests.protocols.tiny import pairs, rating, tiny

STILL: dict[str, Any] = {"lapse": 0, "side_bias_sd": 0, "sd": {"condition": 0}}


def rows(participants: int, seed: int = 1, **over: Any) -> list[dict[str, Any]]:
    return simulated_rows(tiny(**over), participants, seed)


def share(rows: list[dict[str, Any]], winner: str, loser: str) -> tuple[float, int]:
    met = [r for r in rows if {r["winner"], r["loser"]} == {winner, loser}]
    return sum(r["winner"] == winner for r in met) / len(met), len(met)


def z(observed: float, expected: float, n: int) -> float:
    return (observed - expected) / math.sqrt(expected * (1 - expected) / n)


@pytest.mark.parametrize("difference", [0.0, 0.7, 2.75])
def test_choices_are_logistic_in_the_difference_of_utilities(difference: float) -> None:
    observer = {**STILL, "utilities": {"full": difference, "half": 0}}
    got, n = share(rows(60, blocks=[pairs(repetitions=10)], observer=observer), "full", "half")
    assert n == 1200
    assert abs(z(got, 1 / (1 + math.exp(-difference)), n)) < 4


def test_a_scene_may_shift_a_utility_and_a_technique_name_stands_for_its_conditions() -> None:
    observer = {**STILL, "utilities": {"vanilla": 0, "dense": 0}, "scene_utilities": {"a": {"vanilla": 2.0}}}
    table = rows(60, blocks=[pairs(repetitions=5)], observer=observer)
    for scene, expected in (("a", 1 / (1 + math.exp(-2))), ("b", 0.5)):
        got, n = share([r for r in table if r["scene"] == scene], "full", "dense")
        assert abs(z(got, expected, n)) < 4


def test_lapses_and_side_bias_do_what_they_say() -> None:
    observer = {**STILL, "lapse": 1.0, "utilities": {"full": 9}}
    got, n = share(rows(60, blocks=[pairs(repetitions=5)], observer=observer), "full", "half")
    assert abs(z(got, 0.5, n)) < 4
    biased = rows(60, blocks=[pairs(repetitions=5)], observer={**STILL, "side_bias": 1.0})
    left = [r["side"] == "left" for r in biased]
    assert abs(z(float(np.mean(left)), 1 / (1 + math.exp(-1)), len(left))) < 4


def test_observers_differ_by_the_stated_sd_and_are_pure_functions() -> None:
    study = tiny(observer={"sd": {"condition": 0.8, "scene_condition": 0.3}})
    people = [draw_observer(study, n, 5) for n in range(1, 401)]
    for values, sd in (
        ([p.preference["full"] for p in people], 0.8),
        ([p.scene_preference["a", "full"] for p in people], 0.3),
    ):
        assert abs(float(np.std(values)) / sd - 1) < 4 / math.sqrt(2 * 400)
        assert abs(float(np.mean(values))) < 4 * sd / math.sqrt(400)
    assert people[6].preference == draw_observer(study, 7, 5).preference
    assert people[6].preference != draw_observer(study, 7, 6).preference


def test_an_answer_depends_on_nothing_that_came_before() -> None:
    study = tiny()
    person = draw_observer(study, 2, 3)
    trials = [t for t in plan(study, 2) if t.panels]
    forward = [answer(t, person, trial_stream(3, 2, t)) for t in trials]
    backward = [answer(t, person, trial_stream(3, 2, t)) for t in reversed(trials)]
    assert forward == backward[::-1]
    assert answer(trials[0], person, trial_stream(3, 2, trials[0], attempt=1)) is not None


@pytest.mark.parametrize(("mean", "sd"), [(0.0, 1.5), (2.6, 1.5), (-2.9, 0.4), (1.3, 0.05), (3.0, 1.0), (-99.0, 2.0)])
def test_a_cell_mean_holds_exactly_after_rounding(mean: float, sd: float) -> None:
    place = latent_mean(mean, sd, -3, 3)
    cuts = np.concatenate([[-np.inf], np.arange(-3, 3) + 0.5, [np.inf]])
    expected = float(np.sum(np.arange(-3, 4) * np.diff(ndtr((cuts - place) / sd))))
    assert expected == pytest.approx(min(max(mean, -2.98), 2.98), abs=1e-8)


def test_simulated_ratings_have_the_stated_cell_means() -> None:
    likert = {"mean": 0.5, "observer_sd": 0.5, "noise_sd": 1.2, "level_sd": {"scene": 0.3},
              "means": [{"by": ["condition"], "values": {"full": 0.8, "half": -1.9}},
                        {"by": ["condition", "scene"], "values": {"full:b": 1.0}}]}  # fmt: skip
    table = rows(400, blocks=[rating()], observer={"lapse": 0, "likert": {"clean": likert}})
    for condition, scene, expected in (
        ("full", "a", 1.3),
        ("full", "b", 2.3),
        ("half", "a", -1.4),
        ("dense", "b", 0.5),
    ):
        got = [r["rating_clean"] for r in table if (r["condition"], r["scene"]) == (condition, scene)]
        per_person = np.array(got).reshape(400, 2).mean(axis=1)
        assert abs(per_person.mean() - expected) < 4 * per_person.std() / 20


def test_thresholds_give_the_ordinal_logistic_model() -> None:
    likert = {"thresholds": [-2, -1, -0.5, 0.5, 1, 2], "noise_sd": 1.0, "observer_sd": 0.0}
    observer = {**STILL, "utilities": {"full": 0.8}, "likert": {"clean": likert}}
    got = [r["rating"] for r in rows(400, blocks=[rating()], observer=observer) if r["condition"] == "full"]
    counts = Counter(got)
    for point, threshold in zip(range(-3, 3), likert["thresholds"], strict=True):
        expected = 1 / (1 + math.exp(-(threshold - 0.8)))
        assert abs(z(sum(counts[p] for p in range(-3, point + 1)) / len(got), expected, len(got))) < 4


def test_reaction_times_are_a_shifted_lognormal_after_the_stimulus() -> None:
    observer = {"rt": {"median_s": 0.6, "sd_log": 0.3, "shift_s": 0.2, "observer_sd_log": 0}}
    study = tiny(blocks=[rating(repetitions=40)], defaults={"duration_s": 2}, observer=observer)
    times = np.array([r["rt_s"] for r in simulated_rows(study, 10, 1)]) - 2.0 - 0.2
    assert times.min() > 0
    assert abs(np.log(times).mean() - math.log(0.6)) < 4 * 0.3 / math.sqrt(times.size)
    assert abs(np.log(times).std() / 0.3 - 1) < 4 / math.sqrt(2 * times.size)


def test_a_window_that_closes_gives_no_answer() -> None:
    questions = {"closer": {"kind": "choice", "text": "?"}, "clean": {"kind": "likert", "text": "?", "window_s": 0.01}}
    table = rows(2, questions=questions, blocks=[rating()])
    assert all(r["timed_out"] for r in table)
    assert all(math.isnan(r["rating"]) for r in table)


def test_ties_are_given_where_they_are_allowed() -> None:
    questions = {"closer": {"kind": "choice", "text": "?", "ties": True}, "clean": {"kind": "likert", "text": "?"}}
    table = rows(40, questions=questions, blocks=[pairs()], observer={**STILL, "tie_width": 1.0})
    ties = [r["response"] == "tie" for r in table]
    # |logistic| < 1 with chance tanh(1/2)
    assert abs(z(float(np.mean(ties)), math.tanh(0.5), len(ties))) < 4
    assert all(r["winner"] is None for r, tie in zip(table, ties, strict=True) if tie)


def test_the_key_is_the_one_that_means_the_answer() -> None:
    study = tiny(
        questions={"closer": {"kind": "choice", "text": "?"}, "clean": {"kind": "likert", "text": "?", "balance": True}}
    )
    for n in (1, 2):
        person = draw_observer(study, n, 0)
        for trial in plan(study, n):
            for question, given in zip(trial.questions, answer(trial, person, trial_stream(0, n, trial)), strict=True):
                assert question.keys[given.key] == given.answer


def test_a_picture_driven_observer_prefers_the_smaller_error() -> None:
    study = tiny(blocks=[pairs()], observer={**STILL, "pictures": {"metric": "rmse", "logits_per_unit": 100}})
    trials = [t for t in plan(study, 1) if t.panels]
    person = draw_observer(study, 1, 0)
    errors = {"left": 0.5, "centre": 0.0, "right": 0.1}
    assert all(answer(t, person, trial_stream(0, 1, t), errors)[0].answer == "right" for t in trials)


def test_a_catch_answer_is_right_by_slot_or_within_its_range() -> None:
    assert is_right("left", "left")
    assert not is_right("left", "right", "-3")
    assert is_right("-3..-1", None, "-2")
    assert not is_right("-3..-1", "0")
    assert not is_right("-3..-1", "tie")
