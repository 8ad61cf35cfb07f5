"""Blind analysis: condition names become codes before anybody sees exclusions, timing or gaze."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from analysis.sessions import Session


def condition_codes(sessions: Sequence[Session]) -> dict[str, str]:
    """condition -> code (C1, C2 ...), in an order that the names do not give away (sorted by a hash with the seed)."""
    names = {
        panel["condition"]
        for session in sessions
        for trial in session.header.get("plan") or []
        for panel in trial.get("panels", ())
    }
    seed = min((str(session.header.get("protocol_sha256", "")) for session in sessions), default="")
    shuffled = sorted(names, key=lambda name: hashlib.sha256(f"blind {seed} {name}".encode()).hexdigest())
    return {name: f"C{place}" for place, name in enumerate(shuffled, start=1)}


def _coded(value: Any, codes: Mapping[str, str]) -> Any:
    """A condition, or conditions joined by '|', in codes; anything else unchanged."""
    if not isinstance(value, str):
        return value
    parts = value.split("|")
    return "|".join(sorted(codes[part] for part in parts)) if all(part in codes for part in parts) else value


def code_conditions(sessions: Sequence[Session]) -> list[Session]:
    """The same sessions with every condition name replaced by its code; techniques and parameters are taken out."""
    codes = condition_codes(sessions)
    return [_code_session(session, codes) for session in sessions]


def _code_session(session: Session, codes: Mapping[str, str]) -> Session:
    plan = copy.deepcopy(list(session.header.get("plan") or []))
    for trial in plan:
        for panel in trial.get("panels", ()):
            panel.update(condition=codes[panel["condition"]], technique="hidden", params={})
        trial["factors"] = {name: _coded(level, codes) for name, level in trial.get("factors", {}).items()}
    trials = session.trials.copy()
    for column in trials.columns:
        if trials[column].dtype == object or pd.api.types.is_string_dtype(trials[column]):
            trials[column] = trials[column].map(lambda value: _coded(value, codes))
    trials["technique"] = "hidden"
    header = {**session.header, "plan": plan, "conditions": {}}
    return replace(session, header=header, trials=trials)
