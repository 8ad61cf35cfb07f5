"""Speed against accuracy: every technique's settings on one scene, their cost, their error against the gold standard.

The gold standard is `reference`: zero delay, antialiased, at the display's rate. All settings of a scene run in one
process, one after another, so that ratios of their costs carry over to other machines; absolute times do not.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import os
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from renderers.acuity import GazeError
from renderers.catalogue import CATALOGUE, TECHNIQUES, entry
from renderers.clip_frames import scene_exposure, technique_params, view_at
from renderers.eccentricity import eye_plane, gaze_point_px, picture_eccentricity_deg
from renderers.engine import Engine
from renderers.jod import GazeJodMetric, JodMetric
from renderers.metrics import Comparison, pixels_per_degree, rmse
from renderers.motion_picture import MotionPicture
from renderers.precision import precision_errors
from renderers.reference import ReferenceRenderer
from renderers.search import Setting
from renderers.stopwatch import by_stages
from renderers.technique import Gaze, Technique, View, ViewGeometry
from renderers.units import average_blocks
from stimuli.encode import display_values
from stimuli.scene import CameraPath, Scene

_STAGE_FRAMES = 6
_MOST_STAGE_VIEWS = 256
_STATELESS_WARM_UP = 4
_SETTLED = 16  # frames after which kernels, caches and the clamp of early history no longer show in the time
_PRECISION_STEP = 4  # what storing adds is taken from every fourth refresh
_GOLD_SEED = 0x601D
_MEASURE = 3
"""Raised where rows are measured in another way than before: old rows are then not found again."""


@dataclass(frozen=True)
class Conditions:
    """What is the same for all settings of a run. ``frames`` are compared; ``warm_up_frames`` before them are not."""

    size_px: tuple[int, int] = (256, 256)
    rate_hz: Fraction = Fraction(240)
    frames: int = 16
    warm_up_frames: int = 48
    start_s: Fraction = Fraction(1)
    seed: int = 0
    reference_spp: int = 64
    gaze: Gaze | None = None
    lighting: str = "direct"
    flip_windows: int = 4
    geometry: ViewGeometry | None = None


@dataclass(frozen=True)
class Gold:
    """The reference of one scene: display values and motion of the compared refreshes, what all else shares, the
    reference's half of every comparison with it, and its own RMSE (display values; None at 1 sample a pixel)."""

    values: np.ndarray
    motion: np.ndarray
    exposure: float
    ppd: float
    comparison: Comparison
    own_rmse: float | None = None


class Perceptual(Protocol):
    """A metric of whole sequences that is not part of `SequenceError` (JOD)."""

    def of(self, test: np.ndarray, reference: np.ndarray, rate_hz: Fraction) -> float:
        """The quality of display values (n, H, W, 3) in [0, 1]."""
        ...


def _views(camera: CameraPath, c: Conditions, rate: Fraction, indices: Iterable[int], exposure: float) -> Iterator[Any]:
    for place, k in enumerate(indices):
        yield view_at(k, rate, c.start_s, c.size_px, camera, c.gaze, c.geometry, exposure, cut=place == 0)


