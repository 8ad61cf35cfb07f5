"""Table 1 of Dayal et al. 2005: its lines, conditions, ratios, and a small one measured."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from renderers import table1
from renderers.engine import Engine
from renderers.table1 import FULL, METHODS, PAPER, Conditions, Method, key, methods, with_ratios
from stimuli.camera_path import PATH_VERSION
from stimuli.scene import StillCamera
from studyapp.cli import main
from tests.renderers.scenes import SlidingCamera, noise_pixels, quad, scene_of, unlit, velocity_for

SMALL = Conditions(size_px=(24, 18), duration_s=Fraction(3, 2), compared=4, reference_spp=16)


def quiet(done: int) -> None:
    """Progress that nobody wants."""


def wall(camera) -> Engine:
    return Engine(
        scene_of(quad((-48, -48, -2), (96, 0, 0), (0, 96, 0), unlit(noise_pixels(3, block=32)), repeats=16.0,),
                 camera=camera)
    )  # fmt: skip


def test_framed_methods_are_a_frame_late_and_frameless_ones_are_not() -> None:
    lines = methods([1e5, 4e5])
    assert [line.label for line in lines] == [FULL, *METHODS, *METHODS]
    late = {line.technique: line.params.get("delay_frames", 0) for line in lines}
    assert late == {
        "vanilla": 1, "framed_low_resolution": 1, "framed_low_rate": 1, "traditional_frameless": 0,
        "adaptive_frameless": 0,
    }  # fmt: skip
    assert {line.samples_per_s for line in lines[1:5]} == {100_000}


def test_compared_refreshes_are_spread_evenly_from_the_warm_up_to_the_end() -> None:
    refreshes = Conditions().refreshes
    assert len(refreshes) == 100
    assert (refreshes[0], refreshes[-1]) == (60, 1199)
    assert set(np.diff(refreshes)) <= {11, 12}
    assert replace(SMALL, compared=1000).refreshes == tuple(range(60, 90))


def test_ratios_are_to_full_resolution_and_the_paper_stands_beside() -> None:
    rms = {FULL: 10.0, "framed_low_resolution": 30.0, "framed_low_rate": 9.0, "traditional_frameless": 20.0}
    rms["adaptive_frameless"] = 8.0
    rows = [{"label": name, "samples_per_s": 400_000 * (name != FULL), "rms": value} for name, value in rms.items()]
    found = {row["label"]: row for row in with_ratios("bart", rows)}
    assert found["adaptive_frameless"]["ratio"] == pytest.approx(0.8)
    assert found["adaptive_frameless"]["paper_ratio"] == pytest.approx(50.1 / 30.7)
    assert found["adaptive_frameless"]["target"] == 1.6
    assert [name for name, row in found.items() if row["first"]] == [FULL, "adaptive_frameless"]
    assert found["traditional_frameless"]["target"] is None


def test_adaptive_is_the_least_of_each_budget_in_the_papers_table() -> None:
    for lines in PAPER.values():
        for budget in lines["adaptive_frameless"]:
            others = [lines[name][budget] for name in METHODS if name != "adaptive_frameless"]
            assert lines["adaptive_frameless"][budget] < min(others)


def test_every_condition_and_parameter_is_part_of_a_lines_identity() -> None:
    line = methods([1e5])[4]
    keys = {
        key("a", "bart", line, SMALL, 1), key("b", "bart", line, SMALL, 1), key("a", "toycar", line, SMALL, 1),
        key("a", "bart", line, replace(SMALL, seed=1), 1), key("a", "bart", line, SMALL, 2),
        key("a", "bart", Method(line.label, line.technique, 100_000, {**line.params, "kappa": 0.1}), SMALL, 1),
    }  # fmt: skip
    assert len(keys) == 6


def test_a_camera_path_that_moves_in_another_way_has_other_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    line, before = methods([1e5])[4], []
    for version in (PATH_VERSION, PATH_VERSION + 1):
        monkeypatch.setattr("stimuli.camera_path.PATH_VERSION", version)
        before.append(key("a", "interactive", line, SMALL, 1))
    assert before[0] != before[1]


def test_where_nothing_moves_delay_costs_nothing_and_resolution_does() -> None:
    engine = wall(StillCamera(np.eye(4), np.pi / 3))
    gold = table1.gold_standard(engine, engine.scene.camera, SMALL, quiet)
    rows = {m.label: table1.measure(engine, engine.scene.camera, m, gold, SMALL, quiet) for m in methods([8e3])}
    assert rows["framed_low_rate"]["rms"] == pytest.approx(rows[FULL]["rms"], rel=1e-5)
    assert rows[FULL]["rms"] < 0.5 * rows["framed_low_resolution"]["rms"]
    assert rows["adaptive_frameless"]["rms"] < rows["framed_low_resolution"]["rms"]
    assert rows["adaptive_frameless"]["primary_per_s"] == pytest.approx(8e3, rel=1e-3)
    assert rows["framed_low_rate"]["primary_per_s"] <= 8e3
    assert all(len(row["errors"]) == 4 for row in rows.values())


def test_where_the_camera_slides_a_late_frame_costs_its_motion() -> None:
    engine = wall(SlidingCamera(velocity_for((1.0, 0.0), 2.0, 18, 60.0)))
    gold = table1.gold_standard(engine, engine.scene.camera, SMALL, quiet)
    lines = [Method("", "vanilla", 0, {"delay_frames": n}) for n in (1, 0)]
    late, prompt = (table1.measure(engine, engine.scene.camera, line, gold, SMALL, quiet) for line in lines)
    assert late["rms"] > 1.3 * prompt["rms"]


def test_one_command_writes_table_rows_and_curves_and_says_what_is_shortened(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["tradeoff", "--table1", "--scene", "toy_car", "--size", "16x12", "--frames", "2", "--spp", "2",
                 "--duration", "1.1", "--budget", "4k", "--out", str(tmp_path)]  # fmt: skip
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "seconds 1 to 1.1 (the animations: 20 s)" in out
    rows = json.loads((tmp_path / "table1.json").read_text())
    assert {row["animation"] for row in rows} == {"interactive", "bart", "toycar"}
    assert len(rows) == 3 * 5
    assert (tmp_path / "table1.png").stat().st_size > 1000
    curves = (tmp_path / "table1_errors.csv").read_text().splitlines()
    assert len(curves) == 1 + 3 * 5 * 2
    last = curves[-1].split(",")
    assert last[:4] == [rows[-1]["animation"], rows[-1]["label"], "4000", "65"]
    assert float(last[5]) == rows[-1]["errors"][-1]
    before = (tmp_path / "table1.jsonl").read_text()
    assert main(arguments) == 0  # nothing is measured twice
    assert (tmp_path / "table1.jsonl").read_text() == before


def test_a_shorter_animation_than_the_warm_up_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tradeoff", "--table1", "--scene", "toy_car", "--duration", "1", "--out", str(tmp_path)]) == 2
    assert "--duration" in capsys.readouterr().err
