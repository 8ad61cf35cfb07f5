"""The moving fixation target on the screen: against trigonometry by hand, and against what analysis makes of it."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.gaze import gaze_report, target_distance_dva, target_paths
from analysis.sessions import combine, read_sessions
from protocols.design import plan
from protocols.load import load_study
from protocols.records import FLIP_DTYPE, GAZE_DTYPE, TARGET_DTYPE
from renderers import clip_renderer
from stimuli.clip import ClipStore
from stimuli.errors import InputError
from stimuli.load import load_scene
from stimuli.scene import Mover, StillCamera, StillTrack
from studyapp.gaze.angles import ScreenGeometry
from studyapp.live_sources import LiveSources
from studyapp.present.layout import PanelRect
from studyapp.target_path import TargetPaths, path_on_screen
from tests.analysis.fabricate import Model, likert_plan, write_session
from tests.protocols.tiny import rating, tiny
from tests.studyapp.tiny_study import TINY

SCREEN = ScreenGeometry(0.5, 0.25, 0.6, (400, 200))
CAMERA = StillCamera(np.eye(4), np.radians(90.0))


class Rising:
    """A target that rises from the axis at a unit a second, two units ahead."""

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        poses = np.broadcast_to(np.eye(4), (len(time_s), 4, 4)).copy()
        poses[:, 1, 3], poses[:, 2, 3] = time_s, -2.0
        return poses


def test_the_path_is_what_trigonometry_says() -> None:
    rect = PanelRect("centre", 150, 50, 100, 100)
    path = path_on_screen(Rising(), CAMERA, np.array([0.0, 1.0]), rect, SCREEN)
    assert path["x_dva"] == pytest.approx([0.0, 0.0], abs=1e-6)
    # Half of the half picture: 25 of 200 rows, 25 / 200 * 0.25 m up, seen from 0.6 m.
    assert path["y_dva"] == pytest.approx([0.0, np.degrees(np.arctan(0.03125 / 0.6))], abs=1e-5)
    beside = path_on_screen(Rising(), CAMERA, np.array([0.0]), PanelRect("right", 200, 50, 100, 100), SCREEN)
    assert beside["x_dva"] == pytest.approx([np.degrees(np.arctan(50 / 400 * 0.5 / 0.6))], abs=1e-5)


def test_a_mirrored_panel_mirrors_the_target_and_behind_the_eye_there_is_none() -> None:
    aside = np.eye(4)
    aside[:3, 3] = (0.5, 0.0, -1.0)
    rect = PanelRect("centre", 150, 50, 100, 100)
    plain = path_on_screen(StillTrack(aside), CAMERA, np.zeros(1), rect, SCREEN)
    flipped = path_on_screen(StillTrack(aside), CAMERA, np.zeros(1), replace(rect, flipped=True), SCREEN)
    assert plain["x_dva"][0] > 1
    assert flipped["x_dva"] == pytest.approx(-plain["x_dva"])
    aside[2, 3] = 1.0
    assert np.isnan(path_on_screen(StillTrack(aside), CAMERA, np.zeros(1), rect, SCREEN)["x_dva"]).all()


def test_a_trial_with_a_moving_target_gets_one_place_a_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    protocol = tmp_path / "tiny.yaml"
    protocol.write_text(TINY.replace("iti_s: 0.05}", "iti_s: 0.05, fixation: moving}"))
    study = load_study(protocol)
    trials = [trial for trial in plan(study, 1) if trial.panels]
    content = load_scene("tunnel_geom")
    ahead = Mover("Fixation Target", (), Rising())
    seen = replace(content, movers=(*content.movers, ahead), camera=CAMERA)
    monkeypatch.setattr(clip_renderer, "load_scene", lambda source, animation=None: seen)
    paths = TargetPaths(study, tmp_path, SCREEN)
    for trial in trials:
        record = paths.record(trial, 5)
        assert record is not None
        payload = json.loads(record.payload)
        assert payload["trial"] == 5
        assert [panel["frames"] for panel in payload["panels"]] == [round(int(p.rate_hz) * 0.1) for p in trial.panels]
        rows = np.frombuffer(record.raw, TARGET_DTYPE)
        assert len(rows) == sum(panel["frames"] for panel in payload["panels"])
        # It has been rising since the scene's start; the clip begins at 1 s: 1 / 2 of the half height of 16 px.
        assert rows["y_dva"][0] == pytest.approx(
            np.degrees(np.arctan(8 / 200 * 0.25 / np.hypot(0.6, _aside(trial)))), rel=1e-5
        )
    assert paths.record(replace(trials[0], fixation="free"), 1) is None


def _aside(trial: object) -> float:
    """Metres from the screen's centre to the first panel's: 28 px (half of 48 and 8) where there are two."""
    return 28 / 400 * 0.5 if len(trial.panels) == 2 else 0.0  # type: ignore[attr-defined]


def test_a_scene_without_a_target_gives_no_path(tmp_path: Path) -> None:
    protocol = tmp_path / "tiny.yaml"
    protocol.write_text(TINY.replace("iti_s: 0.05}", "iti_s: 0.05, fixation: moving}"))
    study = load_study(protocol)
    trial = next(trial for trial in plan(study, 1) if trial.panels)
    assert TargetPaths(study, tmp_path, SCREEN).record(trial, 0) is None


def test_distance_to_the_target_agrees_with_the_scalar_product() -> None:
    rng = np.random.default_rng(3)
    flips = np.zeros(50, FLIP_DTYPE)
    flips["shown_ns"] = 1000 + np.arange(50) * 100
    flips["source"] = -1
    flips["source"][:, 0], flips["source"][10:, 1] = np.arange(50) // 2, np.arange(40)
    paths = []
    for count in (25, 40):
        path = np.zeros(count, TARGET_DTYPE)
        path["x_dva"], path["y_dva"] = rng.uniform(-20, 20, (2, count))
        paths.append(path)
    samples = np.zeros(300, GAZE_DTYPE)
    samples["mapped_ns"] = np.sort(rng.integers(900, 6500, 300))
    samples["x_dva"], samples["y_dva"] = rng.uniform(-20, 20, (2, 300))
    found = target_distance_dva(samples, flips, paths)
    for sample, angle in zip(samples, found, strict=True):
        shown = [flip for flip in flips if flip["shown_ns"] <= sample["mapped_ns"]]
        if not shown:
            assert np.isnan(angle)
            continue
        marks = [paths[p][shown[-1]["source"][p]] for p in (0, 1) if shown[-1]["source"][p] >= 0]
        eye = _unit(sample["x_dva"], sample["y_dva"])
        expected = min(np.degrees(np.arccos(eye @ _unit(mark["x_dva"], mark["y_dva"]))) for mark in marks)
        assert angle == pytest.approx(expected, abs=1e-4)


def _unit(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    a, e = np.radians(float(azimuth_deg)), np.radians(float(elevation_deg))
    return np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])


def test_the_report_gives_the_distance_to_a_moving_target(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    trials = likert_plan({"condition": ("a", "b"), "fixation": ("moving", "free")}, ("clean",), rng, repetitions=2)
    path = write_session(tmp_path / "s.sqlite", "S", trials, Model(), rng, gaze_hz=500, gaze_error_dva=0.01)
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE IF NOT EXISTS events (t_ns, device, kind, payload, raw)")
    place = np.zeros(48, TARGET_DTYPE)
    place["x_dva"], place["y_dva"] = 3.0, 4.0
    moving = [trial for trial in trials if trial.factors["fixation"] == "moving"]
    for trial in moving:
        payload = json.dumps({"trial": trial.index, "panels": [{"slot": "centre", "frames": 48}]})
        db.execute("INSERT INTO events VALUES (0, 'target', 'path', ?, ?)", (payload, place.tobytes()))
    db.commit()
    sessions = read_sessions([tmp_path])
    gaze = gaze_report(sessions, combine(sessions))
    assert gaze is not None
    known = gaze.trials.dropna(subset=["error_dva"])
    assert set(known["trial"]) == {trial.index for trial in moving}
    away = np.degrees(np.arccos(np.cos(np.radians(3)) * np.cos(np.radians(4))))
    assert known["error_dva"].to_numpy() == pytest.approx(away, abs=0.01)
    db.execute("UPDATE events SET raw = x'00'")
    db.commit()
    db.close()
    with pytest.raises(InputError, match="target path"):
        target_paths(sessions[0])


def test_a_live_panel_has_the_target_of_its_own_condition(tmp_path: Path) -> None:
    """One session: fixed, then moving in two configurations, then fixed again, all live and of one scene and path."""
    conditions = {
        name: {"technique": "foveated", "live": True, "params": {"configuration": name}} for name in ("small", "large")
    }
    factors = {"condition": ["small", "large"], "fixation": {name: {"fixation": name} for name in ("fixed", "moving")}}
    study = tiny(
        scenes={"a": {"scene": "tunnel_geom", "exposure": 1.0}}, conditions=conditions,
        blocks=[rating(factors={"scene": ["a"], **factors})], defaults={"size_px": [48, 32], "warm_up_s": 0},
    )  # fmt: skip
    sources = LiveSources(study, tmp_path, ClipStore(tmp_path / "clips"), None)
    targets = {}
    for trial in sorted((t for t in plan(study, 1) if t.panels), key=lambda t: t.fixation):
        panel = trial.panels[0]
        made = sources.source(trial, panel.slot)
        targets[trial.fixation, panel.condition] = made._technique.engine.scene.fixation_target
    assert targets["fixed", "small"] is targets["fixed", "large"] is None
    paths = [targets["moving", name].track.path.corners for name in ("small", "large")]
    assert not np.array_equal(*paths)
