"""From a protocol to a report by the commands that a user types: clips, a session on real lines, statistics."""

from __future__ import annotations

import json
import os
import re
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from protocols.records import FLIP_DTYPE, GAZE_DTYPE

ROOT = Path(__file__).parents[1]
PROTOCOL = """\
study: whole
seed: 11
display: {refresh_hz: 240, size_px: [400, 160], width_m: 0.53, distance_m: 0.6}
defaults: {size_px: [40, 32], duration_s: 0.1, warm_up_s: 0.05, gap_px: 8, iti_s: 0.05}
timing: {luminance_limit: 1.0}
scenes:
  tunnel: {scene: tunnel_geom, start_s: 1, exposure: 1.0}
  car: {scene: toy_car, start_s: 1, exposure: 1.0}
conditions:
  gold: {technique: reference, params: {spp: 4}}
  plain: {technique: PLAIN}
  dense: {technique: temporally_dense}
  slow: {technique: vanilla, rate_hz: 60}
questions:
  closer: {kind: choice, text: Which is closer to the middle one?}
  clean: {kind: likert, text: The sequence was free of artifacts.}
blocks:
  - {name: welcome, kind: instructions, text: Press a key.}
  - name: closest
    kind: side_by_side
    reference: gold
    compare: {of: [plain, dense, slow]}
    factors: {scene: [tunnel, car]}
    questions: [closer]
  - name: rating
    kind: likert
    factors: {scene: [tunnel, car], condition: [gold, plain, dense]}
    questions: [clean]
analysis:
  tests:
    - {name: scale, test: bradley_terry, block: closest, question: closer, dv: choice}
    - {name: clean_anova, test: rm_anova, block: rating, question: clean, within: [condition, scene]}
    - {name: clean_friedman, test: friedman, block: rating, question: clean, within: [condition]}
    - {name: clean_pairs, test: posthoc_t, block: rating, question: clean, within: [condition], adjust: holm}
observer:
  utilities: {gold: 2.0, plain: 1.0, dense: 0.5, slow: -1.0}
  rt: {median_s: 0.1, sd_log: 0.3, shift_s: 0.05}
  likert:
    clean: {thresholds: [-2.0, -1.2, -0.4, 0.4, 1.2, 2.2], noise_sd: 0.7}
"""


def studyapp(*arguments: str, cwd: Path, code: int = 0) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "studyapp", *arguments], cwd=cwd, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == code, f"{arguments}: {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-3000:]}"
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


def whole_study(folder: Path, plain: str) -> dict:
    """Render, run one, simulate five more, analyse; the report's JSON."""
    folder.mkdir()
    (folder / "whole.yaml").write_text(PROTOCOL.replace("PLAIN", plain))
    studyapp("render", "whole.yaml", "--store", "clips", cwd=folder)
    studyapp(
        "run", "whole.yaml", "--participant", "1", "--display", "offscreen", "--observer", "simulated",
        "--store", "clips", "--data", "data", "--override", "display_lock=a test on a busy machine", cwd=folder,
    )  # fmt: skip
    studyapp("simulate", "whole.yaml", "--participants", "5", "--first", "2", "--data", "data", cwd=folder)
    studyapp("analyze", "data", "--report", "report.html", "--json", "results.json", "--quiet", cwd=folder)
    return json.loads((folder / "results.json").read_text())


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("study") / "whole"
    return folder, whole_study(folder, "vanilla")


def test_every_answer_is_decoded_from_bytes_that_came_over_the_line(study) -> None:
    folder, _ = study
    with sqlite3.connect(folder / "data" / "whole_p1_1.sqlite") as file:
        rows = file.execute("SELECT answer, raw, rt_ns, device FROM responses WHERE timed_out = 0").fetchall()
        planned = json.loads(file.execute("SELECT value FROM header WHERE key = 'plan'").fetchone()[0])
    asked = sum(len(trial["questions"]) for trial in planned)
    assert len(rows) >= asked
    assert all(raw for _, raw, _, _ in rows)
    assert all(rt is not None and rt > 0 for _, _, rt, _ in rows)


def test_every_refresh_and_gaze_sample_is_there(study) -> None:
    folder, _ = study
    with sqlite3.connect(folder / "data" / "whole_p1_1.sqlite") as file:
        flips = [
            np.frombuffer(data, FLIP_DTYPE) for (data,) in file.execute("SELECT data FROM flips ORDER BY trial, chunk")
        ]
        gaze = [np.frombuffer(data, GAZE_DTYPE) for (data,) in file.execute("SELECT data FROM gaze")]
        trials = file.execute("SELECT trial, refreshes, kind FROM trials WHERE kind != 'instructions'").fetchall()
    rows = np.concatenate(flips)
    assert len(rows) >= sum(refreshes for _, refreshes, _ in trials)
    assert (np.diff(rows["refresh"]) > 0).all()
    assert (rows["source"].max(axis=0)[:3] > 0).all()
    samples = np.concatenate(gaze)
    assert len(samples) > 50
    assert np.isfinite(samples["x_dva"][samples["valid"] == 1]).all()


