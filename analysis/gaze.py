"""Gaze during the stimuli: loss, precision, distance to the fixation mark, and where people looked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.rows import rows_of_table
from analysis.sessions import Session
from analysis.streams import read_events, read_flips, read_gaze
from protocols.records import TARGET_DTYPE
from stimuli.errors import InputError, problem

CENTRAL_FIXATION = frozenset({"fixed", "centre", "center", "cross", "central"})
"""Names of fixation modes whose mark stands at the screen's centre; a moving target's path is in the events."""

QUALITY_COLUMNS = [
    "participant",
    "device",
    "samples",
    "rate_hz",
    "valid_share",
    "error_dva",
    "error_p95_dva",
    "precision_dva",
    "validated_dva",
]


@dataclass(frozen=True)
class HeatMap:
    """Where people looked: ``share`` (rows: y upwards, columns: x) of the valid samples, bin edges in degrees."""

    name: str
    share: np.ndarray
    x_edges_dva: np.ndarray
    y_edges_dva: np.ndarray
    samples: int


@dataclass(frozen=True)
class Gaze:
    """``participants``: `QUALITY_COLUMNS`; ``trials``: participant, trial, condition, fixation, samples, valid_share,
    error_dva (nan where no mark was asked for, or where a moving one's path is not in the session); ``maps``: all
    trials, then one per fixation mode if there are several."""

    participants: pd.DataFrame
    trials: pd.DataFrame
    maps: tuple[HeatMap, ...]


def _in_trials(session: Session) -> Iterator[tuple[str, Any, str, np.ndarray]]:
    """(device, trial row, fixation mode, samples between onset and offset), devices and trials in order."""
    plan = session.header.get("plan") or []
    for device, samples in read_gaze(session).items():
        order = np.argsort(samples["mapped_ns"], kind="stable")
        samples = samples[order]
        onset = np.round(session.trials["onset_s"].to_numpy(dtype=float) * 1e9)
        length = np.round(session.trials["duration_s"].to_numpy(dtype=float) * 1e9)
        first = np.searchsorted(samples["mapped_ns"], onset, side="left")
        last = np.searchsorted(samples["mapped_ns"], onset + length, side="right")
        for row, a, b in zip(rows_of_table(session.trials), first, last, strict=True):
            planned = plan[row.planned] if 0 <= row.planned < len(plan) else {}
            mode = str(getattr(row, "fixation", None) or planned.get("fixation", "free"))
            yield device, row, mode, samples[a:b]


def _distance_dva(samples: np.ndarray, x_dva: float | np.ndarray = 0.0, y_dva: float | np.ndarray = 0.0) -> np.ndarray:
    """Angle between gaze and the direction of the mark (the screen's centre by default), from azimuth and elevation
    of both, in degrees (haversine)."""
    x, y = np.radians(samples["x_dva"].astype(float)), np.radians(samples["y_dva"].astype(float))
    mark_x, mark_y = np.radians(x_dva), np.radians(y_dva)
    half = np.sin((y - mark_y) / 2) ** 2 + np.cos(y) * np.cos(mark_y) * np.sin((x - mark_x) / 2) ** 2
    return np.degrees(2 * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0))))


def target_paths(session: Session) -> dict[int, list[np.ndarray]]:
    """trial -> the moving fixation target's place in each frame of each panel ((frames,) TARGET_DTYPE, in the order of
    the flips' ``source``). Raises InputError where an event's bytes are not those of its frames."""
    found = {}
    for event in read_events(session):
        if (event["device"], event["kind"]) != ("target", "path"):
            continue
        counts = [int(panel["frames"]) for panel in event["payload"]["panels"]]
        raw = event["raw"] or b""
        if len(raw) != sum(counts) * TARGET_DTYPE.itemsize:
            wanted = f"{sum(counts) * TARGET_DTYPE.itemsize} bytes"
            raise InputError(problem(f"{session.path}: events", "target path", f"{len(raw)} bytes", wanted))
        rows = np.frombuffer(raw, TARGET_DTYPE)
        found[int(event["payload"]["trial"])] = np.split(rows, np.cumsum(counts)[:-1])
    return found


def target_distance_dva(samples: np.ndarray, flips: np.ndarray, paths: Sequence[np.ndarray]) -> np.ndarray:
    """Angle between each gaze sample and the target that was on the screen at its time, in degrees.

    ``samples`` (N,) GAZE_DTYPE; ``flips`` of the trial, in order; ``paths`` as `target_paths`. Of several panels shown
    at once, the nearest target counts. (N,), nan where no target was on the screen.
    """
    at = np.searchsorted(flips["shown_ns"], samples["mapped_ns"], side="right") - 1
    nearest = np.full(len(samples), np.nan)
    for column, path in enumerate(paths):
        frame = flips["source"][np.maximum(at, 0), column]
        there = (at >= 0) & (frame >= 0) & (frame < len(path))
        mark = path[np.where(there, frame, 0)] if len(path) else np.zeros(len(samples), TARGET_DTYPE)
        angle = _distance_dva(samples, mark["x_dva"].astype(float), mark["y_dva"].astype(float))
        nearest = np.fmin(nearest, np.where(there, angle, np.nan))
    return nearest


def _rms_step_dva(samples: np.ndarray) -> float:
    """RMS of the sample-to-sample distance of valid neighbours: the usual measure of precision; nan for < 2."""
    both = (samples["valid"][1:] > 0) & (samples["valid"][:-1] > 0)
    step = np.hypot(np.diff(samples["x_dva"].astype(float)), np.diff(samples["y_dva"].astype(float)))[both]
    return float(np.sqrt(np.mean(step**2))) if step.size else float("nan")


def validated_accuracy_dva(session: Session) -> float:
    """Mean accuracy of the session's gaze validations, where the events hold them; else nan."""
    found = [
        event["payload"].get("accuracy_deg")
        for event in read_events(session)
        if event["kind"] in ("validation", "gaze_validation") and isinstance(event["payload"], dict)
    ]
    numbers = [float(value) for value in found if value is not None]
    return float(np.mean(numbers)) if numbers else float("nan")


def gaze_report(
    sessions: Sequence[Session], table: pd.DataFrame, progress: Callable[[], object] = lambda: None
) -> Gaze | None:
    """Gaze quality and heat maps over the trials of ``table`` that were shown whole; None where no gaze was recorded.

    Memory: one session's samples at a time, and two numbers a valid sample for the maps.
    """
    people: list[tuple] = []
    trials: list[tuple] = []
    seen: dict[str, list[np.ndarray]] = {}
    for session in sessions:
        usable = set(table.loc[(table["session"] == session.path.stem) & (table["status"] == "ok"), "trial"])
        per_device: dict[str, list[tuple[np.ndarray, np.ndarray, float]]] = {}
        paths = target_paths(session)
        flips = read_flips(session) if paths else {}
        for device, row, mode, samples in _in_trials(session):
            if row.trial not in usable or not len(samples):
                continue
            valid = samples[samples["valid"] > 0]
            distance = np.empty(0)
            if mode in CENTRAL_FIXATION:
                distance = _distance_dva(valid)
            elif row.trial in paths and row.trial in flips:
                distance = target_distance_dva(valid, flips[row.trial], paths[row.trial])
                distance = distance[np.isfinite(distance)]
            error = float(np.median(distance)) if distance.size else float("nan")
            share = len(valid) / len(samples)
            trials.append(
                (session.participant, session.path.stem, row.trial, row.condition, mode, len(samples), share, error)
            )
            per_device.setdefault(device, []).append((samples, distance, _rms_step_dva(samples)))
            seen.setdefault(mode, []).append(np.stack([valid["x_dva"], valid["y_dva"]], axis=1))
        for device, parts in per_device.items():
            people.append(_person_row(session, device, parts))
        progress()
    if not people:
        return None
    columns = ["participant", "session", "trial", "condition", "fixation", "samples", "valid_share", "error_dva"]
    maps = _heat_maps({mode: np.concatenate(parts) for mode, parts in seen.items()})
    return Gaze(pd.DataFrame(people, columns=QUALITY_COLUMNS), pd.DataFrame(trials, columns=columns), maps)


def _person_row(session: Session, device: str, parts: list[tuple[np.ndarray, np.ndarray, float]]) -> tuple:
    samples = sum(len(part) for part, _, _ in parts)
    valid = sum(int(np.count_nonzero(part["valid"])) for part, _, _ in parts)
    step_s = np.concatenate([np.diff(part["device_s"]) for part, _, _ in parts])
    step_s = step_s[step_s > 0]
    rate_hz = float(1.0 / np.median(step_s)) if step_s.size else float("nan")
    distance = np.concatenate([one for _, one, _ in parts])
    error = float(np.median(distance)) if distance.size else float("nan")
    tail = float(np.quantile(distance, 0.95)) if distance.size else float("nan")
    steps = np.array([step for _, _, step in parts])
    steps = steps[np.isfinite(steps)]
    precision = float(np.sqrt(np.mean(steps**2))) if steps.size else float("nan")
    validated = validated_accuracy_dva(session)
    return (session.participant, device, samples, rate_hz, valid / samples, error, tail, precision, validated)


def _heat_maps(points: dict[str, np.ndarray], bins: int = 48) -> tuple[HeatMap, ...]:
    """Shares of valid samples on one common grid that holds 99.5 % of all of them."""
    everything = np.concatenate(list(points.values()))
    everything = everything[np.isfinite(everything).all(axis=1)]
    if not len(everything):
        return ()
    reach = float(max(np.quantile(np.abs(everything), 0.995), 1.0))
    edges = np.linspace(-reach, reach, bins + 1)
    named = {"all trials": everything, **(dict(sorted(points.items())) if len(points) > 1 else {})}
    maps = []
    for name, xy in named.items():
        counts = np.histogram2d(xy[:, 1], xy[:, 0], bins=(edges, edges))[0]
        label = name if name == "all trials" else f"fixation: {name}"
        maps.append(HeatMap(label, counts / max(len(xy), 1), edges, edges, len(xy)))
    return tuple(maps)


def gaze_quality(sessions: Sequence[Session], table: pd.DataFrame) -> pd.DataFrame:
    """`QUALITY_COLUMNS` per participant and device; no rows where no gaze was recorded."""
    gaze = gaze_report(sessions, table)
    return gaze.participants if gaze is not None else pd.DataFrame(columns=QUALITY_COLUMNS)
