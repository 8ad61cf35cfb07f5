"""``studyapp export --bids``: a BIDS 1.11 data set, eye tracking as physio (PR 1128), behaviour as events.

Times are seconds from the session's start. Gaze is written in pixels of the screen (origin top left) where the session
states the screen's size, distance and resolution; otherwise in degrees, with the coordinate system named 'custom'.
"""

from __future__ import annotations

import gzip
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from analysis.bids_check import check_bids
from analysis.exclusions import apply_exclusions, rules_of
from analysis.gaze import validated_accuracy_dva
from analysis.protocol_facts import lab_of, screen_of, title_of
from analysis.sessions import Session, combine, group_text, read_sessions
from analysis.streams import read_gaze, read_self_answers
from stimuli.errors import InputError, problem

BIDS_VERSION = "1.11.0"
_EYES = {0: "cyclopean", 1: "left", 2: "right"}
_TOP = ("dataset_description.json", "README.md", "participants.tsv", "participants.json")


def export_bids(data: Iterable[str | Path], folder: Path, show_progress: bool = False) -> Path:
    """Write the data set and check it (`bids_check.check_bids`); returns ``folder``.

    Raises InputError where ``folder`` holds other files, or two participants' codes become the same BIDS label.
    """
    sessions = read_sessions(data)
    _check_folder(folder)
    labels = bids_labels([session.participant for session in sessions])
    table = apply_exclusions(combine(sessions), rules_of(sessions), sessions).table
    folder.mkdir(parents=True, exist_ok=True)
    simulated = sessions[0].observer_kind == "simulated"
    title = title_of(sessions)
    _json(folder / "dataset_description.json", _description(title, simulated))
    (folder / "README.md").write_text(_readme(title, simulated), encoding="utf-8")
    _participants(folder, sessions, labels)
    for session in tqdm(sessions, desc="BIDS", disable=None if show_progress else True, leave=False):
        own = table[(table["participant"] == session.participant) & (table["session"] == session.path.stem)]
        _write_session(folder, session, labels[session.participant], own)
    found = check_bids(folder)
    if found:
        raise InputError(*found)
    return folder


def _check_folder(folder: Path) -> None:
    """An earlier export (known names, sub-*) may be written over; anything else is left alone."""
    if folder.exists() and not folder.is_dir():
        raise InputError(problem(folder, "export folder", "a file", "a new folder"))
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.name not in _TOP and not re.fullmatch(r"sub-[A-Za-z0-9]+", path.name):
            raise InputError(problem(folder, "export folder", f"other files ({path.name})", "an empty or a new folder"))


def bids_labels(codes: Sequence[str]) -> dict[str, str]:
    """participant code -> BIDS label (letters and digits only; numbers padded to two digits)."""
    labels: dict[str, str] = {}
    for code in dict.fromkeys(codes):
        label = re.sub(r"[^A-Za-z0-9]", "", code)
        labels[code] = label.zfill(2) if label.isdigit() else label
    for code, label in labels.items():
        others = [other for other, same in labels.items() if same == label and other != code]
        if not label or others:
            wanted = "codes that stay different without punctuation"
            raise InputError(problem("participants", "BIDS label", f"{label!r} for {[code, *others]}", wanted))
    return labels


def _description(title: str, simulated: bool) -> dict[str, Any]:
    return {
        "Name": ("SIMULATED: " if simulated else "") + title,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "studyapp export --bids", "Description": "from session files"}],
    }


def _readme(title: str, simulated: bool) -> str:
    lines = [f"# {title}", ""]
    if simulated:
        lines += ["SIMULATED: no person gave these answers. They come from a model of an observer.", ""]
    lines += [
        "Written by `studyapp export --bids` from session files. Behaviour stands in `*_events.tsv` (one row a trial),",
        "eye tracking in `*_physio.tsv.gz` (one file an eye). Times are seconds from the session's start.",
        "",
    ]
    return "\n".join(lines)


