"""Manipulation checks: what each condition really was on the screen (light, rate, misses, gaze, cost)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from analysis.gaze import Gaze
from analysis.sessions import Session
from analysis.timing import Timing

COLUMNS = [
    "condition", "clips", "shown", "luminance", "clipped_share", "rate_hz", "achieved_hz", "refreshes", "missed",
    "missed_share", "gaze_error_dva", "cost_ms", "rays",
]  # fmt: skip


def clip_cost(cost: Mapping[str, Any]) -> tuple[float, float]:
    """(milliseconds a frame, rays a frame) of a clip's stored cost; nan where it holds none (external clips)."""
    frames = cost.get("frames") or []
    seconds = [frame["seconds"]["total"] for frame in frames if "total" in (frame.get("seconds") or {})]
    rays = [sum(frame["rays"].values()) for frame in frames if frame.get("rays")]
    nan = float("nan")
    return (1000.0 * float(np.mean(seconds)) if seconds else nan, float(np.mean(rays)) if rays else nan)


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def _luminance(clip: Mapping[str, Any]) -> tuple[float, float]:
    """(mean displayed luminance with the display's peak at 1, share of clipped pixels) of a stored clip."""
    light = clip.get("luminance") or (clip.get("manifest") or {}).get("luminance") or {}
    return float(light.get("mean", np.nan)), float(light.get("clipped_share", np.nan))


def manipulation_checks(sessions: Sequence[Session], timing: Timing, gaze: Gaze | None) -> pd.DataFrame:
    """`COLUMNS`, one row a condition (references and catch panels too), over all presentations.

    luminance: mean over its clips, peak = 1; achieved_hz: new frames a second, mean over presentations; missed:
    refreshes lost while it was on the screen; gaze_error_dva: median distance to the central mark, mean over its
    trials; cost_ms: mean per frame over its clips, as measured when they were rendered. What was not recorded is nan.
    """
    clips: dict[str, dict[str, Mapping[str, Any]]] = {}
    for session in sessions:
        for trial in session.header.get("plan") or []:
            for panel in trial.get("panels", ()):
                own = clips.setdefault(panel["condition"], {})
                if panel.get("clip") in session.clips:
                    own[panel["clip"]] = session.clips[panel["clip"]]
    shown = timing.panels.groupby("condition", sort=False)
    rows = []
    for condition in sorted(clips):
        lights = [_luminance(clip) for clip in clips[condition].values()]
        costs = [clip_cost(clip.get("cost") or {}) for clip in clips[condition].values()]
        panels = shown.get_group(condition) if condition in shown.groups else timing.panels.iloc[:0]
        refreshes, missed = int(panels["refreshes"].sum()), int(panels["missed"].sum())
        rows.append(
            {
                "condition": condition,
                "clips": len(clips[condition]),
                "shown": len(panels),
                "luminance": _mean([mean for mean, _ in lights]),
                "clipped_share": _mean([share for _, share in lights]),
                "rate_hz": _mean(panels["rate_hz"].tolist()),
                "achieved_hz": _mean(panels["achieved_hz"].tolist()),
                "refreshes": refreshes,
                "missed": missed,
                "missed_share": missed / (refreshes + missed) if refreshes + missed else float("nan"),
                "gaze_error_dva": _gaze_error(gaze, condition),
                "cost_ms": _mean([ms for ms, _ in costs]),
                "rays": _mean([rays for _, rays in costs]),
            }
        )
    return pd.DataFrame(rows, columns=COLUMNS)


def _gaze_error(gaze: Gaze | None, condition: str) -> float:
    if gaze is None:
        return float("nan")
    shown = gaze.trials["condition"].astype(str).str.split("|").map(lambda names: condition in names)
    return _mean(gaze.trials.loc[shown, "error_dva"].tolist())


def luminance_differences(sessions: Sequence[Session]) -> pd.DataFrame:
    """Mean luminance of clips that were compared: scene, condition, luminance, relative to the scene's mean."""
    found: dict[tuple[str, str], float] = {}
    for session in sessions:
        for trial in session.header.get("plan") or []:
            for panel in trial.get("panels", ()):
                clip = session.clips.get(panel.get("clip", ""))
                if clip is not None:
                    found[(trial["scene"], panel["condition"])] = _luminance(clip)[0]
    table = pd.DataFrame(
        [(s, c, light) for (s, c), light in sorted(found.items())], columns=["scene", "condition", "luminance"]
    )
    mean = table.groupby("scene")["luminance"].transform("mean")
    table["difference"] = (
        np.divide(table["luminance"], mean, out=np.full(len(table), np.nan), where=mean.to_numpy() > 0) - 1.0
    )
    return table
