from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocols.check import balance
from protocols.design import group_of, plan
from protocols.trial import Trial
from stimuli.errors import InputError
from tests.protocols.tiny import pairs, rating, tiny

COMMON = settings(max_examples=40, deadline=None)


def main(trials: tuple[Trial, ...], block: str) -> list[Trial]:
    return [t for t in trials if t.block == block and t.panels and not t.practice and not t.catch]


def sides(trials: list[Trial]) -> Counter[str]:
    """Condition -> times on the first side minus times on the last."""
    count: Counter[str] = Counter()
    for trial in trials:
        first, last = [p.condition for p in trial.panels if p.role != "reference"]
        count[first] += 1
        count[last] -= 1
    return count


@COMMON
@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 4), st.integers(0, 2**40), st.integers(1, 200))
def test_every_cell_occurs_as_often_as_declared(a: int, b: int, repetitions: int, seed: int, participant: int) -> None:
    factors = {
        "scene": ["a", "b"],
        "condition": ["full"],
        "one": [f"x{i}" for i in range(a)],
        "two": [f"y{i}" for i in range(b)],
    }
    study = tiny(seed=seed, blocks=[rating(factors=factors, repetitions=repetitions)])
    trials = main(plan(study, participant), "rating")
    counts = Counter(tuple(trial.factors.values()) for trial in trials)
    assert len(counts) == 2 * a * b
    assert set(counts.values()) == {repetitions}


@COMMON
@given(st.integers(2, 7), st.integers(1, 3), st.integers(0, 2**40), st.integers(1, 100))
def test_sides_are_balanced_within_a_participant_and_mirrored_in_the_next(
    n: int, repetitions: int, seed: int, couple: int
) -> None:
    conditions: dict[str, Any] = {"gold": "reference", **{f"c{i}": "vanilla" for i in range(n)}}
    block = pairs(compare={"of": [f"c{i}" for i in range(n)]}, repetitions=repetitions)
    study = tiny(seed=seed, conditions=conditions, blocks=[block])
    odd, even = (main(plan(study, 2 * couple - 1 + k), "pairs") for k in range(2))
    assert max(abs(v) for v in sides(odd).values()) <= 1
    assert max(abs(v) for v in sides(even).values()) <= 1
    assert all(v == 0 for v in sides(odd + even).values())
    # Two repetitions of a cell stand on opposite sides.
    if repetitions == 2:
        per_cell: Counter[tuple[str, str]] = Counter()
        for trial in odd:
            per_cell[trial.factors["pair"], trial.factors["scene"]] += (
                1 if trial.panels[0].condition < trial.panels[2].condition else -1
            )
        assert all(v == 0 for v in per_cell.values())


def test_sides_are_not_the_same_for_every_couple() -> None:
    study = tiny()
    seen = {
        tuple(
            t.panels[0].condition
            for t in sorted(main(plan(study, n), "pairs"), key=lambda t: (t.scene, t.factors["pair"]))
        )
        for n in range(1, 40, 2)
    }
    assert len(seen) > 5


def test_three_alternatives_go_round_their_places() -> None:
    block = pairs(
        kind="forced_choice",
        reference=None,
        compare={"of": ["full", "half", "dense"], "alternatives": 3},
        repetitions=3,
    )
    trials = [t for n in (1, 2, 3) for t in main(plan(tiny(blocks=[block]), n), "pairs")]
    places = Counter((p.slot, p.condition) for t in trials for p in t.panels)
    assert len(places) == 9
    assert len(set(places.values())) == 1


@COMMON
@given(st.integers(0, 2**40), st.integers(1, 500))
def test_the_reference_is_in_the_middle_and_the_constraints_are_kept(seed: int, participant: int) -> None:
    block = pairs(repetitions=4, order={"max_in_a_row": {"scene": 2}, "min_distance": {"cell": 2}})
    trials = main(plan(tiny(seed=seed, blocks=[block]), participant), "pairs")
    assert all([p.slot for p in t.panels] == ["left", "centre", "right"] for t in trials)
    assert all(t.panels[1].role == "reference" and t.panels[1].condition == "gold" for t in trials)
    scenes = [t.scene for t in trials]
    assert all(len(set(scenes[i : i + 3])) > 1 for i in range(len(scenes) - 2))
    cells = [(t.scene, t.factors["pair"]) for t in trials]
    assert all(a != b for a, b in pairwise(cells))


