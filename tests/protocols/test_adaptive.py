from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from scipy.special import expit

from protocols.adaptive import PairResult, QuestResult, StaircaseResult, active_pairs, procedure, quest_plus, staircase
from protocols.design import plan
from protocols.observer import answer, draw_observer, trial_stream
from protocols.requests import clip_spec, clip_specs
from protocols.study import varied_name, varied_value
from tests.protocols.tiny import pairs, rating, tiny


def rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def drive(procedure: Any, respond: Any) -> Any:
    """Send ``respond(question)`` until the procedure stops; what it returns."""
    try:
        asked = next(procedure)
        while True:
            asked = procedure.send(respond(asked))
    except StopIteration as end:
        return end.value


def test_a_staircase_makes_the_textbook_steps() -> None:
    answers = iter([True, True, True, True, False, True, True, False])
    result: StaircaseResult = drive(staircase([5, 4, 3, 2, 1], down=2, trials=8), lambda _: next(answers))
    assert result.values == (5, 5, 4, 4, 3, 4, 4, 3)
    assert result.reversals == (3, 4, 3)


def test_a_staircase_stops_and_never_leaves_its_values() -> None:
    always: StaircaseResult = drive(staircase([3, 2, 1], trials=40), lambda _: True)
    never: StaircaseResult = drive(staircase([3, 2, 1], trials=40), lambda _: None)
    assert always.values[-1] == 1
    assert set(never.values) == {3}
    assert math.isnan(always.threshold)


@pytest.mark.parametrize(("down", "target"), [(1, 0.5), (2, math.sqrt(0.5)), (3, 0.5 ** (1 / 3))])
def test_a_staircase_settles_where_levitt_says(down: int, target: float) -> None:
    values = np.linspace(3, -3, 61)
    source = rng(down)
    found = [
        drive(staircase(list(values), down, 300, 9000), lambda x: source.random() < expit(2 * x)).threshold
        for _ in range(20)
    ]
    expected = math.log(target / (1 - target)) / 2
    # A step of 0.1 leaves a bias of about half a step.
    assert abs(float(np.mean(found)) - expected) < 0.08


def test_quest_plus_recovers_the_threshold_within_its_own_sd() -> None:
    values = list(np.linspace(10, 0, 21))
    source = rng(5)
    zs = []
    for threshold in (2.0, 5.0, 7.5) * 8:

        def respond(x: float, at: float = threshold) -> bool:
            return bool(source.random() < 0.5 + 0.48 * expit(2.0 * (x - at)))

        result: QuestResult = drive(quest_plus(values, trials=120), respond)
        assert abs(result.threshold - threshold) < 2.0
        zs.append((result.threshold - threshold) / result.threshold_sd)
    assert abs(float(np.mean(zs))) < 0.8
    assert 0.5 < float(np.std(zs)) < 1.6


def test_quest_plus_is_bayes_rule() -> None:
    values = [3.0, 2.0, 1.0, 0.0]
    told = [True, False, True, True, False]
    answers = iter(told)
    result: QuestResult = drive(quest_plus(values, guess=0.5, lapse=0.04, trials=5), lambda _: next(answers))
    thresholds, slopes = np.linspace(-0.25, 1.25, 41), np.geomspace(2, 200, 15)
    posterior = np.ones((41, 15))
    for value, right in zip(result.values, told, strict=True):
        for a, threshold in enumerate(thresholds):
            for b, slope in enumerate(slopes):
                p = 0.5 + 0.46 / (1 + math.exp(-slope * (value / 3 - threshold)))
                posterior[a, b] *= p if right else 1 - p
    posterior /= posterior.sum()
    mean = float(posterior.sum(axis=1) @ thresholds)
    assert result.threshold == pytest.approx(3 * mean, abs=1e-9)


