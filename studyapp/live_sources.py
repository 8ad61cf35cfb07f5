"""Live panels of a session: techniques made ready before a trial, and what is kept to render its frames again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from protocols.requests import ClipSpec, clip_spec
from protocols.study import Study
from protocols.trial import Trial
from renderers import TECHNIQUES
from renderers.clip_renderer import scene_and_camera
from renderers.engine import Engine
from renderers.technique import ViewGeometry
from stimuli.camera_path import PATH_NAMES
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob
from stimuli.encode import DisplayTable
from stimuli.errors import InputError, problem
from stimuli.load import load_scene
from studyapp.clips import settled_exposure
from studyapp.commands.check import find_scene
from studyapp.gaze.angles import ScreenGeometry
from studyapp.present.layout import trial_rects
from studyapp.present.live import LIVE_DTYPE, LiveSource, LiveView, PanelPlace
from studyapp.seams import GazeSource


@dataclass(frozen=True)
class LiveLog:
    """How one live panel of one presentation was made: JSON ``payload`` and the frames' log (LIVE_DTYPE bytes)."""

    payload: str
    frames: bytes


class LiveSources:
    """Makes a `LiveSource` for each live specification and place, once. ``screen``: where panels stand for the eye
    (None: gaze is that from the panel's centre already, as a session's record has it)."""

    def __init__(
        self, study: Study, beside: Path, store: ClipStore, gaze: GazeSource | None, table: DisplayTable | None = None,
        screen: ScreenGeometry | None = None,
    ) -> None:  # fmt: skip
        self._table, self._screen = table, screen
        self._study, self._beside, self._store, self._gaze = study, beside, store, gaze
        self._engines: dict[tuple[str, str | None, str], tuple[Any, Any, Any]] = {}
        self._sources: dict[tuple[ClipSpec, PanelPlace | None], LiveSource] = {}

    def source(self, trial: Trial, slot: str) -> LiveSource:
        """The panel's frames, at the clip's start: history forgotten, warm-up rendered."""
        panel = next(panel for panel in trial.panels if panel.slot == slot)
        spec = clip_spec(self._study, trial, panel)
        place = None if self._screen is None else place_of(trial, slot, self._screen)
        source = self._sources.get((spec, place))
        if source is None:
            source = self._sources[spec, place] = self._make(spec, place)
        source.begin()
        return source

    def _make(self, spec: ClipSpec, place: PanelPlace | None) -> LiveSource:
        source = find_scene(spec.source, self._beside) or spec.instead
        if source is None:
            raise InputError(problem(f"scene {spec.scene}", "source", repr(spec.source), "a scene that can be found"))
        key = (str(source), spec.animation, spec.path + spec.path_keys + spec.lighting)
        if spec.gaze == "moving":  # the scene has the target of this condition
            key = (*key[:2], f"{key[2]} {spec.technique} {spec.params} {spec.start_s} {spec.duration_s}")
        if key not in self._engines:
            content = load_scene(str(source), animation=spec.animation).sha256
            path_file = str(self._beside / spec.path) if spec.path not in PATH_NAMES and not spec.path_keys else ""
            job = ClipJob(spec.request(content, 1.0), str(source), path_file, spec.path_keys)
            scene, camera = scene_and_camera(job)
            engine = Engine(scene, lighting=spec.lighting)  # type: ignore[arg-type]
            self._engines[key] = (engine, camera, settled_exposure(job, scene, self._store))
        engine, camera, exposure = self._engines[key]
        technique = TECHNIQUES[spec.technique]
        made = technique(
            engine, spec.size_px, technique.Params(**json.loads(spec.params)), seed=spec.seed, measure="total"
        )
        geometry = None if spec.geometry is None else ViewGeometry(spec.geometry[0], spec.geometry[1], spec.geometry[2])
        view = LiveView(
            camera, spec.size_px, Fraction(spec.rate_hz), spec.frame_count, Fraction(spec.start_s), geometry,
            exposure=exposure if spec.exposure is None else spec.exposure, warm_up_s=Fraction(spec.warm_up_s),
            seed=spec.seed, table=self._table, place=place,
        )  # fmt: skip
        return LiveSource(made, view, self._gaze)


def place_of(trial: Trial, slot: str, screen: ScreenGeometry) -> PanelPlace:
    """Where a panel of ``trial`` stands for an eye on the screen's middle axis."""
    rect = trial_rects(trial, screen.size_px)[slot]
    wide_m, high_m = screen.width_m / screen.size_px[0], screen.height_m / screen.size_px[1]
    right_px = rect.x_px + rect.width_px / 2 - screen.size_px[0] / 2
    down_px = rect.y_px + rect.height_px / 2 - screen.size_px[1] / 2
    return PanelPlace(
        right_px * wide_m, -down_px * high_m, rect.height_px * high_m, screen.distance_m, rect.flipped
    )  # fmt: skip


def log_of(source: LiveSource, trial_number: int, slot: str) -> LiveLog:
    """What the session keeps of a live panel; ``last_sha256`` is of the codes shown last, which hang on all before."""
    frames = source.log()
    last = hashlib.sha256(source.frame(int(frames["frame"][-1])).tobytes()).hexdigest() if len(frames) else None
    payload = {"trial": trial_number, "slot": slot, "last_sha256": last, **source.provenance()}
    return LiveLog(json.dumps(payload, sort_keys=True), frames.tobytes())


class RecordedGaze:
    """A `GazeSource` that says again what a live panel was rendered with, frame after frame."""

    name = "recorded"

    def __init__(self, frames: bytes) -> None:
        self._rows = np.frombuffer(frames, LIVE_DTYPE)
        self._next = 0

    @property
    def rows(self) -> np.ndarray:
        """The log, (N,) LIVE_DTYPE."""
        return self._rows

    def newest(self) -> tuple[float, float, int, bool] | None:
        row = self._rows[self._next]
        self._next += 1
        if int(row["gaze_ns"]) < 0:
            return None
        return float(row["x_deg"]), float(row["y_deg"]), int(row["gaze_ns"]), True

    def alive(self) -> bool:
        return True