def test_the_report_says_simulated_and_holds_the_numbers_of_the_json(study) -> None:
    folder, results = study
    page = (folder / "report.html").read_text()
    assert "SIMULATED" in page
    assert not re.search(r'(src|href)="https?://', page)
    text = json.dumps(results)
    for planned in ("scale", "clean_anova", "clean_friedman", "clean_pairs"):
        assert planned in text
        assert planned in page


def test_people_and_simulations_are_never_mixed(study, tmp_path) -> None:
    folder, _ = study
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    for name in ("whole_p1_1.sqlite", "whole_p2_1.sqlite"):
        (mixed / name).write_bytes((folder / "data" / name).read_bytes())
    with sqlite3.connect(mixed / "whole_p2_1.sqlite") as file:
        file.execute("UPDATE header SET value = '\"person\"' WHERE key = 'observer_kind'")
        file.execute("UPDATE trials SET observer_kind = 'person'")
    said = studyapp("analyze", str(mixed), "--report", "r.html", "--quiet", cwd=tmp_path, code=2)
    assert "person" in said
    assert "simulated" in said


def test_darkening_one_technique_changes_the_numbers(study, tmp_path) -> None:
    _, results = study
    dimmed = whole_study(tmp_path / "dim", "tests.dim_vanilla:Dimmed")

    def luminance(report: dict) -> dict[str, float]:
        found: dict[str, float] = {}

        def walk(value: object) -> None:
            if isinstance(value, dict):
                if "condition" in value and any("luminance" in key for key in value):
                    key = next(key for key in value if "luminance" in key and isinstance(value[key], int | float))
                    found.setdefault(str(value["condition"]), float(value[key]))
                for item in value.values():
                    walk(item)
            elif isinstance(value, list):
                for item in value:
                    walk(item)

        walk(report)
        return found

    before, after = luminance(results), luminance(dimmed)
    assert after["plain"] < 0.75 * before["plain"]
    assert after["dense"] == pytest.approx(before["dense"], rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("check", "no_such.yaml"), "no_such.yaml"),
        (("scene", "no_such.glb", "--preview", "x.png"), "no_such.glb"),
        (("tradeoff", "--technique", "vanila"), "vanilla"),
        (("tradeoff", "--size", "0x8"), "--size"),
        (("demo", "--scene", "no_such.glb"), "no_such.glb"),
        (("analyze", "no_such_folder", "--report", "r.html"), "no_such_folder"),
        (("nonsense",), "nonsense"),
    ],
)
def test_wrong_input_is_one_clear_line_and_exit_code_2(tmp_path, arguments, words) -> None:
    said = studyapp(*arguments, cwd=tmp_path, code=2)
    assert words in said
    assert len(said.strip().splitlines()) <= 2


def test_every_command_has_help_with_an_example() -> None:
    from studyapp.cli import _load, command_names

    assert {"check", "plan", "render", "run", "simulate", "analyze", "demo", "tradeoff"} <= set(command_names())
    for name in command_names():
        module = _load(name)
        assert module.HELP
        assert module.EXAMPLE.startswith("studyapp ")


def test_the_demo_protocol_renders_and_runs_with_every_technique(tmp_path) -> None:
    from studyapp.demo import protocol_text

    text = protocol_text()
    for long, short in (
        (
            "size_px: [160, 120], duration_s: 0.4, warm_up_s: 0.25",
            "size_px: [32, 24], duration_s: 0.05, warm_up_s: 0.05",
        ),
        ("{scene: toy_car, start_s: 1}", "{scene: tunnel_geom, start_s: 2}"),
        ("{scene: bar, start_s: 1}", "{scene: tunnel_geom, start_s: 3}"),
        ("{median_s: 0.25, sd_log: 0.3, shift_s: 0.1}", "{median_s: 0.05, sd_log: 0.1, shift_s: 0.02}"),
        ("iti_s: 0.1", "iti_s: 0.0"),
        ("luminance_limit: 0.25", "luminance_limit: 1.0"),
    ):
        assert long in text
        text = text.replace(long, short)
    (tmp_path / "small.yaml").write_text(text)
    studyapp("render", "small.yaml", "--store", "clips", cwd=tmp_path)
    studyapp(
        "run", "small.yaml", "--participant", "1", "--display", "offscreen", "--observer", "simulated",
        "--store", "clips", "--data", "data", "--override", "display_lock=a test on a busy machine", cwd=tmp_path,
    )  # fmt: skip
    (session,) = (tmp_path / "data").glob("*.sqlite")
    with sqlite3.connect(session) as file:
        panels = " ".join(row[0] for row in file.execute("SELECT panels FROM trials"))
    from renderers.catalogue import CATALOGUE

    assert [name for name in CATALOGUE if f'"{name}"' not in panels] == []
