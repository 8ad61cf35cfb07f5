"""Session files with a known generating model, written straight to the records contract (no studyapp)."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from protocols.records import FLIP_DTYPE, GAZE_DTYPE, SCHEMA_VERSION, TABLES
from protocols.trial import Panel, Question, Trial

PERIOD_NS = 4_166_667


@dataclass(frozen=True)
class Model:
    """How observers answer. ``preference``: utilities (logit) by condition; ``rating``: mean by condition;
    ``person_sd``: their spread between people; ``noise_sd``: within; ``lapse``: share of random answers."""

    preference: Mapping[str, float] = field(default_factory=dict)
    rating: Mapping[str, float] = field(default_factory=dict)
    person_sd: float = 0.4
    noise_sd: float = 0.9
    side_bias: float = 0.0
    lapse: float = 0.0


def choice_plan(
    conditions: Sequence[str], scenes: Sequence[str], rng: np.random.Generator, *, catch: int = 2, practice: int = 1
) -> list[Trial]:
    """Side-by-side trials of every pair on every scene, random sides, with practice and catch trials."""
    trials: list[Trial] = []
    question = Question(
        "closer", "Which is closer to the middle one?", "choice", ("left", "right"), keys={"f": "left", "j": "right"}
    )

    def add(a: str, b: str, scene: str, **more: Any) -> None:
        left, right = (a, b) if rng.random() < 0.5 else (b, a)
        panels = (
            Panel("left", left, left.split("_")[0], rate_hz=rate_of(left), clip=clip_name(scene, left)),
            Panel("centre", "reference", "reference", "reference", clip=clip_name(scene, "reference")),
            Panel("right", right, right.split("_")[0], rate_hz=rate_of(right), clip=clip_name(scene, right)),
        )
        if more.get("catch"):
            more["correct"] = "left" if left == a else "right"
        trials.append(
            Trial(
                len(trials),
                "choice",
                "side_by_side",
                scene,
                panels=panels,
                questions=(question,),
                duration_s=1.0,
                factors={"scene": scene},
                **more,
            )
        )

    for _ in range(practice):
        add(conditions[0], conditions[1], scenes[0], practice=True)
    cells = [(a, b, s) for i, a in enumerate(conditions) for b in conditions[i + 1 :] for s in scenes]
    for i in rng.permutation(len(cells)):
        add(*cells[i])
    for _ in range(catch):
        add(conditions[0], conditions[-1], scenes[0], catch=True)
    return trials


def likert_plan(
    factors: Mapping[str, Sequence[str]],
    questions: Sequence[str],
    rng: np.random.Generator,
    *,
    repetitions: int = 1,
    start: int = 0,
) -> list[Trial]:
    """Rated sequences: the full crossing of ``factors`` (one of them 'condition'), in random order."""
    names = list(factors)
    grid = np.stack(np.meshgrid(*[range(len(factors[name])) for name in names], indexing="ij"), -1).reshape(
        -1, len(names)
    )
    asked = tuple(
        Question(
            q,
            f"The sequence was {q}.",
            "likert",
            low=-3,
            high=3,
            labels={"-3": "strongly disagree", "3": "strongly agree"},
            keys={str(i): str(i - 4) for i in range(1, 8)},
        )
        for q in questions
    )
    trials = []
    for repetition in range(repetitions):
        for row in rng.permutation(grid):
            levels = {name: factors[name][i] for name, i in zip(names, row, strict=True)}
            scene, condition = levels.get("scene", "bar"), levels["condition"]
            panel = Panel(
                "centre",
                condition,
                condition.split("_")[0],
                rate_hz=rate_of(condition),
                clip=clip_name(scene, condition),
            )
            trials.append(
                Trial(
                    start + len(trials),
                    "rated",
                    "likert",
                    scene,
                    panels=(panel,),
                    questions=asked,
                    duration_s=1.0,
                    repetition=repetition,
                    fixation=levels.get("fixation", "free"),
                    factors=levels,
                )
            )
    return trials


def rate_of(condition: str) -> str:
    """The content rate that the fabricated condition's name ends in, else 240."""
    tail = condition.rsplit("_", 1)[-1]
    return tail if tail.isdigit() else "240"


def clip_name(scene: str, condition: str) -> str:
    return f"{scene}/{condition}"


