"""Conditions that show the same samples on this display are refused; the share below full rate is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from protocols.gaze_demands import below_full_rate, same_samples_problems
from studyapp.cli import main
from tests.protocols.tiny import rating, tiny


def study(
    distance_m: float, other: dict[str, object] | None = None, geometry: str = "screen", against: str = "foveated"
):
    small = {"technique": "foveated", "params": {"configuration": "small"}}
    named = {"configuration": "full"} if against == "foveated" else {}
    full = {"technique": against, "params": {**named, **(other or {})}}
    return tiny(
        display={"size_px": [1920, 1080], "width_m": 0.6, "distance_m": distance_m, "geometry": geometry},
        conditions={"small": small, "full": full},
        blocks=[rating(factors={"scene": ["a", "b"], "condition": ["small", "full"]})],
        defaults={"size_px": [512, 512]},
    )


def test_the_share_is_that_of_the_pixels_beyond_the_inner_radius() -> None:
    rows = {row.condition: row.share for row in below_full_rate(study(0.6))}
    # Small keeps the full rate within 5 degrees of the panel's centre.
    pitch = 0.6 / 1920
    at = (np.arange(512) + 0.5 - 256) * pitch
    beyond = np.degrees(np.arctan(np.hypot(at, at[:, None]) / 0.6)) > 5
    assert rows["small"] == pytest.approx(beyond.mean(), abs=0.005)
    assert rows["full"] == 0.0


def test_from_afar_the_configurations_show_the_same() -> None:
    assert same_samples_problems(study(0.6)) == []
    (line,) = same_samples_problems(study(3.0))
    assert line.startswith("block rating: small and full: samples that differ: got 0.00%, wanted at least 1%")


def test_what_differs_otherwise_is_not_refused() -> None:
    assert same_samples_problems(study(3.0, {"light_samples": 4})) == []
    assert same_samples_problems(study(3.0, {"delay_frames": 1}, against="vanilla")) == []
    assert same_samples_problems(study(0.6, {"configuration": "small", "k_min": 0.2})) == []


def test_what_no_pixel_at_full_rate_hangs_on_makes_no_difference() -> None:
    """From afar the fovea is the whole picture: the cache is never asked."""
    assert len(same_samples_problems(study(3.0, {"k_min": 0.2}))) == 1
    assert len(same_samples_problems(study(3.0, {"configuration": "small", "k_min": 0.2}))) == 1


def test_full_ray_tracing_is_what_full_shows() -> None:
    (line,) = same_samples_problems(study(3.0, against="vanilla"))
    assert line.startswith("block rating: small and full: samples that differ: got 0.00%, wanted at least 1%")
    assert same_samples_problems(study(0.6, against="vanilla")) == []
    assert {row.condition for row in below_full_rate(study(0.6, against="vanilla"))} == {"small"}


def test_a_cameras_own_field_is_not_known_here() -> None:
    assert below_full_rate(study(3.0, geometry="camera")) == ()
    assert same_samples_problems(study(3.0, geometry="camera")) == []


def test_check_and_run_refuse_without_the_named_override(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = """\
study: far
display: {size_px: [1920, 1080], width_m: 0.6, distance_m: 3, geometry: screen}
defaults: {size_px: [512, 512]}
scenes: {a: tunnel_geom}
conditions:
  small: {technique: foveated, params: {configuration: small}}
  full: {technique: foveated, params: {configuration: full}}
questions: {clean: {kind: likert, text: It was clean.}}
blocks:
  - {name: rating, kind: likert, factors: {condition: [small, full]}, questions: [clean], set: {fixation: fixed}}
