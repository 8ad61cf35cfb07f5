"""``studyapp export --csv``: plain files for any other program, a codebook, and an R script for the main tables."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from analysis.codebook import codebook
from analysis.exclusions import Exclusions, apply_exclusions, rules_of
from analysis.plan import likert_questions, plan_of, with_scenes, within_factors
from analysis.quality import key_mapping
from analysis.r_plan import planned_tests
from analysis.r_script import r_script
from analysis.sessions import Session, combine, group_text, read_sessions
from analysis.streams import read_flips, read_gaze, read_self_answers
from protocols.records import FLIP_DTYPE, GAZE_DTYPE, MAX_PANELS
from stimuli.errors import InputError, problem

FILES = ("trials.csv", "participants.csv", "flips.csv", "gaze.csv", "codebook.json", "analysis.R")


def export_csv(data: Iterable[str | Path], folder: Path, show_progress: bool = False) -> Path:
    """Write `FILES` into ``folder`` (gaze.csv and flips.csv with a header alone where none was recorded).

    Raises InputError where ``folder`` holds files that are not of such an export.
    """
    sessions = read_sessions(data)
    check_folder(folder, FILES)
    exclusions = apply_exclusions(combine(sessions), rules_of(sessions), sessions)
    folder.mkdir(parents=True, exist_ok=True)
    trials = exclusions.table
    trials.to_csv(folder / "trials.csv", index=False, lineterminator="\n")
    people = participants_table(sessions, exclusions)
    people.to_csv(folder / "participants.csv", index=False, lineterminator="\n")
    _write_streams(sessions, folder, show_progress)
    tables = {"trials.csv": list(trials.columns), "participants.csv": list(people.columns)}
    tables |= {"flips.csv": flip_columns(), "gaze.csv": gaze_columns()}
    questions = likert_questions(sessions)
    described = codebook(tables, questions, sessions)
    (folder / "codebook.json").write_text(json.dumps(described, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    kept = exclusions.kept
    plan = with_scenes(plan_of(sessions, kept), kept)
    planned = planned_tests(plan, kept) if plan.stated and len(kept) else ""
    chosen = bool(trials["winner"].notna().any())
    script = r_script(sessions, questions, within_factors(kept, sessions), chosen, planned)
    (folder / "analysis.R").write_text(script, encoding="utf-8")
    return folder


def check_folder(folder: Path, own: Sequence[str]) -> None:
    """Raise InputError where ``folder`` is a file, or holds anything that is not among ``own``."""
    if folder.exists() and not folder.is_dir():
        raise InputError(problem(folder, "export folder", "a file", "a new folder"))
    foreign = sorted(path.name for path in folder.iterdir() if path.name not in own) if folder.is_dir() else []
    if foreign:
        raise InputError(problem(folder, "export folder", f"other files ({foreign[0]})", "an empty or a new folder"))


def participants_table(sessions: Sequence[Session], exclusions: Exclusions) -> pd.DataFrame:
    """One row a participant: codes, group, key mapping, counts, exclusion, what they said about themselves."""
    rows: dict[str, dict[str, Any]] = {}
    for session in sessions:
        row = rows.setdefault(session.participant, {"participant": session.participant})
        row["observer_kind"] = session.observer_kind
        row["observer"] = session.header.get("observer")
        row["group"] = group_text(session.header)
        row["keys"] = key_mapping(session)
        row["slot"] = session.slot
        row["sessions"] = int(row.get("sessions", 0)) + 1
        row.setdefault("started_utc", session.header.get("started_utc"))
        row |= {f"self_{name}": value for name, value in read_self_answers(session).items()}
    counts = exclusions.participants
    return pd.DataFrame(list(rows.values())).merge(counts, on="participant", how="left")


def flip_columns() -> list[str]:
    """Columns of flips.csv: who and which trial, then the record's fields, the panels' sources as columns."""
    names = [name for name in FLIP_DTYPE.names or () if name != "source"]
    return ["participant", "run", "trial", *names, *[f"source_{i}" for i in range(MAX_PANELS)]]


def gaze_columns() -> list[str]:
    """Columns of gaze.csv: who and which device, then the record's fields."""
    return ["participant", "run", "device", *(GAZE_DTYPE.names or ())]


def _columns_of(record: np.ndarray, leading: dict[str, Any]) -> pd.DataFrame:
    """A packed record as a table, with constant columns in front."""
    fields = {name: record[name] for name in record.dtype.names or () if name != "source"}
    if "source" in (record.dtype.names or ()):
        fields |= {f"source_{i}": record["source"][:, i] for i in range(MAX_PANELS)}
    return pd.DataFrame({**{key: np.full(len(record), value) for key, value in leading.items()}, **fields})


def _write_streams(sessions: Sequence[Session], folder: Path, show_progress: bool) -> None:
    flips_path, gaze_path = folder / "flips.csv", folder / "gaze.csv"
    flips_path.write_text(",".join(flip_columns()) + "\n", encoding="utf-8")
    gaze_path.write_text(",".join(gaze_columns()) + "\n", encoding="utf-8")
    for session in tqdm(sessions, desc="streams", disable=None if show_progress else True, leave=False):
        who = {"participant": session.participant, "run": session.header.get("run", 1)}
        tables = [_columns_of(record, {**who, "trial": trial}) for trial, record in read_flips(session).items()]
        if tables:
            whole = pd.concat(tables, ignore_index=True)[flip_columns()]
            whole.to_csv(flips_path, mode="a", header=False, index=False, lineterminator="\n")
        for device, samples in read_gaze(session).items():
            table = _columns_of(samples, {**who, "device": device})[gaze_columns()]
            table.to_csv(gaze_path, mode="a", header=False, index=False, lineterminator="\n")
