"""The trade: which settings are tried, what a row holds, the front, resuming, and what storing adds."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from renderers import tradeoff, tradeoff_report
from renderers.clip_frames import technique_params, view_at
from renderers.engine import Engine
from renderers.precision import precision_errors
from renderers.search import Setting
from renderers.tradeoff import Conditions, RowFile, pareto_front
from stimuli import load_scene
from stimuli.camera_path import camera_path
from stimuli.encode import display_values
from stimuli.errors import InputError
from studyapp.cli import main

SMALL = Conditions(size_px=(40, 24), frames=8, warm_up_frames=4, reference_spp=4, flip_windows=1)


def test_an_unknown_technique_is_said() -> None:
    with pytest.raises(InputError, match="--technique"):
        tradeoff.techniques_for(["vanila"])


def row(name: str, ms: float, error: float, **more: Any) -> dict[str, Any]:
    return {"technique": name, "label": name, "ms_per_refresh": ms, "rmse_eyes": error, **more}


def test_the_front_holds_what_nothing_beats_in_both() -> None:
    rows = [row("a", 2, 5), row("b", 1, 9), row("c", 3, 6), row("d", 4, 1), row("e", 1, 8), row("f", 4, 1)]
    assert pareto_front(rows) == [4, 0, 3]
    assert pareto_front([]) == []


def test_the_same_cost_compares_the_best_of_each() -> None:
    rows = [row("a", 2, 5), row("a", 1, 9), row("b", 2.08, 4), row("c", 3, 1)]
    assert [r["label"] for r in tradeoff_report.equal_cost(rows, "ms_per_refresh", 2.0)] == ["b", "a"]


def test_who_beats_a_technique_is_said_for_each_eye() -> None:
    def row(technique: str, cost: float, still: float, tracking: float) -> dict[str, Any]:
        return {"technique": technique, "cost": cost, "rmse_still": still, "rmse_tracking": tracking}

    base = row("dense", 10.0, 5.0, 5.0)
    rows = [base, row("dense", 10.0, 1.0, 1.0), row("taa", 10.4, 4.0, 6.0), row("dear", 11.0, 1.0, 1.0),
            row("held", 9.0, 3.0, 5.0), row("taa", 8.0, 4.5, 4.5)]  # fmt: skip
    assert tradeoff_report.beaten_by(rows, base, "cost", "rmse_still") == ["held", "taa"]
    assert tradeoff_report.beaten_by(rows, base, "cost", "rmse_tracking") == ["taa"]


@pytest.fixture(scope="module")
def measured() -> list[dict[str, Any]]:
    scene = load_scene("toy_car")
    engine, camera = Engine(scene), camera_path(scene, "file")
    gold = tradeoff.gold_standard(engine, camera, SMALL, lambda n: None)
    settings = [Setting("vanilla"), Setting("vanilla", {}, Fraction(60), "baseline"), Setting("temporally_dense")]
    return [tradeoff.measure_setting(engine, camera, s, gold, SMALL) for s in settings]


def test_a_row_holds_cost_rays_and_the_errors_of_both_eyes(measured: list[dict[str, Any]]) -> None:
    vanilla, held, dense = measured
    pixels = 40 * 24
    assert vanilla["rays"]["primary"] == pixels
    assert held["rays"]["primary"] == pixels / 4
    assert dense["rays"]["primary"] == pixels / 4
    assert held["primary_per_s"] == dense["primary_per_s"] == pixels * 60
    assert held["ms_per_refresh"] == pytest.approx(held["ms_per_content_frame"] / 4)
    assert vanilla["ms_p95"] >= vanilla["ms_per_content_frame"]
    for found in measured:
        for name in ("rmse", "psnr_db", "rmse_still", "rmse_tracking", "flip_still", "flip_tracking", "flicker"):
            assert found[name] > 0, name
        assert len(found["rmse_by_refresh"]) == 8
        assert set(found["stages_ms"]) >= {"state", "trace"}
    json.dumps(measured)  # complete and plain


def test_the_processors_time_is_told_too_and_a_busy_machine_is_said(measured: list[dict[str, Any]]) -> None:
    assert all(0 < found["cpu_ms_per_refresh"] < 1000 * found["ms_p95"] for found in measured)
    calm = [{**found, "load_per_core": 1.0} for found in measured]
    assert tradeoff_report.busy(calm) == ""
    assert "load 5.0 a core" in tradeoff_report.busy([*calm, {**measured[0], "load_per_core": 5.0}])


def test_a_held_frame_is_further_off_than_one_at_every_refresh(measured: list[dict[str, Any]]) -> None:
    vanilla, held, _ = measured
    assert held["rmse_tracking"] > vanilla["rmse_tracking"]


def test_a_frame_that_is_held_throughout_still_tells_what_it_costs() -> None:
    scene = load_scene("toy_car")
    engine, camera = Engine(scene), camera_path(scene, "file")
    held = Setting("framed_low_rate", {"samples_per_s": 40 * 24 * 240 / 6}, Fraction(240))  # one frame in six
    few = replace(SMALL, frames=4, warm_up_frames=8)
    shown = tradeoff.shown_by(engine, camera, held, 1.0, few, 1)
    assert all(np.array_equal(color, shown.colors[0]) for color in shown.colors)  # refreshes 8 to 11 show frame 6
    assert shown.made_share == 1 / 6
    assert shown.rays["primary"] == 40 * 24 / 6
    assert shown.seconds and min(shown.seconds) > 0  # noqa: PT018
    assert set(shown.stages_s) >= {"trace"}


@pytest.mark.parametrize("name", ["vanilla", "framed_low_resolution", "polar", "reference"])
def test_what_remembers_nothing_needs_no_warm_up(name: str) -> None:
    scene = load_scene("toy_car")
    engine, camera = Engine(scene), camera_path(scene, "file")
    setting, longer = Setting(name), replace(SMALL, frames=2, warm_up_frames=9)
    assert tradeoff.first_frame(setting, longer) == 5
    assert tradeoff.first_frame(Setting("taa"), longer) == 0
    found = tradeoff.shown_by(engine, camera, setting, 1.0, longer).colors
    assert tradeoff.first_frame(setting, replace(longer, lighting="probes")) == (0 if name == "polar" else 5)
    made = tradeoff.TECHNIQUES[name](engine, SMALL.size_px, technique_params(name, {}), 0, "total")
    for k in range(11):  # every frame from the start
        frame = made.render(view_at(k, longer.rate_hz, longer.start_s, SMALL.size_px, camera, cut=k == 0)).color
        if k >= 9:
            np.testing.assert_array_equal(found[k - 9], frame)


def test_the_gold_standards_own_error_is_that_of_its_samples(measured: list[dict[str, Any]]) -> None:
    scene = load_scene("toy_car")
    engine, camera = Engine(scene), camera_path(scene, "file")
    few, many = (
        tradeoff.gold_standard(engine, camera, replace(SMALL, frames=2, reference_spp=spp), lambda n: None)
        for spp in (4, 256)
    )
    apart = np.sqrt(np.mean((few.values - many.values) ** 2))
    assert few.own_rmse == pytest.approx(apart, rel=0.35)
    assert many.own_rmse is not None
    assert many.own_rmse < few.own_rmse / 3
    assert measured[0]["gold_rmse"] > 0


def test_ratios_are_to_vanilla_at_the_displays_rate(measured: list[dict[str, Any]]) -> None:
    rows = tradeoff_report.with_ratios(measured)
    assert rows[0]["ratio_to_vanilla"] == 1
    assert tradeoff_report.with_ratios(measured[2:])[0]["ratio_to_vanilla"] is None


def test_storing_adds_next_to_nothing_as_halves_and_half_a_code_as_codes(measured: list[dict[str, Any]]) -> None:
    stored = measured[0]["precision"]
    assert stored["half"]["rmse_added"] < stored["codes8"]["rmse_added"]
    assert stored["half"]["most_added"] * 255 < 0.2
    assert 0.2 < stored["codes8"]["rmse_added"] * 255 < 0.35  # 1 / sqrt(12) codes for an even spread
    assert stored["codes8"]["most_added"] * 255 < 0.75  # half a code, and what the half float adds


def test_precision_of_what_halves_and_codes_hold_exactly_is_perfect() -> None:
    colors = [np.full((4, 4, 3), value, np.float32) for value in (0.0, 1.0, 4.0)]
    gold = np.array([display_values(color, 1.0) for color in colors])
    for error in precision_errors(colors, gold, 1.0).values():
        assert (error.rmse_added, error.most_added, error.rmse_growth) == pytest.approx((0, 0, 0), abs=1e-12)


def test_rows_are_found_again_and_a_half_written_line_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    file = RowFile(path)
    file.add("one", {"ms": 1.0})
    file.add("two", {"ms": 2.0})
    with path.open("a") as torn:
        torn.write('{"key": "three", "ms": 3')
    again = RowFile(path)
    assert list(again.rows) == ["one", "two"]
    again.add("three", {"ms": 3.0})
    assert list(RowFile(path).rows) == ["one", "two", "three"]
    assert RowFile(path).rows["three"]["ms"] == 3.0


def test_a_row_belongs_to_its_scene_conditions_setting_and_engine() -> None:
    scene, other = load_scene("toy_car"), load_scene("bar")
    camera = camera_path(scene, "file")
    keys = {
        RowFile.key(scene, camera, Setting("vanilla"), SMALL, 1),
        RowFile.key(other, camera, Setting("vanilla"), SMALL, 1),
        RowFile.key(scene, camera, Setting("vanilla", {}, Fraction(60)), SMALL, 1),
        RowFile.key(scene, camera, Setting("taa", {"alpha": 0.2}), SMALL, 1),
        RowFile.key(scene, camera, Setting("vanilla"), Conditions(), 1),
        RowFile.key(scene, camera, Setting("vanilla"), SMALL, 2),
    }
    assert len(keys) == 6


def test_the_command_writes_table_csv_json_and_plot_and_goes_on_where_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = (
        f"tradeoff --scene toy_car --technique vanilla --technique framed_low_rate --size 24x16 --frames 8 --warm-up 2 "
        f"--trials 1 --spp 2 --out {tmp_path}"
    ).split()
    assert main(command) == 0
    text = capsys.readouterr().out
    told = ("vanilla", "framed_low_rate", "RMSE still", "tracking", "gaze", "precision", "spread")
    for words in (*told, "operating points", "on the front", "gold standard's own error"):
        assert words in text
    rows = json.loads((tmp_path / "tradeoff.json").read_text())["toy_car"]
    assert {r["technique"] for r in rows} == {"vanilla", "framed_low_rate"}
    with (tmp_path / "tradeoff.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == len(rows)
    assert float(table[0]["rmse_still"]) == rows[0]["rmse_still"]
    assert {"flip_still", "flip_tracking", "rmse_tracking", "ms_per_refresh", "rays"} <= set(table[0])
    assert (tmp_path / "tradeoff.png").stat().st_size > 5000
    monkeypatch.setattr(tradeoff, "measure_setting", None)  # a second run measures nothing
    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["toy_car"] == rows


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--size", "24by16", "WxH"),
        ("--budget", "lots", "--budget"),
        ("--rate", "fast", "--rate"),
        ("--frames", "0", "tradeoff"),
        ("--gaze", "left", "--gaze"),
    ],
)
def test_wrong_options_are_one_line(option: str, value: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tradeoff", "--technique", "vanilla", option, value]) == 2
    error = capsys.readouterr().err.strip()
    assert words in error
    assert len(error.splitlines()) == 1