def _json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def _tsv(table: pd.DataFrame) -> str:
    text = io.StringIO()
    table.to_csv(text, sep="\t", index=False, na_rep="n/a", lineterminator="\n")
    return text.getvalue()


def _participants(folder: Path, sessions: Sequence[Session], labels: Mapping[str, str]) -> None:
    rows: dict[str, dict[str, Any]] = {}
    for session in sessions:
        row = {"participant_id": f"sub-{labels[session.participant]}", "observer_kind": session.observer_kind}
        row["group"] = group_text(session.header) or "n/a"
        row |= {name: value if str(value) else "n/a" for name, value in read_self_answers(session).items()}
        rows.setdefault(session.participant, {}).update(row)
    table = pd.DataFrame(list(rows.values()))
    (folder / "participants.tsv").write_text(_tsv(table), encoding="utf-8")
    said: dict[str, dict[str, Any]] = {
        name: {"Description": f"what the participant said: {name}"} for name in table.columns
    }
    said["participant_id"] = {"Description": "participant's code"}
    kinds = {"person": "a person", "simulated": "a model of an observer"}
    said["observer_kind"] = {"Description": "who answered", "Levels": kinds}
    said["group"] = {"Description": "between-participants group of the design"}
    _json(folder / "participants.json", said)


def _task(session: Session) -> str:
    return re.sub(r"[^A-Za-z0-9]", "", str(session.header.get("study") or "study")) or "study"


def _write_session(folder: Path, session: Session, label: str, trials: pd.DataFrame) -> None:
    beh = folder / f"sub-{label}" / "beh"
    beh.mkdir(parents=True, exist_ok=True)
    run = re.sub(r"[^0-9]", "", str(session.header.get("run", 1))) or "1"
    stem = f"sub-{label}_task-{_task(session)}_run-{run}"
    events = events_table(trials)
    (beh / f"{stem}_events.tsv").write_text(_tsv(events), encoding="utf-8")
    screen = screen_of(session)
    _json(beh / f"{stem}_events.json", _events_sidecar(session, screen, list(events.columns)))
    for device, samples in sorted(read_gaze(session).items()):
        for eye in sorted({int(one) for one in np.unique(samples["eye"])}):
            recording = f"eye{eye}" if eye else "eye3" if np.any(samples["eye"] > 0) else "eye1"
            own = np.sort(samples[samples["eye"] == eye], order="mapped_ns", kind="stable")
            name = f"{stem}_recording-{recording}"
            physio, sidecar = physio_table(own, screen), _physio_sidecar(session, own, screen, device, eye)
            _write_physio(beh, name, physio, sidecar)
            _write_physio_events(beh, name, trials)


def events_table(trials: pd.DataFrame) -> pd.DataFrame:
    """onset, duration (s), trial_type, then the trial's own columns; trials without a stimulus are left out."""
    shown = trials[~trials["kind"].isin(["instructions", "consent", "break"])]
    table = pd.DataFrame({"onset": shown["onset_s"].astype(float), "duration": shown["duration_s"].astype(float)})
    table["trial_type"] = shown["kind"]
    for column in (
        "block",
        "scene",
        "condition",
        "technique",
        "side",
        "response",
        "rating",
        "rt_s",
        "missed",
        "status",
    ):
        name = {"rt_s": "response_time"}.get(column, column)
        table[name] = shown[column]
    table["excluded"] = shown["excluded"].map({True: "true", False: "false"})
    table["reason"] = shown["reason"]
    for column in shown.columns:
        if column.startswith(("rating_", "response_")) and shown[column].notna().any():
            table[column] = shown[column]
    table = table.sort_values("onset", kind="stable").reset_index(drop=True)
    # a tab or a line end would break the table; an empty cell is n/a
    text = [name for name in table.columns if not pd.api.types.is_numeric_dtype(table[name])]
    for name in text:
        clean = table[name].map(lambda value: re.sub(r"\s+", " ", str(value)).strip() if pd.notna(value) else None)
        table[name] = clean.where(clean.astype(bool), None).astype(object)
    return table