def gold_standard(engine: Engine, camera: CameraPath, c: Conditions, progress: Callable[[int], object]) -> Gold:
    """Render the reference's compared refreshes, in two halves whose difference tells its own error.

    Its samples lie elsewhere than those of any setting (own seed).
    """
    exposure = scene_exposure(engine, camera, c.start_s)
    params = technique_params("reference", {"spp": c.reference_spp})
    reference = ReferenceRenderer(engine, c.size_px, params, c.seed + _GOLD_SEED, "total")
    mover = MotionPicture(engine, c.size_px)
    values, motion, own = [], [], []
    sizes = [c.reference_spp - c.reference_spp // 2, c.reference_spp // 2]
    refreshes = range(c.warm_up_frames, c.warm_up_frames + c.frames)
    for view in _views(camera, c, c.rate_hz, refreshes, exposure):
        firsts = [0, sizes[0]] if sizes[1] else [0]
        halves = [reference.render_samples(view, *part).color for part in zip(firsts, sizes, strict=False)]
        values.append(display_values(average_blocks(halves, sizes[: len(halves)]), exposure).astype(np.float32))
        if len(halves) == 2:
            own.append(rmse(*(display_values(half, exposure) for half in halves)) / 2)
        motion.append(mover.of(view))
        progress(1)
    ppd = pixels_per_degree(*c.size_px, camera.yfov_rad, c.geometry)
    eccentricity = picture_eccentricity_deg(eye_plane(c.size_px, camera.yfov_rad, c.geometry, c.gaze), c.size_px)
    comparison = Comparison(values, motion, ppd, c.flip_windows, GazeError(eccentricity, ppd))
    own_rmse = math.sqrt(statistics.fmean(error**2 for error in own)) if own else None
    return Gold(np.array(values), np.array(motion), exposure, ppd, comparison, own_rmse)


@dataclass(frozen=True)
class Shown:
    """What a setting showed of the compared refreshes, and what it cost.

    ``colors``: (n, H, W, 3) linear float32, one entry a refresh (a held frame is there several times). ``seconds`` and
    ``cpu_seconds`` (of this process, all threads) of every frame that was made once kernels and caches were warm, in
    the warm-up too (at least one). ``made_share``: frames that were made, of all that were due. ``rays``: by kind, a
    frame that was due. ``stages_s``: the seconds of each stage, of a few frames more.
    """

    colors: list[np.ndarray]
    seconds: list[float]
    cpu_seconds: list[float]
    made_share: float
    rays: dict[str, float]
    stages_s: dict[str, list[float]]


def first_frame(setting: Setting, c: Conditions) -> int:
    """Index of the first frame that is rendered: 0, or, where frames follow from their views alone, a few before the
    first that is compared (kernels are recorded and caches warm by then)."""
    known = entry(setting.technique)
    probes = c.lighting == "probes" or setting.params.get("probes", False)
    if not (known.stateless or (known.probes_remember and not probes)):
        return 0
    return max(0, math.floor(c.warm_up_frames * setting.rate_hz / c.rate_hz) - _STATELESS_WARM_UP)


def shown_by(
    engine: Engine, camera: CameraPath, setting: Setting, exposure: float, c: Conditions, stage_frames: int = 0
) -> Shown:
    """Render ``setting`` through the warm-up, keep the compared refreshes, and then time the stages of ``stage_frames``
    more frames (a synchronisation a stage: their sum exceeds the total)."""
    params = technique_params(setting.technique, setting.params)
    technique = TECHNIQUES[setting.technique](engine, c.size_px, params, c.seed, "total")
    per_content = c.rate_hz / setting.rate_hz
    start, total = first_frame(setting, c), c.warm_up_frames + c.frames
    end = math.ceil(total / per_content)
    views = _views(camera, c, setting.rate_hz, itertools.count(start), exposure)
    colors: list[np.ndarray] = []
    cost: list[_Cost] = []
    first_compared = 0
    for k, view in zip(range(start, end), views, strict=False):
        cpu_s = time.process_time()
        frame = technique.render(view)
        cost.append(_Cost(k, frame.seconds["total"], time.process_time() - cpu_s, dict(frame.rays)))
        refreshes = range(max(math.ceil(k * per_content), c.warm_up_frames), math.ceil((k + 1) * per_content))
        held = len([r for r in refreshes if r < total])
        colors += [np.array(frame.color, np.float32)] * held
        first_compared += not held
    made = [one for one in cost if one.seconds > 0]
    warm = [one for one in cost[min(first_compared, _SETTLED) :] if one.seconds > 0] or made[-1:]
    compared = [one for one in cost[first_compared:] if one.seconds > 0]
    share = len(compared) / (len(cost) - first_compared)
    if not compared:  # held for longer than all that is compared: made as often as from one frame to the next
        compared, share = made[-1:], (len(made) - 1) / (made[-1].frame - made[0].frame) if len(made) > 1 else 0.0
    return Shown(
        colors=colors,
        seconds=[one.seconds for one in warm],
        cpu_seconds=[one.cpu_seconds for one in warm],
        made_share=share,
        rays={kind: share * statistics.fmean(one.rays[kind] for one in compared) for kind in compared[0].rays},
        stages_s=_stages(technique, views, stage_frames),
    )


@dataclass(frozen=True)
class _Cost:
    """What frame number ``frame`` took; 0 s where it was held."""

    frame: int
    seconds: float
    cpu_seconds: float
    rays: dict[str, int]


def _stages(technique: Technique, views: Iterator[View], frames: int) -> dict[str, list[float]]:
    """Seconds of each stage of the next ``frames`` frames that are made; held ones have none, and are not waited for
    beyond `_MOST_STAGE_VIEWS`."""
    stages: dict[str, list[float]] = {}
    for view in itertools.islice(views, _MOST_STAGE_VIEWS if frames else 0):
        with by_stages():
            taken = technique.render(view).seconds
        if taken["total"] > 0:
            for name, seconds in taken.items():
                stages.setdefault(name, []).append(seconds)
        if len(stages.get("total", ())) >= frames:
            break
    return {name: seconds for name, seconds in stages.items() if name != "total"}


def perceptual_metrics(columns: Sequence[str], camera: CameraPath, gold: Gold, c: Conditions) -> dict[str, Perceptual]:
    """The metrics behind the columns ``jod`` and ``jod_gaze``. Raises InputError where a package is not installed."""
    found: dict[str, Perceptual] = {}
    if "jod" in columns:
        found["jod"] = JodMetric(c.size_px, gold.ppd)
    if "jod_gaze" in columns:
        plane = eye_plane(c.size_px, camera.yfov_rad, c.geometry, c.gaze)
        found["jod_gaze"] = GazeJodMetric(c.size_px, gold.ppd, gaze_point_px(plane))
    return found


def measure_setting(
    engine: Engine,
    camera: CameraPath,
    setting: Setting,
    gold: Gold,
    c: Conditions,
    perceptual: Mapping[str, Perceptual] | None = None,
) -> dict[str, Any]:
    """One row: what ``setting`` costs a refresh and how far it is from the gold standard. ``perceptual``: column ->
    a metric of its own, see `Perceptual`."""
    shown = shown_by(engine, camera, setting, gold.exposure, c, _STAGE_FRAMES)
    pictures = np.array([display_values(color, gold.exposure).astype(np.float32) for color in shown.colors])
    error = gold.comparison.error(pictures)
    # held frames cost nothing: the mean over refreshes is what a budget means
    ms_content, cpu_ms = (statistics.median(taken) * 1e3 for taken in (shown.seconds, shown.cpu_seconds))
    hz = float(setting.rate_hz)
    made_a_refresh = shown.made_share * float(setting.rate_hz / c.rate_hz)
    few = slice(None, None, _PRECISION_STEP)
    precision = precision_errors(shown.colors[few], gold.values[few], gold.exposure)
    return {
        "technique": setting.technique,
        "label": setting.label,
        "params": dict(setting.params),
        "origin": setting.origin,
        "content_hz": float(setting.rate_hz),
        "ms_per_content_frame": ms_content,
        "ms_p95": float(np.quantile(shown.seconds, 0.95)) * 1e3,
        "ms_per_refresh": ms_content * made_a_refresh,
        "cpu_ms_per_refresh": cpu_ms * made_a_refresh,
        "load_per_core": os.getloadavg()[0] / (os.cpu_count() or 1),
        "primary_per_s": shown.rays["primary"] * hz,
        "rays_per_s": sum(shown.rays.values()) * hz,
        "rays": {kind: number * float(setting.rate_hz / c.rate_hz) for kind, number in shown.rays.items()},
        **{name: value for name, value in asdict(error).items() if name != "rmse_by_refresh"},
        "rmse_by_refresh": list(error.rmse_by_refresh),
        "gold_rmse": gold.own_rmse,
        "rmse_eyes": math.sqrt((error.rmse_still**2 + error.rmse_tracking**2) / 2),
        **{name: metric.of(pictures, gold.values, c.rate_hz) for name, metric in (perceptual or {}).items()},
        "stages_ms": {name: statistics.median(values) * 1e3 for name, values in shown.stages_s.items()},
        "precision": {kind: asdict(what) for kind, what in precision.items()},
    }


def pareto_front(
    rows: Sequence[Mapping[str, Any]], cost: str = "ms_per_refresh", error: str = "rmse_eyes"
) -> list[int]:
    """Indices of the rows that no other row beats in both cost and error, in rising cost."""
    order = sorted(range(len(rows)), key=lambda i: (rows[i][cost], rows[i][error]))
    front: list[int] = []
    best = math.inf
    for i in order:
        if rows[i][error] < best:
            front.append(i)
            best = rows[i][error]
    return front


class RowFile:
    """Rows on disk, one JSON line each, appended and flushed as they are measured, so that a run can go on.

    A row is found by the scene's content, the conditions and the setting; another engine version has other rows.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, dict[str, Any]] = {}
        if path.exists():
            text = path.read_text()
            whole = text[: text.rfind("\n") + 1]
            for line in whole.splitlines():
                row = json.loads(line)
                self.rows[row["key"]] = row
            if len(whole) < len(text):  # the run was killed in the middle of its last line
                path.write_text(whole)

    @staticmethod
    def key(scene: Scene, camera: CameraPath, setting: Setting, c: Conditions, version: int) -> str:
        """The identity of a measurement."""
        told = [
            scene.sha256,
            camera.name,
            setting.technique,
            dict(setting.params),
            str(setting.rate_hz),
            asdict(c),
            version,
            _MEASURE,
        ]
        return hashlib.sha256(json.dumps(told, sort_keys=True, default=str).encode()).hexdigest()

    def add(self, key: str, row: dict[str, Any]) -> dict[str, Any]:
        """Keep ``row`` and write it."""
        row = {"key": key, **row}
        self.rows[key] = row
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a") as file:
            file.write(json.dumps(row) + "\n")
        return row


def techniques_for(names: Sequence[str] | None) -> list[str]:
    """The techniques asked for, or all of the catalogue; InputError for an unknown one."""
    return list(CATALOGUE) if not names else [entry(name, "--technique").name for name in names]
