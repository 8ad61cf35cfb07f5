"""What every exported column means, in which unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from analysis.sessions import Session

_MEANINGS: dict[str, tuple[str, str]] = {
    "participant": ("code of the participant", ""),
    "slot": ("slot of the design: order, sides, keys and group", ""),
    "run": ("number of the session of this participant", ""),
    "group": ("between-participants group of the design", ""),
    "session": ("name of the session file", ""),
    "observer_kind": ("who answered: person or simulated", ""),
    "observer": ("answering device, or model of a simulated observer", ""),
    "study": ("name of the study", ""),
    "trial": ("running number of the presentation in the session", ""),
    "planned": ("index of the trial in the participant's plan", ""),
    "attempt": ("0 first presentation, 1 and more: shown again", ""),
    "block": ("block of the protocol", ""),
    "kind": ("kind of trial", ""),
    "scene": ("scene, by the study's name", ""),
    "practice": ("practice trial, never analysed", ""),
    "catch": ("catch trial with a known answer, never analysed", ""),
    "correct": ("right answer of a catch trial", ""),
    "technique": ("technique shown; candidates joined by | in a comparison", ""),
    "condition": ("condition shown; candidates joined by | in a comparison", ""),
    "side": ("slot that was chosen", ""),
    "response": ("condition chosen, or rating as text (first question)", ""),
    "winner": ("condition chosen, where two were compared", ""),
    "loser": ("condition not chosen, where two were compared", ""),
    "rating": ("first Likert answer", "scale points"),
    "rt_s": ("response time from stimulus onset (first question)", "s"),
    "timed_out": ("no answer in time", ""),
    "refreshes": ("refreshes shown", ""),
    "missed": ("refreshes missed", ""),
    "replays": ("times the participant had it replayed", ""),
    "status": ("ok, timing_failed, device_lost or aborted", ""),
    "onset_s": ("stimulus onset, from the session's start", "s"),
    "duration_s": ("onset to offset", "s"),
    "excluded": ("left out of the analysis", ""),
    "reason": ("why it was left out", ""),
    "keys": ("key mapping, key=answer", ""),
    "sessions": ("session files", ""),
    "started_utc": ("when the first session began", "UTC"),
    "trials": ("presentations with pictures", ""),
    "analysed": ("presentations analysed", ""),
    "left_out": ("presentations left out", ""),
    "refresh": ("index on the display's refresh grid", ""),
    "due_ns": ("when the grid says it should be shown", "ns of the session"),
    "submitted_ns": ("swap requested", "ns of the session"),
    "shown_ns": ("stamp of the display's own class", "ns of the session"),
    "flags": ("bits: 1 early, 2 phase slip, 4 light patch, 8 onset, 16 offset", ""),
    "upload_ns": ("time taken by the upload", "ns"),
    "draw_ns": ("time taken by drawing", "ns"),
    "gaze_age_ns": ("age of the newest gaze sample at submission, -1 none", "ns"),
    "device": ("name of the eye tracker", ""),
    "device_s": ("the device's own stamp", "s"),
    "host_ns": ("when the sample arrived", "ns of the session"),
    "mapped_ns": ("device stamp through the clock model", "ns of the session"),
    "x_dva": ("gaze to the right of the screen's centre", "deg"),
    "y_dva": ("gaze up from the screen's centre", "deg"),
    "pupil_mm": ("pupil diameter", "mm"),
    "valid": ("1: the tracker saw the eye", ""),
    "eye": ("0 both, 1 left, 2 right", ""),
}
_PREFIXES: tuple[tuple[str, str, str], ...] = (
    ("slot_", "condition at the slot {}", ""),
    ("source_", "frame of panel {}'s clip on the screen, -1 none", ""),
    ("self_", "what the participant said: {}", ""),
    ("response_", "answer to the question {}", ""),
    ("rt_s_", "response time to the question {}, from stimulus onset", "s"),
    ("factor_", "level of the design's factor {}", ""),
)


def codebook(
    tables: Mapping[str, Sequence[str]], questions: Mapping[str, Mapping[str, Any]], sessions: Sequence[Session]
) -> dict[str, Any]:
    """file -> column -> {description, unit, levels}; every column of ``tables`` is described."""
    files = {name: {column: _meaning(column, questions) for column in columns} for name, columns in tables.items()}
    return {
        "study": sessions[0].header.get("study"),
        "observer_kind": sessions[0].observer_kind,
        "missing": "an empty cell",
        "files": files,
    }


def _meaning(column: str, questions: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    if column in _MEANINGS:
        description, unit = _MEANINGS[column]
        return {"description": description, "unit": unit}
    if column.startswith("rating_"):
        question = questions.get(column.removeprefix("rating_"), {})
        levels = {str(k): v for k, v in (question.get("labels") or {}).items()}
        text = f"rating: {question.get('text', column.removeprefix('rating_'))}"
        entry = {"description": text, "unit": "scale points", "low": question.get("low"), "high": question.get("high")}
        return {**entry, "levels": levels}
    for prefix, text, unit in _PREFIXES:
        if column.startswith(prefix):
            return {"description": text.format(column.removeprefix(prefix)), "unit": unit}
    return {"description": f"level of the design's factor {column}", "unit": ""}
