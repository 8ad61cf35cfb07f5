"""`studyapp match`: knobs are solved, by bisection or by picking, and what is left is said."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from protocols.load import load_study
from studyapp.cli import main
from studyapp.match_conditions import picked, small_size, turned

PROTOCOL = """\
study: two
defaults: {size_px: [64, 48], duration_s: 0.1}
scenes: {bar: {scene: tunnel_geom, exposure: 1.0}}
conditions:
  slow: {technique: vanilla, rate_hz: 60}
  budget: {technique: framed_low_resolution, params: {samples_per_s: 1000}}
match:
  - {cost: samples_per_s, conditions: [slow, budget], to: slow, tolerance: 0.05,
     knobs: [{condition: budget, parameter: samples_per_s, low: 1000, high: HIGH}]}
questions: {rate: {kind: likert, text: Was it clean?}}
blocks:
  - {name: r, kind: likert, factors: {condition: [slow, budget]}, questions: [rate]}
"""


@pytest.mark.parametrize(
    ("measure", "low", "high", "target", "wanted"),
    [
        (lambda x: x, 1.0, 1000.0, 37.0, 37.0),  # rises, on the logarithm
        (lambda x: 1 / x, 1.0, 1000.0, 0.01, 100.0),  # falls
        (lambda x: x + 5, -10.0, 10.0, 3.0, -2.0),  # a range through 0
        (lambda x: x, 1.0, 10.0, 100.0, 10.0),  # beyond the end: the nearest
        (lambda x: x, 1.0, 10.0, 0.1, 1.0),
        (lambda x: x, 1.0, 10.0, 10.0, 10.0),  # an end itself
    ],
)
def test_a_knob_is_turned_to_the_target(measure, low: float, high: float, target: float, wanted: float) -> None:
    value, measured = turned(low, high, False, measure, target, 0.01)
    assert value == pytest.approx(wanted, rel=0.01)
    assert measured == measure(value)


def test_a_whole_knob_stays_whole_and_measures_nothing_twice() -> None:
    asked: list[float] = []

    def steps(x: float) -> float:
        asked.append(x)
        return x * x

    value, measured = turned(1, 64, True, steps, 90.0, 0.01)
    assert (value, measured) == (9.0, 81.0)
    assert len(asked) == len(set(asked))
    assert all(x == int(x) for x in asked)


def test_the_nearest_value_is_picked() -> None:
    assert picked(["a", "b", "c"], {"a": 1.0, "b": 4.0, "c": 9.0}.__getitem__, 5.0) == ("b", 4.0)


def test_small_sizes_keep_their_shape() -> None:
    assert small_size((512, 512)) == (128, 128)
    assert small_size((1920, 1080)) == (128, 72)
    assert small_size((96, 64)) == (96, 64)
    assert small_size((4096, 4)) == (128, 2)


def test_the_command_writes_what_the_plan_then_uses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    protocol = tmp_path / "two.yaml"
    protocol.write_text(PROTOCOL.replace("HIGH", "10000000"))
    assert main(["match", str(protocol), "--frames", "8", "--spp", "1"]) == 0
    assert "NOT MATCHED" not in capsys.readouterr().out
    study = load_study(protocol)
    # Every pixel at 60 Hz is 64 * 48 * 60 samples a second.
    assert study.conditions["budget"].params["samples_per_s"] == pytest.approx(64 * 48 * 60, rel=0.06)
    slow, budget = study.match[0].found
    assert slow.value == slow.target == 64 * 48 * 60
    assert math.isclose(budget.mismatch, budget.value / budget.target - 1)
    assert abs(budget.mismatch) <= 0.05
    # The size that is measured at makes no difference to samples a second.
    protocol.write_text(PROTOCOL.replace("HIGH", "10000"))
    (tmp_path / "two.match.yaml").unlink()
    assert main(["match", str(protocol), "--frames", "8", "--spp", "1", "--size", "32x24"]) == 1
    said = capsys.readouterr().out
    assert "NOT MATCHED" in said
    assert "a mismatch remains" in said
    slow, budget = load_study(protocol).match[0].found
    assert slow.value == 64 * 48 * 60
    assert not budget.matched


def test_nothing_to_match_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["match", "demo"]) == 2
    assert "match: got nothing" in capsys.readouterr().err
    protocol = tmp_path / "two.yaml"
    protocol.write_text(PROTOCOL.replace("HIGH", "10000").replace("cost: samples_per_s", "cost: ms_on_machine"))
    assert main(["match", str(protocol), "--size", "32x24"]) == 2
    assert "64x48, since ms_on_machine is matched" in capsys.readouterr().err