def write_session(
    path: Path,
    participant: str,
    plan: Sequence[Trial],
    model: Model,
    rng: np.random.Generator,
    *,
    observer_kind: str = "simulated",
    analysis_plan: Mapping[str, Any] | None = None,
    refreshes: int = 48,
    missed: Mapping[int, int] | None = None,
    gaze_hz: float = 0.0,
    gaze_error_dva: float = 0.4,
    header: Mapping[str, Any] | None = None,
) -> Path:
    """One session of this participant; ``missed``: trial -> refreshes lost in its middle (its status stays ok)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    db = sqlite3.connect(path)
    for statement in TABLES.values():
        db.execute(statement)
    own = {name: rng.normal(0.0, model.person_sd) for name in sorted({*model.preference, *model.rating})}
    clips = sorted({(trial.scene, panel.condition, panel.clip) for trial in plan for panel in trial.panels})
    values = {
        "schema_version": SCHEMA_VERSION,
        "study": "fabricated",
        "participant": participant,
        "run": 1,
        "observer_kind": observer_kind,
        "observer": "model",
        "seed": 7,
        "stamp_class": "virtual",
        "refresh_hz": "240",
        "software": {"studyapp": "0.1.0"},
        "certificate": {"measured_hz": 239.98, "locked": True},
        "overrides": [],
        "analysis_plan": dict(analysis_plan or {}),
        "conditions": {},
        "plan": [trial.as_dict() for trial in plan],
        "protocol_sha256": "0" * 64,
        "started_utc": "2026-11-22T03:00:00Z",
        **(header or {}),
    }
    db.executemany("INSERT INTO header VALUES (?, ?)", [(key, json.dumps(value)) for key, value in values.items()])
    for order, (_, condition, clip) in enumerate(clips):
        manifest = {"luminance": {"mean": 0.2 + 0.0005 * order, "clipped_share": 0.01, "percentiles": {"50": 0.18}}}
        cost = {"frames": [{"seconds": {"total": cost_s(condition)}, "rays": {"primary": 1000, "shadow": 1000}}] * 4}
        db.execute("INSERT INTO clips VALUES (?, ?, ?)", (clip, json.dumps(manifest), json.dumps(cost)))
    now, chunk = 1_000_000_000, 0
    for trial in plan:
        lost = dict(missed or {}).get(trial.index, 0)
        flips = _flips(trial, now, refreshes, lost, rng)
        offset = int(flips["shown_ns"][-1]) + PERIOD_NS
        panels = json.dumps(list(trial.as_dict()["panels"]))
        db.execute(
            "INSERT INTO trials VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)",
            (
                trial.index,
                trial.index,
                0,
                trial.block,
                trial.kind,
                trial.scene,
                trial.practice,
                trial.catch,
                trial.correct,
                panels,
                json.dumps(dict(trial.factors)),
                now,
                offset,
                refreshes,
                lost,
                0,
                "ok",
                observer_kind,
            ),
        )
        db.execute("INSERT INTO flips VALUES (?, 0, ?)", (trial.index, flips.tobytes()))
        for question in trial.questions:
            answer, rating, chosen = _answer(trial, question, model, own, rng)
            rt_ns = int(1e9 * np.exp(rng.normal(0.4, 0.3)))
            db.execute(
                "INSERT INTO responses VALUES (?,?,?,?,?,?,?,?,?,?,?,?)",
                (
                    trial.index,
                    question.name,
                    question.kind,
                    answer,
                    rating,
                    chosen,
                    rt_ns,
                    now + rt_ns,
                    "model",
                    None,
                    b"k",
                    0,
                ),
            )
        if gaze_hz:
            samples = _gaze(now, offset, gaze_hz, gaze_error_dva, rng)
            db.execute("INSERT INTO gaze VALUES ('tracker', ?, ?)", (chunk, samples.tobytes()))
            chunk += 1
        now = offset + 500_000_000
    for table in TABLES:
        if not db.execute(f"SELECT 1 FROM {table} LIMIT 1").fetchone():
            db.execute(f"DROP TABLE {table}")
    db.commit()
    db.close()
    return path


def cost_s(condition: str) -> float:
    """Seconds a frame that the fabricated condition cost."""
    return 0.004 * (1 + sum(map(ord, condition)) % 7)


def _flips(trial: Trial, onset_ns: int, refreshes: int, lost: int, rng: np.random.Generator) -> np.ndarray:
    flips = np.zeros(refreshes, dtype=FLIP_DTYPE)
    k = np.arange(refreshes) + np.where(np.arange(refreshes) >= refreshes // 2, lost, 0)
    flips["refresh"] = k + round(onset_ns / PERIOD_NS)
    flips["due_ns"] = onset_ns + k * PERIOD_NS
    flips["shown_ns"] = flips["due_ns"] + rng.integers(-20_000, 20_000, refreshes)
    flips["submitted_ns"] = flips["due_ns"] - 2_000_000
    flips["missed"][refreshes // 2] = lost
    flips["upload_ns"], flips["draw_ns"], flips["gaze_age_ns"] = 400_000, 200_000, -1
    flips["source"] = -1
    for place, panel in enumerate(trial.panels):
        flips["source"][:, place] = np.arange(refreshes) * int(panel.rate_hz) // 240
    return flips


def _answer(
    trial: Trial, question: Question, model: Model, own: Mapping[str, float], rng: np.random.Generator
) -> tuple[str, float | None, str | None]:
    shown = {panel.slot: panel.condition for panel in trial.panels if panel.role != "reference"}
    if question.kind == "choice":
        left, right = shown["left"], shown["right"]
        utility = {name: model.preference.get(name, 0.0) + own.get(name, 0.0) for name in (left, right)}
        p_right = 1 / (1 + np.exp(-(utility[right] - utility[left] + model.side_bias)))
        slot = "right" if rng.random() < (0.5 if rng.random() < model.lapse else p_right) else "left"
        if trial.catch and trial.correct:
            slot = trial.correct
        return slot, None, shown[slot]
    condition = next(iter(shown.values()))
    value = model.rating.get(condition, 0.0) + own.get(condition, 0.0) + rng.normal(0.0, model.noise_sd)
    rating = float(np.clip(np.rint(value), question.low, question.high))
    return str(int(rating)), rating, None


def _gaze(onset_ns: int, offset_ns: int, rate_hz: float, error_dva: float, rng: np.random.Generator) -> np.ndarray:
    n = int((offset_ns - onset_ns) * 1e-9 * rate_hz)
    samples = np.zeros(n, dtype=GAZE_DTYPE)
    samples["mapped_ns"] = onset_ns + (np.arange(n) * 1e9 / rate_hz).astype(np.int64)
    samples["host_ns"] = samples["mapped_ns"] + 3_000_000
    samples["device_s"] = samples["mapped_ns"] * 1e-9 + 100.0
    samples["x_dva"], samples["y_dva"] = rng.normal(0, error_dva, n), rng.normal(0, error_dva, n)
    samples["pupil_mm"], samples["valid"] = 3.5, rng.random(n) > 0.03
    return samples


DEMO_CONDITIONS = ("tdrt_240", "vanilla_60", "taa_240")
DEMO_MODEL = Model(
    preference={"tdrt_240": 1.0, "vanilla_60": -1.0, "taa_240": 0.0},
    rating={"tdrt_240": 1.6, "vanilla_60": -1.4, "taa_240": 0.3},
)


def demo_study(
    folder: Path, participants: int = 12, seed: int = 1, scenes: Sequence[str] = ("bar", "toy_car"), **more: Any
) -> list[Path]:
    """A demo-like study: pairwise comparisons and Likert ratings of three conditions on two scenes."""
    paths = []
    for number, child in enumerate(np.random.SeedSequence(seed).spawn(participants), start=1):
        rng = np.random.default_rng(child)
        plan = choice_plan(DEMO_CONDITIONS, scenes, rng)
        plan += likert_plan(
            {"condition": DEMO_CONDITIONS, "scene": tuple(scenes)},
            ("artifact_free", "smooth"),
            rng,
            start=len(plan),
        )
        paths.append(
            write_session(
                folder / f"fabricated_p{number:02d}_1.sqlite", f"P{number:02d}", plan, DEMO_MODEL, rng, **more
            )
        )
    return paths


FOVEATED = {"small": -1.2, "medium": 0.4, "large": 0.7, "full": 0.8}


def foveated_study(folder: Path, participants: int = 15, seed: int = 2, **more: Any) -> list[Path]:
    """The 2016 design: 4 scenes x 4 configurations x 3 fixation types x 2 repetitions, two questions (96 trials)."""
    paths = []
    factors = {
        "condition": tuple(FOVEATED),
        "scene": ("rungholt", "sponza", "tunnel_geom", "tunnel_maps"),
        "fixation": ("fixed", "moving", "free"),
    }
    model = Model(rating=FOVEATED)
    for number, child in enumerate(np.random.SeedSequence(seed).spawn(participants), start=1):
        rng = np.random.default_rng(child)
        plan = likert_plan(factors, ("artifact_free", "smooth"), rng, repetitions=2)
        paths.append(
            write_session(folder / f"foveated_p{number:02d}_1.sqlite", f"P{number:02d}", plan, model, rng, **more)
        )
    return paths
