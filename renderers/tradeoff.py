"""Speed against accuracy: every technique's settings on one scene, their cost, their error against the gold standard.

The gold standard is `reference`: zero delay, antialiased, at the display's rate. All settings of a scene run in one
process, one after another, so that ratios of their costs carry over to other machines; absolute times do not.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from renderers.catalogue import CATALOGUE, TECHNIQUES, entry
from renderers.clip_frames import scene_exposure, technique_params, view_at
from renderers.engine import Engine
from renderers.jod import JodMetric
from renderers.metrics import pixels_per_degree, sequence_error
from renderers.motion_picture import MotionPicture
from renderers.technique import Frame, Gaze, Measure, ViewGeometry
from stimuli.encode import display_values, encode
from stimuli.scene import CameraPath, Scene

_STAGE_FRAMES = 8


@dataclass(frozen=True)
class Setting:
    """One technique with its parameters at a content rate; ``origin``: default | knob | budget | baseline."""

    technique: str
    params: Mapping[str, Any] = field(default_factory=dict)
    rate_hz: Fraction = Fraction(240)
    origin: str = "default"

    @property
    def label(self) -> str:
        """Short words for tables and plots."""
        shown = ", ".join(f"{name} {_short(value)}" for name, value in self.params.items())
        rate = "" if self.rate_hz == 240 else f" at {_short(float(self.rate_hz))} Hz"
        return f"{self.technique}{rate}{f' ({shown})' if shown else ''}"


@dataclass(frozen=True)
class Conditions:
    """What is the same for all settings of a run. ``frames`` are compared; ``warm_up_frames`` before them are not."""

    size_px: tuple[int, int] = (256, 256)
    rate_hz: Fraction = Fraction(240)
    frames: int = 32
    warm_up_frames: int = 48
    start_s: Fraction = Fraction(1)
    seed: int = 0
    reference_spp: int = 64
    gaze: Gaze | None = None
    lighting: str = "direct"
    flip_windows: int = 4
    geometry: ViewGeometry | None = None


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def settings_of(
    names: Sequence[str], size_px: tuple[int, int], rate_hz: Fraction, budgets: Sequence[float], trials: int, seed: int
) -> list[Setting]:
    """What is tried: each technique's default, ``trials`` points of its knobs, its budgets, the equal-ray baselines.

    Knobs are searched by the same rule for all: their grid in a seeded random order, the first ``trials`` points.
    ``budgets`` are samples a second for the techniques that have such a parameter.
    """
    found: list[Setting] = []
    quarter = size_px[0] * size_px[1] / 4 * float(rate_hz)
    for name in names:
        known = entry(name)
        has_budget = "samples_per_s" in known.params.model_fields
        if name != "reference":
            default = {"samples_per_s": budgets[0] if budgets else quarter} if has_budget else {}
            found.append(Setting(name, default, rate_hz))
        for budget in budgets[1:] if has_budget else ():
            found.append(Setting(name, {"samples_per_s": float(budget)}, rate_hz, "budget"))
        knobs = {knob: values for knob, values in known.knobs.items() if knob != "samples_per_s"}
        grid = [dict(zip(knobs, point, strict=True)) for point in itertools.product(*knobs.values())] if knobs else []
        digest = hashlib.sha256(name.encode()).digest()
        order = np.random.default_rng([seed, int.from_bytes(digest[:4], "little")]).permutation(len(grid))
        extra = {"samples_per_s": budgets[0] if budgets else quarter} if has_budget else {}
        found += [Setting(name, {**grid[i], **extra}, rate_hz, "knob") for i in order[:trials]]
    if "temporally_dense" in names:
        found += equal_ray_baselines(names, quarter, rate_hz)
    unique: dict[str, Setting] = {}
    for setting in found:
        complete = technique_params(setting.technique, setting.params)
        unique.setdefault(f"{setting.technique} {setting.rate_hz} {complete!r}", setting)
    return list(unique.values())


def equal_ray_baselines(names: Sequence[str], samples_per_s: float, rate_hz: Fraction) -> list[Setting]:
    """What `temporally_dense` is judged against at its own primary rays a second."""
    held = rate_hz / 4
    wanted = [
        Setting("framed_low_resolution", {"samples_per_s": samples_per_s}, rate_hz, "baseline"),
        Setting("temporally_dense", {"reproject": False}, rate_hz, "baseline"),
        Setting("vanilla", {}, held, "baseline"),
        Setting("taa", {}, held, "baseline"),
    ]
    return [setting for setting in wanted if setting.technique in names]


@dataclass(frozen=True)
class Gold:
    """The reference of one scene: display values and motion of the compared refreshes, and what all else shares."""

    values: np.ndarray
    motion: np.ndarray
    exposure: float
    ppd: float


def _views(camera: CameraPath, c: Conditions, rate: Fraction, first: int, count: int, exposure: float) -> Iterator[Any]:
    for k in range(first, first + count):
        yield view_at(k, rate, c.start_s, c.size_px, camera, c.gaze, c.geometry, exposure, cut=k == 0)


def gold_standard(engine: Engine, camera: CameraPath, c: Conditions, progress: Callable[[int], object]) -> Gold:
    """Render the reference's compared refreshes."""
    exposure = scene_exposure(engine, camera, c.start_s)
    params = technique_params("reference", {"spp": c.reference_spp})
    reference = TECHNIQUES["reference"](engine, c.size_px, params, c.seed, "total")
    mover = MotionPicture(engine, c.size_px)
    values, motion = [], []
    for view in _views(camera, c, c.rate_hz, c.warm_up_frames, c.frames, exposure):
        values.append(display_values(reference.render(view).color, exposure).astype(np.float32))
        motion.append(mover.of(view))
        progress(1)
    ppd = pixels_per_degree(*c.size_px, camera.yfov_rad, c.geometry)
    return Gold(np.array(values), np.array(motion), exposure, ppd)


