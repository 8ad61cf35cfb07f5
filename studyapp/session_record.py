"""What a session's file holds beside its trials: consent, fixation, how it began and how it went on."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from protocols.conditions import Gaze
from protocols.study import Study
from protocols.trial import Trial
from studyapp import clock
from studyapp.session_header import sha256_text
from studyapp.session_log import SessionLog
from studyapp.trial import TrialRunner

Happened = tuple[str, str, Mapping[str, Any] | None]
"""Device, kind and record of an event; None: it did not happen."""


def begin_record(log: SessionLog, about: Mapping[str, str], events: Sequence[Happened], notes: Sequence[str]) -> None:
    """What goes into the file before trial 1, or before the first trial after an interruption."""
    for name, value in about.items():
        log.about_self(name, value)
    for device, kind, record in events:
        if record is not None:
            log.event(device, kind, json.dumps(record))
    for note in notes:
        log.note(note)


def consent_record(study: Study, trial: Trial, text: str) -> dict[str, Any]:
    """What was agreed to and when: the words' hash, the protocol's hash as their version, the time."""
    return {
        "text_sha256": sha256_text(trial.text), "version": sha256_text(text)[:12], "utc": clock.wall_clock_utc(),
        "study": study.study,
    }  # fmt: skip


def fixation_record(limits: Gaze, trial: Trial, number: int, runner: TrialRunner) -> dict[str, Any]:
    """What the session keeps of a trial's gaze, JSON-ready; ``flagged``: fixated, and gaze strayed or drifted."""
    seen, drift = runner.fixation, runner.drift
    assert seen is not None
    strayed = not seen.worst_deg <= limits.fixation_limit_deg
    drifted = drift is not None and not drift.within(limits.drift_deg)
    record = {
        "trial": number, "outside": seen.outside, "worst_deg": seen.worst_deg, "loss": seen.loss, "samples": seen.n,
        "drift_deg": None if drift is None else drift.size_deg,
        "flagged": trial.fixation == "fixed" and (strayed or drifted),
    }  # fmt: skip
    return {key: None if isinstance(value, float) and value != value else value for key, value in record.items()}
