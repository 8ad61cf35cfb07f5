"""Conditions that show the same samples on this display are refused; the share below full rate is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from protocols.gaze_demands import below_full_rate, same_samples_problems
from studyapp.cli import main
from tests.protocols.tiny import rating, tiny


def study(distance_m: float, other: dict[str, object] | None = None, geometry: str = "screen"):
    small = {"technique": "foveated", "params": {"configuration": "small"}}
    full = {"technique": "foveated", "params": {"configuration": "full", **(other or {})}}
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
    assert same_samples_problems(study(3.0, {"k_min": 0.2})) == []


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