"""
    file = tmp_path / "far.yaml"
    file.write_text(text)
    assert main(["check", str(file)]) == 2
    assert "--override same_samples=REASON" in capsys.readouterr().err
    assert main(["check", str(file), "--override", "same_samples=a pilot"]) == 0
    out = capsys.readouterr().out
    assert "note: overridden (a pilot): block rating: small and full" in out
    assert "small: 0.0% of the pixels below full rate (512x512 px" in out
    run = ["run", str(file), "--participant", "1", "--display", "virtual", "--observer", "simulated"]
    assert main([*run, "--data", str(tmp_path)]) == 2
    assert "samples that differ" in capsys.readouterr().err
    assert main(["check", str(file), "--override", "same_samples"]) == 2


PAIRS = """\
study: pairs
scenes: {a: tunnel_geom}
conditions:
  small: {technique: foveated, params: {configuration: small}}
  head: polar
  plain: vanilla
  taa: taa
questions: {closer: {kind: choice, text: Which is closer?}}
blocks:
  - name: pairs
    questions: [closer]
"""
STAIRCASE = "{kind: staircase, parameter: p_min, values: [0.01, 0.1], test: small, standard: plain}"


def checked(tmp_path: Path, block: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    file = tmp_path / "pairs.yaml"
    file.write_text(PAIRS + "".join(f"    {line}\n" for line in block.splitlines()))
    code = main(["check", str(file), "--store", str(tmp_path / "clips")])
    return code, capsys.readouterr().err.splitlines()


@pytest.mark.parametrize(
    ("block", "place"),
    [
        ("compare: {of: [plain, small]}", "compare.of: got small"),
        ("compare: {of: [plain, taa]}\nreference: head", "reference: got head"),
        ("trials: [{compare: [plain, small]}]", "trials[0].compare: got small"),
        ("compare: {of: [plain, taa]}\npractice: [{compare: [plain, head]}]", "practice[0].compare: got head"),
        ("compare: {of: [plain, taa]}\ncatch: {good: plain, bad: head}", "catch.bad: got head"),
        (f"adaptive: {STAIRCASE}", "adaptive.test: got small"),
        ("compare: {of: [small, plain]}\nadaptive: {kind: active_pairs}", "compare.of: got small"),
    ],
)
def test_no_way_of_naming_it_puts_a_gaze_contingent_technique_side_by_side(
    block: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, lines = checked(tmp_path, f"kind: forced_choice\nset: {{fixation: fixed}}\n{block}", capsys)
    assert code == 2
    assert len(lines) == 1
    assert f"blocks[0].{place}, wanted no gaze-contingent technique side by side" in lines[0]
    if "reference" not in block:  # one after the other each stands where the eye is
        assert checked(tmp_path, f"kind: two_interval\nset: {{fixation: fixed}}\n{block}", capsys)[0] == 0


@pytest.mark.parametrize(
    "block",
    [
        f"set: {{fixation: free}}\nadaptive: {STAIRCASE}",
        "set: {fixation: free}\ncompare: {of: [plain, taa]}\npractice: [{compare: [plain, head]}]",
        "set: {fixation: free}\ncompare: {of: [plain, taa]}\ncatch: {good: plain, bad: head}",
        "set: {fixation: fixed}\ncompare: {of: [plain, head]}\npractice: 1\npractice_set: {fixation: free}",
    ],
)
def test_a_free_gaze_cannot_be_stored_wherever_the_trial_comes_from(
    block: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, lines = checked(tmp_path, f"kind: two_interval\n{block}", capsys)
    assert code == 2
    assert all("with a free gaze from the store" in line for line in lines)
    assert checked(tmp_path, f"kind: two_interval\n{block.replace('free', 'free, live: true')}", capsys)[0] == 0


def test_a_headset_is_no_display_of_a_session(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "headset.yaml"
    file.write_text(PAIRS.replace("scenes:", "display: {view: headset}\nscenes:") + "    kind: two_interval\n"
                    "    set: {fixation: fixed}\n    compare: {of: [plain, small]}\n")  # fmt: skip
    for command in (["check"], ["render"], ["simulate", "--participants", "1"]):
        assert main([command[0], str(file), *command[1:]]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"{file}:2:11: display.view: got 'headset', wanted monitor")
        assert "--view headset" in line
    file.write_text(file.read_text().replace("headset}", "monitor}"))
    assert main(["check", str(file)]) == 0