def _shown(
    engine: Engine, camera: CameraPath, setting: Setting, c: Conditions, exposure: float, measure: Measure
) -> Iterator[Frame]:
    """The frames of ``setting`` that the refreshes warm_up .. warm_up + frames show, new ones only where due."""
    params = technique_params(setting.technique, setting.params)
    technique = TECHNIQUES[setting.technique](engine, c.size_px, params, c.seed, measure)
    total = c.warm_up_frames + c.frames
    count = math.ceil(total * setting.rate_hz / c.rate_hz)
    for view in _views(camera, c, setting.rate_hz, 0, count, exposure):
        yield technique.render(view)


@dataclass(frozen=True)
class Shown:
    """What a setting showed of the compared refreshes: ``colors`` (n, H, W, 3) linear float32, one entry a refresh (a
    held frame is there several times), ``seconds`` of each frame, ``rays`` of all frames by kind."""

    colors: list[np.ndarray]
    seconds: list[float]
    rays: dict[str, int]


def shown_by(engine: Engine, camera: CameraPath, setting: Setting, exposure: float, c: Conditions) -> Shown:
    """Render ``setting`` through the warm-up and keep the compared refreshes."""
    colors: list[np.ndarray] = []
    seconds: list[float] = []
    rays: dict[str, int] = {}
    per_content = c.rate_hz / setting.rate_hz
    for k, frame in enumerate(_shown(engine, camera, setting, c, exposure, "total")):
        first, after = math.ceil(k * per_content), math.ceil((k + 1) * per_content)
        shown = [r for r in range(first, after) if c.warm_up_frames <= r < c.warm_up_frames + c.frames]
        if shown:
            colors += [np.array(frame.color, np.float32)] * len(shown)
            seconds.append(frame.seconds["total"])
            for kind, number in frame.rays.items():
                rays[kind] = rays.get(kind, 0) + number
    return Shown(colors, seconds, rays)


