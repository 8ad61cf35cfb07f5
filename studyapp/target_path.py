"""Where a scene's moving fixation target stands on the screen, frame after frame of a panel, for the session file.

The target is a mover of the scene (decisions.md), named 'target' as `renderers.clip_renderer.gaze_of` has it; a panel
is shown pixel for pixel, so its place in the picture is a place on the screen.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from fractions import Fraction
from math import tan
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from protocols.records import TARGET_DTYPE
from protocols.requests import ClipSpec, clip_spec
from protocols.study import Study
from protocols.trial import Trial
from stimuli.clip_job import ClipJob
from stimuli.clip_request import PATH_NAMES
from studyapp.gaze.angles import ScreenGeometry
from studyapp.present.layout import PanelRect, trial_rects

if TYPE_CHECKING:  # scenes are loaded only where a target moves
    from stimuli.scene import CameraPath, PoseTrack, Scene


@dataclass(frozen=True)
class TargetRecord:
    """The event of one trial: JSON ``payload`` (trial, panels [{slot, frames}]) and TARGET_DTYPE bytes, panel after
    panel."""

    payload: str
    raw: bytes


def fixation_target(scene: Scene) -> PoseTrack | None:
    """The track of the mover that is looked at; None where the scene has none."""
    return None if scene.fixation_target is None else scene.fixation_target.track


def path_on_screen(
    target: PoseTrack, camera: CameraPath, times_s: np.ndarray, rect: PanelRect, screen: ScreenGeometry
) -> np.ndarray:
    """(N,) TARGET_DTYPE: the target's origin at the (N,) scene seconds, seen through ``camera`` in the panel ``rect``.

    nan where it is behind the camera. A mirrored panel mirrors it too.
    """
    world = np.asarray(target.pose(times_s), np.float64)[:, :, 3]
    own = np.einsum("nij,nj->ni", np.linalg.inv(np.asarray(camera.pose(times_s), np.float64)), world)
    ahead = np.where(own[:, 2] < 0, -own[:, 2], np.nan)
    # Half the picture's height is tan(yfov / 2) in front of a pinhole; pixels are square.
    px_per_unit = rect.height_px / 2 / tan(camera.yfov_rad / 2)
    right_px = own[:, 0] / ahead * px_per_unit * (-1 if rect.flipped else 1)
    down_px = -own[:, 1] / ahead * px_per_unit
    x = (rect.x_px + rect.width_px / 2 + right_px) / screen.size_px[0]
    y = (rect.y_px + rect.height_px / 2 + down_px) / screen.size_px[1]
    path = np.empty(len(times_s), TARGET_DTYPE)
    path["x_dva"], path["y_dva"] = screen.to_dva(x, y)
    return path


class TargetPaths:
    """The paths of a study's trials; a scene is loaded once, when the first trial with a moving target asks for it."""

    def __init__(self, study: Study, beside: Path, screen: ScreenGeometry) -> None:
        self._study, self._beside, self._screen = study, beside, screen
        self._known: dict[ClipSpec, tuple[PoseTrack | None, CameraPath]] = {}

    def prepare(self, trial: Trial) -> None:
        """Load what `record` will need, before the trial is shown."""
        if trial.fixation == "moving":
            for panel in trial.panels:
                self._scene(clip_spec(self._study, trial, panel))

    def record(self, trial: Trial, number: int) -> TargetRecord | None:
        """The event of presentation ``number``; None where nothing moves that is to be looked at."""
        if trial.fixation != "moving" or not trial.panels:
            return None
        by_slot = trial_rects(trial, self._screen.size_px)
        panels, parts = [], []
        for panel in trial.panels:
            spec = clip_spec(self._study, trial, panel)
            target, camera = self._scene(spec)
            if target is None:
                return None
            times = float(Fraction(spec.start_s)) + np.arange(spec.frame_count) / float(Fraction(spec.rate_hz))
            panels.append({"slot": panel.slot, "frames": spec.frame_count})
            parts.append(path_on_screen(target, camera, times, by_slot[panel.slot], self._screen))
        payload = json.dumps({"trial": number, "panels": panels})
        return TargetRecord(payload, np.concatenate(parts).tobytes())

    def _scene(self, spec: ClipSpec) -> tuple[PoseTrack | None, CameraPath]:
        if spec not in self._known:
            # Imported only for such studies: they bring scenes and the ray engine along.
            from renderers.clip_renderer import scene_and_camera
            from stimuli.load import load_scene
            from studyapp.commands.check import find_scene

            source = str(find_scene(spec.source, self._beside) or spec.instead)
            content = load_scene(source, animation=spec.animation).sha256
            path_file = str(self._beside / spec.path) if spec.path not in PATH_NAMES and not spec.path_keys else ""
            scene, camera = scene_and_camera(ClipJob(spec.request(content, 1.0), source, path_file, spec.path_keys))
            self._known[spec] = (fixation_target(scene), camera)
        return self._known[spec]
