"""Power through the planned analysis: rejections at the level where there is no effect, equal seeds, wrong input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.power_command import main, planned_power
from analysis.simulated_table import simulated_table, slot
from protocols import load_study
from stimuli.errors import InputError

PROTOCOL = """
study: small
scenes: {bar: bar}
conditions:
  a: {technique: vanilla}
  b: {technique: taa}
questions:
  clean: {kind: likert, text: Was it clean?}
blocks:
  - name: rated
    kind: likert
    factors: {condition: [a, b]}
    repetitions: 2
    questions: [clean]
participants: {target: 8}
analysis:
  tests: [{name: pairs, test: posthoc_t, question: clean, within: [condition]}]
observer:
  source: invented for this test
  likert: {clean: {mean: 0, means: [{by: [condition], values: {a: EFFECT, b: -EFFECT}}], noise_sd: 1}}
"""


def protocol(folder: Path, effect: float) -> Path:
    path = folder / "small.yaml"
    path.write_text(PROTOCOL.replace("-EFFECT", str(-effect)).replace("EFFECT", str(effect)))
    return path


def test_without_an_effect_rejections_are_at_the_level(tmp_path: Path) -> None:
    study = load_study(protocol(tmp_path, 0.0))
    table = planned_power(study, [8], None, simulations=200, seed=1)
    assert table["mc_low"].iloc[0] <= 0.05 <= table["mc_high"].iloc[0]


def test_a_large_effect_is_always_found(tmp_path: Path) -> None:
    study = load_study(protocol(tmp_path, 1.2))
    table = planned_power(study, [8], None, simulations=20, seed=1)
    assert table["power"].iloc[0] == 1.0
    assert table["mc_high"].iloc[0] == 1.0


def test_equal_seeds_give_equal_studies(tmp_path: Path) -> None:
    study = load_study(protocol(tmp_path, 0.5))
    slots = [slot(study, number) for number in (1, 2, 3)]
    one, same, other = (simulated_table(study, slots, seed) for seed in (4, 4, 5))
    assert one.equals(same)
    assert not np.array_equal(one["rating"], other["rating"])
    assert len(one) == 12


def test_wrong_input_is_named(tmp_path: Path) -> None:
    path = str(protocol(tmp_path, 0.5))
    for arguments in (["--n", "few"], ["--n", "1"], ["--test", "tarot"], ["--simulations", "0"]):
        with pytest.raises(InputError):
            main([path, "--quiet", *arguments])


def test_the_command_prints_every_n(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(protocol(tmp_path, 1.0)), "--n", "4,6", "--simulations", "5", "--quiet"]) == 0
    said = capsys.readouterr().out
    assert "a - b" in said
    assert "SIMULATED" in said
