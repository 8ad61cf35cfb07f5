"""What the protocol's ``match`` makes equal, against what the shown clips really cost (`protocols.match.Match`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from analysis.protocol_facts import protocol_of
from analysis.sessions import Session

COLUMNS = ["measure", "condition", "scene", "value", "target", "difference", "tolerance", "matched", "status", "note"]


def match_checks(sessions: Sequence[Session]) -> pd.DataFrame:
    """`COLUMNS`, one row for each match of the protocol, condition and scene, from the costs that clips carry.

    value: rays or primary rays a second of the clip, or its median ms a frame; target: the stated number, or what the
    condition ``to`` has in the same scene; difference: value / target - 1; matched: within the tolerance. Where no
    shown clip carries its cost (simulated sessions, external clips), and for quality, which needs pictures that
    sessions do not hold, the row has what `studyapp match` measured; it is ``undefined`` where nothing was.
    """
    stated = sessions[0].header.get("match") or protocol_of(sessions[0]).get("match") or []
    shown = _shown_clips(sessions)
    rows: list[dict[str, Any]] = []
    for match in stated:
        if isinstance(match, Mapping):
            rows += _rows(match, shown)
    return pd.DataFrame(rows, columns=COLUMNS)


def unmatched_comparisons(sessions: Sequence[Session]) -> list[tuple[str, list[str]]]:
    """(block, its conditions that no ``match`` makes equal) for each block that compared pictures with each other."""
    stated = sessions[0].header.get("match") or protocol_of(sessions[0]).get("match") or []
    equal = {str(name) for match in stated if isinstance(match, Mapping) for name in match.get("conditions") or ()}
    found: dict[str, dict[str, None]] = {}
    for session in sessions:
        for trial in session.header.get("plan") or []:
            compared = [p for p in trial.get("panels", ()) if p.get("role") == "candidate"]
            if len(compared) > 1 and not trial.get("practice") and not trial.get("catch"):
                loose = {str(p["condition"]): None for p in compared if str(p["condition"]) not in equal}
                found.setdefault(str(trial["block"]), {}).update(loose)
    return [(block, sorted(conditions)) for block, conditions in found.items() if conditions]


def _shown_clips(sessions: Sequence[Session]) -> dict[tuple[str, str], tuple[Mapping[str, Any], float]]:
    """(condition, scene) -> the cost of its first clip, and the rate it is shown at in Hz (nan: not stated)."""
    found: dict[tuple[str, str], tuple[Mapping[str, Any], float]] = {}
    for session in sessions:
        for trial in session.header.get("plan") or []:
            for panel in trial.get("panels", ()):
                clip = session.clips.get(panel.get("clip", ""))
                if clip is not None and clip.get("cost"):
                    rate_hz = float(panel.get("rate_hz") or session.header.get("refresh_hz") or np.nan)
                    found.setdefault((str(panel["condition"]), str(trial["scene"])), (clip["cost"], rate_hz))
    return found


def measured(cost: Mapping[str, Any], measure: str, rate_hz: float) -> float:
    """rays_per_s, samples_per_s (primary rays) or ms_on_machine of a clip's stored cost; nan where it lacks them."""
    frames = cost.get("frames") or []
    if measure == "ms_on_machine":
        seconds = [frame["seconds"]["total"] for frame in frames if "total" in (frame.get("seconds") or {})]
        return 1000.0 * float(np.median(seconds)) if seconds else float("nan")
    kinds = [frame["rays"] for frame in frames if frame.get("rays")]
    rays = [one.get("primary", 0) if measure == "samples_per_s" else sum(one.values()) for one in kinds]
    return float(np.mean(rays)) * rate_hz if rays else float("nan")


def _rows(
    match: Mapping[str, Any], shown: Mapping[tuple[str, str], tuple[Mapping[str, Any], float]]
) -> list[dict[str, Any]]:
    measure, to = str(match.get("cost") or match.get("quality")), match.get("to")
    tolerance = float(match.get("tolerance", 0.05))
    rows = []
    for condition in map(str, match.get("conditions") or ()):
        scenes = sorted({scene for name, scene in shown if name == condition})
        for scene in scenes if scenes and match.get("cost") else [None]:
            value = measured(*_cost_of(shown, condition, scene, measure)) if scene is not None else np.nan
            target = float(match["target"]) if match.get("target") is not None else np.nan
            if to is not None and scene is not None and (str(to), scene) in shown:
                target = measured(*_cost_of(shown, str(to), scene, measure))
            row = {"measure": measure, "condition": condition, "scene": scene, "value": value, "target": target}
            known = bool(np.isfinite(value) and np.isfinite(target) and target > 0)
            difference = value / target - 1.0 if known else np.nan
            row |= {"difference": difference, "tolerance": tolerance, "status": "ok", "note": ""}
            row["matched"] = ("yes" if abs(difference) <= tolerance else "no") if known else None
            if not known:
                why = "no shown clip carries its cost" if match.get("cost") else "sessions hold no pictures"
                found = [one for one in match.get("found") or () if one.get("condition") == condition]
                row |= {"status": "undefined", "note": f"{why}, and `studyapp match` has not measured it"}
                if found:
                    row |= {"value": found[0]["value"], "target": found[0]["target"], "scene": None, "status": "ok"}
                    row |= {"difference": found[0]["mismatch"], "matched": "yes" if found[0]["matched"] else "no"}
                    row["note"] = f"{why}: measured by `studyapp match`, mean over scenes"
            rows.append(row)
    return rows


def _cost_of(
    shown: Mapping[tuple[str, str], tuple[Mapping[str, Any], float]], condition: str, scene: str, measure: str
) -> tuple[Mapping[str, Any], str, float]:
    cost, rate_hz = shown[(condition, scene)]
    return cost, measure, rate_hz
