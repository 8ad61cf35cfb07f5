"""The optional metric: what is asked of it, and what is said where it is not installed."""

from __future__ import annotations

import importlib.util
import sys
from fractions import Fraction
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from renderers.jod import GazeJodMetric, JodMetric, diagonal_inches
from renderers.metrics import pixels_per_degree
from renderers.technique import ViewGeometry
from studyapp.cli import main


def test_without_the_package_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["tradeoff", "--technique", "vanilla", "--jod"]) == 2
    assert "--jod: ColorVideoVDP: got not installed, wanted `pip install cvvdp`" in capsys.readouterr().err


def test_the_screen_shows_the_pixels_a_degree_that_were_asked_for() -> None:
    inches = diagonal_inches((400, 300), 30.0)
    width_m = inches * 0.0254 * 400 / 500
    assert pixels_per_degree(400, 300, 1.0, ViewGeometry(width_m, width_m * 0.75, 1.0)) == pytest.approx(30.0)


def test_the_metric_gets_codes_of_both_sequences_and_the_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    class Double:
        """Stands for pycvvdp.cvvdp: notes what it is asked."""

        def __init__(self, display_name: str, heatmap: None) -> None:
            asked["display"] = display_name

        def set_display_model(self, display_name: str, display_geometry: Any) -> None:
            asked["geometry"] = display_geometry

        def predict(self, test: np.ndarray, reference: np.ndarray, dim_order: str, frames_per_second: float) -> Any:
            asked.update(test=test, reference=reference, order=dim_order, rate=frames_per_second)
            return 9.5, None

    package = ModuleType("pycvvdp")
    package.cvvdp = Double  # type: ignore[attr-defined]
    package.vvdp_display_geometry = lambda size, **more: (size, more)  # type: ignore[attr-defined]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: package)
    monkeypatch.setitem(sys.modules, "pycvvdp", package)
    quality = JodMetric((4, 3), 30.0).of(np.full((2, 3, 4, 3), 0.5), np.full((2, 3, 4, 3), 2.0), Fraction(240))
    assert quality == 9.5
    assert asked["order"] == "FHWC"
    assert asked["rate"] == 240.0
    assert asked["geometry"][0] == (4, 3)
    assert asked["test"].dtype == np.uint8
    assert (asked["test"] == 128).all()
    assert (asked["reference"] == 255).all()


def test_the_gaze_and_the_field_reach_the_metric_that_follows_the_eye(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    class Double:
        """Stands for pyfvvdp.fvvdp: notes what it is asked."""

        def __init__(self, **settings: Any) -> None:
            asked.update(settings)

        def predict(self, test: np.ndarray, reference: np.ndarray, **settings: Any) -> Any:
            asked.update(settings, test=test)
            return 8.25, {}

    package = ModuleType("pyfvvdp")
    package.fvvdp = Double  # type: ignore[attr-defined]
    package.fvvdp_display_geometry = lambda size, **more: (size, more)  # type: ignore[attr-defined]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: package)
    monkeypatch.setitem(sys.modules, "pyfvvdp", package)
    metric = GazeJodMetric((4, 3), 30.0, (2.0, 1.5))
    assert metric.of(np.full((2, 3, 4, 3), 0.5), np.zeros((2, 3, 4, 3)), Fraction(240)) == 8.25
    assert asked["foveated"] is True
    assert asked["display_geometry"][0] == (4, 3)
    assert asked["fixation_point"].tolist() == [1.5, 1.0]  # the metric's pixel centres are whole numbers
    assert asked["frames_per_second"] == 240.0
    assert asked["test"].dtype == np.uint8


def test_the_metric_that_follows_the_eye_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["tradeoff", "--technique", "vanilla", "--jod-gaze"]) == 2
    assert "--jod-gaze: FovVideoVDP: got not installed, wanted `pip install pyfvvdp`" in capsys.readouterr().err