def test_an_order_that_cannot_be_kept_is_an_input_error() -> None:
    study = tiny(
        blocks=[
            rating(factors={"scene": ["a"], "condition": ["full"]}, repetitions=3, order={"max_in_a_row": {"scene": 1}})
        ]
    )
    with pytest.raises(InputError, match="block rating: order: got max_in_a_row scene 1, wanted constraints"):
        plan(study, 1)


def test_the_plan_is_a_pure_function_and_differs_between_people_and_seeds() -> None:
    study = tiny()
    assert plan(study, 3) == plan(study, 3)
    assert plan(study, 3) != plan(study, 4)
    assert plan(study, 3) != plan(study, 3, seed=9)
    with pytest.raises(InputError, match="participant"):
        plan(study, 0)


def test_the_plan_is_the_same_in_another_process() -> None:
    script = (
        "import json; from tests.protocols.tiny import tiny; from protocols.design import plan;"
        "print(json.dumps([t.as_dict() for t in plan(tiny(), 5)], sort_keys=True))"
    )
    seeds = ("0", "1")
    made = [
        subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True, env={"PYTHONHASHSEED": s}
        )
        for s in seeds
    ]
    here = json.dumps([t.as_dict() for t in plan(tiny(), 5)], sort_keys=True)
    assert {run.stdout.strip() for run in made} == {here}


def test_a_trial_survives_json() -> None:
    for trial in plan(tiny(), 1):
        stored = json.dumps(trial.as_dict())
        assert json.dumps(Trial.from_dict(json.loads(stored)).as_dict()) == stored


def test_blocked_trials_stay_together() -> None:
    study = tiny(blocks=[rating(order={"by": "blocked", "blocked_by": "scene"})])
    scenes = [t.scene for t in main(plan(study, 1), "rating")]
    assert sum(a != b for a, b in pairwise(scenes)) == 1


def test_a_latin_order_gives_every_level_every_place() -> None:
    block = rating(
        factors={"scene": ["a"], "condition": ["gold", "full", "half", "dense"]},
        repetitions=1,
        order={"latin": "condition"},
    )
    study = tiny(blocks=[block])
    orders = [[t.factors["condition"] for t in main(plan(study, n), "rating")] for n in range(1, 5)]
    assert all(len(set(place)) == 4 for place in zip(*orders, strict=True))
    follows = Counter(pair for order in orders for pair in pairwise(order))
    assert set(follows.values()) == {1}


def test_sets_spread_over_a_factor_meet_every_level_once_in_as_many_people() -> None:
    study = tiny(blocks=[pairs(compare={"of": ["full", "half", "dense"], "spread_over": ["scene"]})])
    counts = Counter((t.factors["pair"], t.scene) for n in (1, 2) for t in main(plan(study, n), "pairs"))
    assert len(main(plan(study, 1), "pairs")) == 3
    assert len(counts) == 6
    assert set(counts.values()) == {1}


def test_groups_are_balanced_in_every_run_of_people() -> None:
    between = {"lamp": {"on": {}, "off": {}}, "seat": {"near": {}, "far": {}, "mid": {}}}
    study = tiny(participants={"between": between})
    groups = [tuple(group_of(study, n).values()) for n in range(1, 61)]
    for start in range(0, 60, 6):
        assert len(set(groups[start : start + 6])) == 6
    assert len({tuple(groups[start : start + 6]) for start in range(0, 60, 6)}) > 1


def test_a_block_may_be_for_one_group_only() -> None:
    study = tiny(
        participants={"between": {"lamp": {"on": {}, "off": {}}}}, blocks=[pairs(), rating(only={"lamp": "on"})]
    )
    for n in range(1, 9):
        shown = {t.block for t in plan(study, n)}
        assert ("rating" in shown) == (group_of(study, n)["lamp"] == "on")


def test_settings_cascade_from_study_to_scene_to_block_to_level_to_trial() -> None:
    study = tiny(
        defaults={"duration_s": 1, "start_s": 1, "gap_px": 1, "iti_s": 1, "warm_up_s": 1},
        scenes={"a": {"scene": "bar", "start_s": 2, "gap_px": 2, "iti_s": 2, "warm_up_s": 2}},
        blocks=[
            rating(
                factors={"scene": ["a"], "condition": ["full"], "pause": {"long": {"iti_s": 4, "warm_up_s": 4}}},
                set={"gap_px": 3, "iti_s": 3, "warm_up_s": 3},
                trials=[{"levels": {"condition": "full", "pause": "long"}, "set": {"warm_up_s": 5}}],
            )
        ],
    )
    (trial,) = plan(study, 1)
    s = trial.settings
    assert (trial.duration_s, s["start_s"], s["gap_px"], s["iti_s"], s["warm_up_s"]) == (1.0, "2", 3, 4.0, "5")