_EVENT_COLUMNS: dict[str, dict[str, str]] = {
    "block": {"Description": "block of the protocol"},
    "scene": {"Description": "scene shown"},
    "condition": {"Description": "condition shown; candidates joined by | in a comparison"},
    "technique": {"Description": "rendering technique shown"},
    "side": {"Description": "slot that was chosen"},
    "response": {"Description": "condition chosen, or rating"},
    "rating": {"Description": "first Likert answer"},
    "response_time": {"Description": "from stimulus onset to the answer", "Units": "s"},
    "missed": {"Description": "refreshes missed"},
    "status": {"Description": "ok, timing_failed, device_lost or aborted"},
    "excluded": {"Description": "left out of the study's analysis"},
    "reason": {"Description": "why it was left out"},
}


def _events_sidecar(session: Session, screen: Mapping[str, Any], columns: Sequence[str]) -> dict[str, Any]:
    presentation: dict[str, Any] = {"SoftwareName": "studyapp"}
    version = (session.header.get("software") or {}).get("studyapp")
    if version:
        presentation["SoftwareVersion"] = str(version)
    if complete_screen(screen):
        presentation |= {
            "ScreenDistance": float(screen["distance_m"]),
            "ScreenOrigin": ["top", "left"],
            "ScreenResolution": [int(screen["size_px"][0]), int(screen["size_px"][1])],
            "ScreenSize": [float(screen["width_m"]), float(screen["height_m"])],
        }
    rate = session.header.get("refresh_hz")
    if rate is not None:
        presentation["ScreenRefreshRate"] = float(Fraction(str(rate)))
    sidecar: dict[str, Any] = {"TaskName": _task(session), "StimulusPresentation": presentation}
    for name in columns:
        if name in _EVENT_COLUMNS:
            sidecar[name] = _EVENT_COLUMNS[name]
        elif name.startswith(("rating_", "response_")):
            sidecar[name] = {"Description": f"answer to the question {name.partition('_')[2]}"}
    return sidecar


def complete_screen(screen: Mapping[str, Any]) -> bool:
    """True where gaze can be written in pixels: size, distance and resolution are all known."""
    return {"size_px", "width_m", "height_m", "distance_m"} <= screen.keys()


def physio_table(samples: np.ndarray, screen: Mapping[str, Any]) -> pd.DataFrame:
    """timestamp (s), x_coordinate, y_coordinate, pupil_size; coordinates are nan where the eye was not seen.

    With a known screen: pixels from its top left corner, by x = cx + d tan(azimuth) / pitch, and y likewise along the
    line of sight; else degrees right and down of the screen's centre.
    """
    x, y = samples["x_dva"].astype(float), samples["y_dva"].astype(float)
    if complete_screen(screen):
        width, height = screen["size_px"]
        azimuth, elevation = np.radians(x), np.radians(y)
        with np.errstate(invalid="ignore", divide="ignore"):
            right_m = screen["distance_m"] * np.tan(azimuth)
            up_m = screen["distance_m"] * np.tan(elevation) / np.cos(azimuth)
        x = width / 2 + right_m * width / screen["width_m"]
        y = height / 2 - up_m * height / screen["height_m"]
    else:
        y = -y
    seen = (samples["valid"] > 0) & np.isfinite(x) & np.isfinite(y)
    pupil = samples["pupil_mm"].astype(float)
    return pd.DataFrame(
        {
            "timestamp": np.round(samples["mapped_ns"] * 1e-9, 6),
            "x_coordinate": np.where(seen, np.round(x, 3), np.nan),
            "y_coordinate": np.where(seen, np.round(y, 3), np.nan),
            "pupil_size": np.where(seen & (pupil > 0), np.round(pupil, 4), np.nan),
        }
    )