def measure_setting(
    engine: Engine, camera: CameraPath, setting: Setting, gold: Gold, c: Conditions, jod: JodMetric | None = None
) -> dict[str, Any]:
    """One row: what ``setting`` costs a refresh and how far it is from the gold standard (with ``jod``, in JOD too)."""
    shown = shown_by(engine, camera, setting, gold.exposure, c)
    seconds, rays = shown.seconds, shown.rays
    pictures = [display_values(color, gold.exposure).astype(np.float32) for color in shown.colors]
    error = sequence_error(pictures, gold.values, gold.motion, gold.ppd, c.flip_windows)
    # held frames of a low-rate technique cost nothing: the mean over refreshes is what a budget means
    traced = [s for s in seconds if s > 0]
    busy_share = len(traced) / len(seconds)
    ms_content = statistics.median(traced) * 1e3
    row: dict[str, Any] = {
        "technique": setting.technique,
        "label": setting.label,
        "params": dict(setting.params),
        "origin": setting.origin,
        "content_hz": float(setting.rate_hz),
        "ms_per_content_frame": ms_content,
        "ms_p95": float(np.quantile(traced, 0.95)) * 1e3,
        "ms_per_refresh": ms_content * busy_share * float(setting.rate_hz / c.rate_hz),
        "primary_per_s": rays.get("primary", 0) / c.frames * float(c.rate_hz),
        "rays_per_s": sum(rays.values()) / c.frames * float(c.rate_hz),
        "rays": {kind: number / c.frames for kind, number in rays.items()},
        **{name: value for name, value in asdict(error).items() if name != "rmse_by_refresh"},
        "rmse_by_refresh": list(error.rmse_by_refresh),
        "rmse_eyes": math.sqrt((error.rmse_still**2 + error.rmse_tracking**2) / 2),
    }
    if jod is not None:
        row["jod"] = jod.of(np.array(pictures), gold.values, c.rate_hz)
    row["stages_ms"] = _stages(engine, camera, setting, gold.exposure, c)
    row["precision"] = {
        kind: asdict(what) for kind, what in precision_errors(shown.colors, gold.values, gold.exposure).items()
    }
    return row


@dataclass(frozen=True)
class PrecisionError:
    """What storing adds, in display values: RMS and largest difference from the float picture (before any rounding),
    and how much the RMSE against the gold standard grows."""

    rmse_added: float
    most_added: float
    rmse_growth: float


def precision_errors(colors: Sequence[np.ndarray], gold: np.ndarray, exposure: float) -> dict[str, PrecisionError]:
    """The errors of ``half`` (stored clips: OpenEXR half floats) and ``codes8`` (the play cache: RGBA8 codes, made from
    those halves) against single precision.

    Args:
        colors: linear pictures (H, W, 3), float32.
        gold: their gold standard in display values, (n, H, W, 3).
    """
    squares = {kind: np.zeros(2) for kind in ("half", "codes8")}
    most = dict.fromkeys(squares, 0.0)
    plain = 0.0
    for color, wanted in zip(colors, gold, strict=True):
        exact = display_values(color, exposure)
        plain += float(np.mean((exact - wanted) ** 2))
        stored = {
            "half": display_values(color.astype(np.float16), exposure),
            "codes8": encode(color, exposure)[..., :3] / 255.0,
        }
        for kind, values in stored.items():
            squares[kind] += [np.mean((values - exact) ** 2), np.mean((values - wanted) ** 2)]
            most[kind] = max(most[kind], float(np.abs(values - exact).max()))
    count = max(1, len(colors))
    root = math.sqrt(plain / count)
    return {
        kind: PrecisionError(math.sqrt(added / count), most[kind], math.sqrt(against / count) - root)
        for kind, (added, against) in squares.items()
    }


def _stages(engine: Engine, camera: CameraPath, setting: Setting, exposure: float, c: Conditions) -> dict[str, float]:
    """Median milliseconds of each stage over a few frames (a synchronisation a stage: their sum exceeds the total)."""
    from dataclasses import replace

    few = replace(c, warm_up_frames=4, frames=_STAGE_FRAMES)
    stages: dict[str, list[float]] = {}
    for k, frame in enumerate(_shown(engine, camera, setting, few, exposure, "stages")):
        if k >= 2:
            for name, value in frame.seconds.items():
                stages.setdefault(name, []).append(value * 1e3)
    return {name: statistics.median(values) for name, values in stages.items() if name != "total"}


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