def test_levels_may_set_parameters_and_rates() -> None:
    levels = {"slow": {"rate_hz": 60, "params": {"light_samples": 4}}, "fast": {}}
    study = tiny(
        blocks=[rating(factors={"scene": ["a"], "condition": ["full", "half"], "speed": levels}, repetitions=1)]
    )
    shown = {(t.factors["condition"], t.factors["speed"]): t.panels[0] for t in plan(study, 1)}
    assert shown["full", "slow"].rate_hz == "60"
    assert shown["full", "fast"].rate_hz == "240"
    assert shown["half", "slow"].rate_hz == "120"  # the condition's own rate stands
    assert shown["full", "slow"].params["light_samples"] == 4


def test_catch_trials_have_their_answer_and_are_never_first() -> None:
    study = tiny(blocks=[pairs(catch={"trials": 4, "good": "gold", "bad": "half"}),
                         rating(catch={"trials": 2, "bad": "half", "expect": [-3, -1]})])  # fmt: skip
    for n in range(1, 8):
        trials = plan(study, n)
        caught = [t for t in trials if t.catch]
        assert len(caught) == 6
        assert not trials[0].catch
        for trial in caught[:4]:
            assert next(p.condition for p in trial.panels if p.slot == trial.correct) == "gold"
        assert [t.correct for t in caught[4:]] == ["-3..-1"] * 2
        assert Counter(t.correct for t in caught[:4]) == {"left": 2, "right": 2}


def test_practice_breaks_and_words_stand_where_they_belong() -> None:
    study = tiny(blocks=[{"name": "hello", "kind": "instructions", "text": "hi"}, rating(practice=14, break_every=5)])
    trials = plan(study, 1)
    assert [t.index for t in trials] == list(range(len(trials)))
    assert trials[0].text == "hi"
    assert [t.practice for t in trials[1:15]] == [True] * 14
    assert Counter(t.factors["condition"] + t.scene for t in trials[1:13]).most_common(1)[0][1] == 2
    assert [t.index for t in trials if t.kind == "break"] == [20, 26]


def test_scales_and_keys_run_the_other_way_for_one_of_each_couple() -> None:
    questions = {"closer": {"kind": "choice", "text": "?", "balance": True, "ties": True},
                 "clean": {"kind": "likert", "text": "?", "balance": True}}  # fmt: skip
    study = tiny(questions=questions, blocks=[pairs(kind="two_interval", reference=None), rating()])
    firsts: Counter[str] = Counter()
    for n in range(1, 21):
        trials = plan(study, n)
        firsts[next(t for t in trials if t.kind == "likert").questions[0].keys["1"]] += 1
        choice = next(t for t in trials if t.kind == "two_interval").questions[0]
        assert set(choice.keys.values()) == {"first", "second", "tie"}
        firsts[choice.keys["left"]] += 1
    assert firsts == {"-3": 10, "3": 10, "first": 10, "second": 10}


@pytest.mark.parametrize("order", ["shuffle", "latin"])
def test_blocks_change_places_and_words_do_not(order: str) -> None:
    words = {"name": "mid", "kind": "break", "text": "rest"}
    study = tiny(block_order=order, blocks=[pairs(), words, rating()])
    firsts = Counter()
    for n in range(1, 21):
        blocks = list(dict.fromkeys(t.block for t in plan(study, n)))
        assert blocks[1] == "mid"
        firsts[blocks[0]] += 1
    assert len(firsts) == 2
    if order == "latin":
        assert set(firsts.values()) == {10}


def test_balance_counts_what_is_uneven() -> None:
    trials = main(plan(tiny(), 1), "pairs")
    assert balance(trials)["cell"] == (1, 1)
    assert balance(trials[1:])["cell"][0] == 1
    assert balance([*trials, trials[0]])["cell"] == (1, 2)
    assert balance([]) == {}


def test_a_thousand_trials_are_planned_in_a_second() -> None:
    factors = {
        "scene": ["a", "b"],
        "condition": ["full", "half", "dense"],
        "x": [f"x{i}" for i in range(10)],
        "y": [f"y{i}" for i in range(9)],
    }
    study = tiny(
        blocks=[
            rating(factors=factors, order={"max_in_a_row": {"scene": 3, "condition": 2}, "min_distance": {"cell": 4}})
        ]
    )
    start = time.process_time()  # other work on the machine does not count
    trials = plan(study, 1)
    assert time.process_time() - start < 1.0
    assert len(trials) == 1080