def _physio_sidecar(
    session: Session, samples: np.ndarray, screen: Mapping[str, Any], device: str, eye: int
) -> dict[str, Any]:
    steps = np.diff(samples["mapped_ns"])
    steps = steps[steps > 0]
    known = complete_screen(screen)
    units = "pixel" if known else "deg"
    where = "the screen's left edge" if known else "the screen's centre"
    below = "the screen's top edge" if known else "the screen's centre"
    sidecar: dict[str, Any] = {
        "TaskName": _task(session),
        "PhysioType": "eyetrack",
        "SamplingFrequency": round(1e9 / float(np.median(steps)), 4) if steps.size else 0.0,
        "StartTime": round(float(samples["mapped_ns"][0]) * 1e-9, 6) if len(samples) else 0.0,
        "Columns": ["timestamp", "x_coordinate", "y_coordinate", "pupil_size"],
        "RecordedEye": _EYES[eye],
        "SampleCoordinateSystem": "gaze-on-screen" if known else "custom",
        "timestamp": {
            "Description": "device stamp mapped to the session's clock",
            "Units": "s",
            "Origin": "session start",
        },
        "x_coordinate": {"Description": f"gaze to the right of {where}", "Units": units},
        "y_coordinate": {"Description": f"gaze down from {below}", "Units": units},
        "pupil_size": {"Description": "pupil diameter", "Units": "mm"},
        "Manufacturer": device,
    }
    if not known:
        text = "Azimuth and elevation of gaze as seen from the eye, origin at the screen's centre, y down, in degrees."
        sidecar["SampleCoordinateSystemDescription"] = text
    error_dva = validated_accuracy_dva(session)
    if np.isfinite(error_dva):
        sidecar["AverageCalibrationError"] = round(error_dva, 4)
    if known:
        sidecar["EyeTrackerDistance"] = float(screen["distance_m"])
    tracker = lab_of(session).get("eye_tracker")
    if isinstance(tracker, Mapping):
        for key, name in (("manufacturer", "Manufacturer"), ("model", "ManufacturersModelName")):
            if tracker.get(key):
                sidecar[name] = str(tracker[key])
    return sidecar


def _write_physio(folder: Path, name: str, table: pd.DataFrame, sidecar: Mapping[str, Any]) -> None:
    """The gzipped table without a header line (its names are the sidecar's Columns), and the sidecar."""
    text = table.to_csv(None, sep="\t", index=False, header=False, na_rep="n/a", lineterminator="\n")
    _gzip(folder / f"{name}_physio.tsv.gz", text)
    _json(folder / f"{name}_physio.json", sidecar)


def _write_physio_events(folder: Path, name: str, trials: pd.DataFrame) -> None:
    """Trial onsets on the tracker's own time line, as messages; OnsetSource is the timestamp column."""
    shown = trials[~trials["kind"].isin(["instructions", "consent", "break"])].sort_values("onset_s", kind="stable")
    table = pd.DataFrame(
        {
            "onset": shown["onset_s"].astype(float).round(6),
            "duration": shown["duration_s"].astype(float).round(6),
            "trial_type": "n/a",
            "message": [f"trial {trial}" for trial in shown["trial"]],
        }
    )
    text = table.to_csv(None, sep="\t", index=False, header=False, na_rep="n/a", lineterminator="\n")
    _gzip(folder / f"{name}_physioevents.tsv.gz", text)
    sidecar: dict[str, Any] = {
        "Columns": list(table.columns),
        "OnsetSource": "timestamp",
        "Description": "stimulus onsets on the time line of the recording",
    }
    _json(folder / f"{name}_physioevents.json", sidecar)


def _gzip(path: Path, text: str) -> None:
    """Gzip without name or time, so that the same session gives the same bytes."""
    with open(path, "wb") as file, gzip.GzipFile("", "wb", 6, file, 0) as packed:
        packed.write(text.encode())