def test_active_pairs_learn_more_from_as_many_answers_than_random_pairs() -> None:
    names = [f"c{i}" for i in range(8)]
    errors: dict[str, list[float]] = {"active": [], "random": []}
    for seed in range(12):
        source = rng(seed)
        truth = dict(zip(names, np.linspace(-4, 4, 8), strict=True))

        def respond(
            pair: tuple[str, str], truth: dict[str, float] = truth, source: np.random.Generator = source
        ) -> str:
            return pair[0] if source.random() < expit(truth[pair[0]] - truth[pair[1]]) else pair[1]

        result: PairResult = drive(active_pairs(names, 70, rng(seed + 100)), respond)
        wins = np.zeros((8, 8))
        for _ in range(70):
            i, j = source.choice(8, 2, replace=False)
            winner = respond((names[i], names[j]))
            wins[(i, j) if winner == names[i] else (j, i)] += 1
        from protocols.adaptive import _strengths

        random_mean = _strengths(wins, 1.5)[0]
        for kind, mean in (("active", list(result.mean.values())), ("random", list(random_mean - random_mean.mean()))):
            errors[kind].append(float(np.sqrt(np.mean((np.array(mean) - np.linspace(-4, 4, 8)) ** 2))))
    assert np.mean(errors["active"]) < np.mean(errors["random"])


def test_active_pairs_start_anywhere_and_stay_deterministic() -> None:
    runs = [drive(active_pairs(list("abcd"), 20, rng(1)), lambda pair: min(pair)) for _ in range(2)]
    assert runs[0] == runs[1]
    assert runs[0].mean["a"] > runs[0].mean["d"]
    assert sum(runs[0].mean.values()) == pytest.approx(0, abs=1e-9)
    silent = drive(active_pairs(list("ab"), 3, rng(1)), lambda pair: None)
    assert silent.mean == {"a": 0.0, "b": 0.0}


def test_a_session_without_adaptive_blocks_is_its_plan() -> None:
    study = tiny()
    given: list[Any] = []
    drive(procedure(study, 3), lambda trial: given.append(trial))
    assert tuple(given) == plan(study, 3)


@pytest.mark.parametrize("kind", ["staircase", "quest_plus"])
def test_an_adaptive_block_varies_the_parameter_and_shows_only_known_clips(kind: str) -> None:
    adaptive = {
        "kind": kind,
        "parameter": "spp",
        "values": [1, 2, 4, 8, 16],
        "test": "gold",
        "standard": "full",
        "trials": 25,
    }
    block = pairs(kind="two_interval", reference=None, compare=None, adaptive=adaptive)
    study = tiny(blocks=[block, rating()], observer={"utilities": {"gold": 1, "full": 2}})
    person = draw_observer(study, 1, 0)
    shown: list[Any] = []

    def respond(trial: Any) -> str | None:
        shown.append(trial)
        return answer(trial, person, trial_stream(0, 1, trial))[0].chosen if trial.panels else None

    drive(procedure(study, 1), respond)
    varied = [t for t in shown if t.block == "pairs"]
    assert [t.index for t in shown] == list(range(len(shown)))
    assert Counter(t.scene for t in varied)["a"] > 0 < Counter(t.scene for t in varied)["b"]
    assert {p.params["spp"] for t in varied for p in t.panels if p.technique == "reference"} <= {1, 2, 4, 8, 16}
    assert len({p.condition for t in varied for p in t.panels}) > 2
    assert {clip_spec(study, t, p) for t in varied for p in t.panels} <= set(clip_specs(study))


@pytest.mark.parametrize("value", [400.0, 0.1, 1.6e6, 1234567.0, 1 / 3, -2.5, 0.0, 1e-7, 5e-324])
def test_a_varied_conditions_name_gives_its_value_back(value: float) -> None:
    assert varied_value(varied_name("less", value)) == value
    assert (varied_value("less"), varied_value("less@"), varied_value("less@x")) == (None, None, None)
    assert varied_name("less", 1234567.0) != varied_name("less", 1234568.0)
