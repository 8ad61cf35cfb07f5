"""Our own check of a BIDS eye-tracking data set: what the validator (3.0.2) does not notice.

It lets a missing ScreenSize pass, and does not compare columns with their description or with each other.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stimuli.errors import problem

SCREEN_FIELDS: dict[str, int] = {"ScreenDistance": 1, "ScreenOrigin": 2, "ScreenResolution": 2, "ScreenSize": 2}
_PHYSIO_KEYS = (
    "SamplingFrequency",
    "StartTime",
    "Columns",
    "PhysioType",
    "RecordedEye",
    "SampleCoordinateSystem",
)
_FIRST = ["timestamp", "x_coordinate", "y_coordinate"]


def check_bids(folder: Path) -> list[str]:
    """Every fault found in the data set's eye-tracking files, one line each; empty where there is none."""
    found: list[str] = []
    for path in sorted(folder.glob("sub-*/**/*_physio.tsv.gz")):
        found += _check_physio(path)
    for path in sorted(folder.glob("sub-*/**/*_physioevents.tsv.gz")):
        found += _check_physio_events(path)
    return found


def _sidecar(path: Path) -> dict[str, Any]:
    beside = Path(str(path).removesuffix(".tsv.gz") + ".json")
    return json.loads(beside.read_text(encoding="utf-8")) if beside.is_file() else {}


def _check_physio(path: Path) -> list[str]:
    sidecar = _sidecar(path)
    found = [problem(path.name, key, "nothing", "a value in the sidecar") for key in _PHYSIO_KEYS if key not in sidecar]
    columns = list(sidecar.get("Columns", []))
    if columns[:3] != _FIRST:
        found.append(problem(path.name, "Columns", columns[:3], _FIRST))
    for axis in ("x_coordinate", "y_coordinate"):
        if not (sidecar.get(axis) or {}).get("Units"):
            found.append(problem(path.name, f"{axis}.Units", "nothing", "a unit"))
    pupil = str((sidecar.get("pupil_size") or {}).get("Description", ""))
    if "pupil_size" in columns and not ("diameter" in pupil or "area" in pupil):
        found.append(problem(path.name, "pupil_size.Description", repr(pupil), "the word area or diameter"))
    if sidecar.get("SampleCoordinateSystem") == "gaze-on-screen":
        found += _check_screen(path)
    return found + _check_rows(path, columns)


def _check_screen(path: Path) -> list[str]:
    """gaze-on-screen requires the screen's geometry in the sidecar of the events of the same run."""
    stem = path.name.partition("_recording-")[0]
    events = path.with_name(f"{stem}_events.json")
    if not events.is_file():
        return [problem(path.name, "events sidecar", "none", events.name)]
    stated: Mapping[str, Any] = json.loads(events.read_text(encoding="utf-8")).get("StimulusPresentation") or {}
    found = []
    for field, length in SCREEN_FIELDS.items():
        value = stated.get(field)
        given = len(value) if isinstance(value, list) else 1
        numbers = value if isinstance(value, list) else [value]
        bad = field != "ScreenOrigin" and not all(isinstance(one, int | float) and one > 0 for one in numbers)
        if value is None or given != length or bad:
            found.append(problem(events.name, f"StimulusPresentation.{field}", value, f"{length} value(s), all known"))
    return found


def _check_rows(path: Path, columns: list[str]) -> list[str]:
    """No header line, the stated number of columns, rising time stamps."""
    last = float("-inf")
    with gzip.open(path, "rt", encoding="utf-8") as file:
        for number, line in enumerate(file, start=1):
            cells = line.rstrip("\n").split("\t")
            where = f"{path.name}:{number}"
            if len(cells) != len(columns):
                return [problem(where, "columns", len(cells), f"{len(columns)}, as the sidecar says")]
            try:
                stamp = float(cells[0])
            except ValueError:
                return [problem(where, columns[0], cells[0], "a number (there is no header line)")]
            if stamp < last:
                return [problem(where, columns[0], stamp, f"no less than {last}")]
            last = stamp
    return []


def _check_physio_events(path: Path) -> list[str]:
    sidecar = _sidecar(path)
    columns = list(sidecar.get("Columns", []))
    found = []
    if columns[:1] != ["onset"]:
        found.append(problem(path.name, "Columns", columns[:1], ["onset"]))
    physio = Path(str(path).replace("_physioevents.tsv.gz", "_physio.tsv.gz"))
    known = _sidecar(physio).get("Columns", [])
    if sidecar.get("OnsetSource") not in known:
        found.append(problem(path.name, "OnsetSource", sidecar.get("OnsetSource"), f"one of {', '.join(known)}"))
    return found + _check_rows(path, columns)
