"""Session files to tables: one row a trial (the streams beside it: `analysis.streams`).

The contract is `protocols.records`. Nothing here decides what is left out: `analysis.exclusions` does, and its verdict
stands in the columns ``excluded`` and ``reason``.
"""

from __future__ import annotations

import json
import re
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from protocols.records import SCHEMA_VERSION, has_table
from stimuli.errors import InputError, problem

TRIAL_COLUMNS = [
    "participant",
    "run",
    "group",
    "session",
    "observer_kind",
    "study",
    "trial",
    "planned",
    "attempt",
    "block",
    "kind",
    "scene",
    "practice",
    "catch",
    "correct",
    "technique",
    "condition",
    "side",
    "response",
    "winner",
    "loser",
    "rating",
    "rt_s",
    "timed_out",
    "refreshes",
    "missed",
    "replays",
    "status",
    "onset_s",
    "duration_s",
    "excluded",
    "reason",
]
"""Columns of `load_sessions` that every table has; then the design's factors and ``rating_Q``, ``response_Q``,
``rt_s_Q`` for every question Q."""

_FACTORS_THAT_WIN = ("scene", "technique", "condition")  # a design's own level names stand over file names


@dataclass(frozen=True)
class Session:
    """One session file. ``header``: its key-value table; ``trials``: one row a presentation with the answers beside it.

    Streams are read when asked for (`analysis.streams`), since they are large.
    """

    path: Path
    header: Mapping[str, Any]
    trials: pd.DataFrame
    clips: Mapping[str, Mapping[str, Any]]

    @property
    def participant(self) -> str:
        """The participant's code."""
        return str(self.header["participant"])

    @property
    def slot(self) -> int:
        """The slot of the design that the participant sat in; older files know only the participant."""
        found = self.header.get("slot", self.participant)
        return int(found) if str(found).isdigit() else 0

    @property
    def observer_kind(self) -> str:
        """'person' or 'simulated'."""
        return str(self.header["observer_kind"])


def session_paths(data: Iterable[str | Path]) -> list[Path]:
    """Session files among ``data``: files as they are, folders by their ``*.sqlite``, in the order of their names.

    Raises InputError where a path does not exist or a folder holds no session.
    """
    found: list[Path] = []
    problems: list[str] = []
    for entry in map(Path, data):
        if entry.is_dir():
            inside = sorted(entry.glob("*.sqlite"), key=_natural)
            found += inside
            if not inside:
                problems.append(problem(entry, "no session file", "a folder without *.sqlite", "session files"))
        elif entry.is_file():
            found.append(entry)
        else:
            problems.append(problem(entry, "no such file", "nothing", "a session file or a folder of them"))
    if problems:
        raise InputError(*problems)
    if not found:
        raise InputError(problem("sessions", "no data", "no path", "session files or folders of them"))
    return list(dict.fromkeys(found))


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort key by which p2 comes before p10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def group_text(header: Mapping[str, Any]) -> str | None:
    """The participant's between-participants group in words ('factor=level'); None where the design has none."""
    group = header.get("group")
    if isinstance(group, Mapping):
        return " ".join(f"{name}={level}" for name, level in sorted(group.items())) or None
    return str(group) if group else None


def connect(path: Path) -> sqlite3.Connection:
    """A read-only connection; ``immutable`` where the folder is read-only too and no journal is pending."""
    address = path.resolve().as_uri()
    pending = path.with_name(path.name + "-wal")
    mode = "mode=ro" if pending.exists() else "mode=ro&immutable=1"
    return sqlite3.connect(f"{address}?{mode}", uri=True)


def _read_header(connection: sqlite3.Connection, path: Path) -> dict[str, Any]:
    if not has_table(connection, "header"):
        raise InputError(problem(path, "not a session file", "a database without a header", "a studyapp session"))
    header = {key: json.loads(value) for key, value in connection.execute("SELECT key, value FROM header")}
    version = header.get("schema_version")
    if version != SCHEMA_VERSION:
        raise InputError(problem(path, "schema_version", version, SCHEMA_VERSION))
    for key in ("participant", "observer_kind"):
        if key not in header:
            raise InputError(problem(path, "header", f"no {key}", f"the key {key}"))
    if header["observer_kind"] not in ("person", "simulated"):
        raise InputError(problem(path, "observer_kind", repr(header["observer_kind"]), "person | simulated"))
    return header


def read_session(path: str | Path) -> Session:
    """Read one session file without its streams. Raises InputError where it is not one, or is damaged."""
    path = Path(path)
    if not path.is_file():
        raise InputError(problem(path, "no such file", "nothing", "a session file"))
    try:
        connection = connect(path)
        try:
            header = _read_header(connection, path)
            trials = read_rows(connection, "trials")
            responses = read_rows(connection, "responses")
            clips = {row["clip"]: _clip(row) for row in read_rows(connection, "clips")}
        finally:
            connection.close()
    except sqlite3.DatabaseError as error:
        raise InputError(problem(path, "not a readable session file", str(error), "an SQLite session")) from error
    return Session(path, header, _trial_table(path, header, trials, responses), clips)


def read_rows(connection: sqlite3.Connection, table: str) -> list[dict[str, Any]]:
    """The rows of a table of the file, in the order of its first column; none where the file has no such table."""
    if not has_table(connection, table):
        return []
    cursor = connection.execute(f"SELECT * FROM {table} ORDER BY 1")
    names = [column[0] for column in cursor.description]
    return [dict(zip(names, row, strict=True)) for row in cursor]


def _clip(row: Mapping[str, Any]) -> dict[str, Any]:
    """Manifest and cost as the store wrote them; ``luminance`` where the file keeps it apart."""
    return {key: json.loads(row[key]) for key in ("manifest", "cost", "luminance") if row.get(key)}


def _trial_table(path: Path, header: Mapping[str, Any], trials: list[dict], responses: list[dict]) -> pd.DataFrame:
    by_trial: dict[int, list[dict]] = {}
    for answer in responses:
        by_trial.setdefault(answer["trial"], []).append(answer)
    rows = []
    for trial in trials:
        if trial["observer_kind"] != header["observer_kind"]:
            wanted = f"{header['observer_kind']}, as the header says"
            raise InputError(
                problem(f"{path}: trial {trial['trial']}", "observer_kind", trial["observer_kind"], wanted)
            )
        row = trial_row(header, trial, by_trial.get(trial["trial"], []))
        row["session"] = path.stem
        rows.append(row)
    table = pd.DataFrame(rows)
    for column in TRIAL_COLUMNS:
        if column not in table:
            table[column] = pd.Series(dtype=object)
    others = [column for column in table.columns if column not in TRIAL_COLUMNS]
    return table[[*TRIAL_COLUMNS, *others]]


def trial_row(header: Mapping[str, Any], trial: Mapping[str, Any], answers: Sequence[Mapping[str, Any]]) -> dict:
    """One row of `load_sessions` from a row of the trials table and its answers (rows of the responses table)."""
    panels = json.loads(trial["panels"])
    shown = [panel for panel in panels if panel.get("role", "candidate") != "reference"] or panels
    row: dict[str, Any] = {
        "participant": str(header["participant"]),
        "run": header.get("run", 1),
        "group": group_text(header),
        "observer_kind": header["observer_kind"],
        "study": header.get("study", ""),
        "trial": trial["trial"],
        "planned": trial["planned"],
        "attempt": trial["attempt"],
        "block": trial["block"],
        "kind": trial["kind"],
        "scene": trial["scene"],
        "practice": bool(trial["practice"]),
        "catch": bool(trial["catch"]),
        "correct": trial["correct"],
        "technique": "|".join(sorted(panel["technique"] for panel in shown)),
        "condition": "|".join(sorted(panel["condition"] for panel in shown)),
        "refreshes": trial["refreshes"],
        "missed": trial["missed"],
        "replays": trial.get("replays", 0),
        "status": trial["status"],
        "onset_s": trial["onset_ns"] * 1e-9,
        "duration_s": (trial["offset_ns"] - trial["onset_ns"]) * 1e-9,
        "excluded": False,
        "reason": "",
    }
    for panel in panels:
        row[f"slot_{panel['slot']}"] = panel["condition"]
    between = header.get("group")
    levels = {**(between if isinstance(between, Mapping) else {}), **json.loads(trial["factors"])}
    for name, level in levels.items():
        column = name if name in _FACTORS_THAT_WIN or name not in row else f"factor_{name}"
        row[column] = level
    row.update(_answer_columns(shown, answers))
    return row


def _answer_columns(shown: Sequence[Mapping[str, Any]], answers: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The trial's first answer under the plain names, every answer under its question's name."""
    row: dict[str, Any] = {
        "side": None,
        "response": None,
        "winner": None,
        "loser": None,
        "rating": np.nan,
        "rt_s": np.nan,
        "timed_out": any(bool(answer["timed_out"]) for answer in answers),
    }
    conditions = [panel["condition"] for panel in shown]
    for order, answer in enumerate(sorted(answers, key=lambda one: one["kind"] != "choice")):
        choice = answer["kind"] == "choice"
        response = (answer["chosen"] or answer["answer"]) if choice else answer["answer"]
        rating = np.nan if answer["rating"] is None else float(answer["rating"])
        rt_s = np.nan if answer["rt_ns"] is None else answer["rt_ns"] * 1e-9
        name = answer["question"]
        row[f"response_{name}"], row[f"rt_s_{name}"] = response, rt_s
        if answer["kind"] == "likert":
            row[f"rating_{name}"] = rating
        if order == 0:
            row.update(response=response, rt_s=rt_s, side=answer["answer"] if choice else None)
        if answer["kind"] == "likert" and np.isnan(row["rating"]):
            row["rating"] = rating
        if choice and answer["chosen"] is not None and len(conditions) == 2 and answer["chosen"] in conditions:
            row["winner"] = answer["chosen"]
            row["loser"] = conditions[1 - conditions.index(answer["chosen"])]
    return row


def read_sessions(data: Iterable[str | Path]) -> list[Session]:
    """Every session of ``data`` (files or folders). Raises InputError where persons and simulated observers, or two
    studies, would be mixed, or where one run of a participant is there twice."""
    sessions = [read_session(path) for path in session_paths(data)]
    kinds = {session.observer_kind: session.path for session in sessions}
    if len(kinds) > 1:
        got = f"person ({kinds['person']}) and simulated ({kinds['simulated']})"
        raise InputError(problem("sessions", "observer_kind", got, "one kind: answers are never mixed"))
    studies = {str(session.header.get("study", "")) for session in sessions}
    if len(studies) > 1:
        raise InputError(problem("sessions", "study", " and ".join(sorted(studies)), "one study at a time"))
    seen: dict[tuple[str, str], Path] = {}
    for session in sessions:
        key = (session.participant, str(session.header.get("run", 1)))
        if key in seen:
            got = f"{key[0]} run {key[1]} in {seen[key]} and {session.path}"
            raise InputError(problem("sessions", "the same run twice", got, "each run once"))
        seen[key] = session.path
    return sessions


def combine(sessions: Sequence[Session]) -> pd.DataFrame:
    """The trial tables of ``sessions`` as one, before exclusions. Columns: `TRIAL_COLUMNS`, then the others."""
    tables = [session.trials for session in sessions]
    filled = [table for table in tables if len(table)]
    if not filled:
        return tables[0] if tables else pd.DataFrame(columns=list(TRIAL_COLUMNS))
    rows = [row for table in filled for row in table.to_dict("records")]
    names = list(dict.fromkeys(name for table in filled for name in table.columns))
    return pd.DataFrame(rows, columns=names)


def load_sessions(paths: Iterable[str | Path] | str | Path) -> pd.DataFrame:
    """Session files (or folders of them) as one table, one row a trial, in the order of files and presentations.

    Columns: `TRIAL_COLUMNS`, then ``slot_S`` (condition at slot S), the design's factors and, for every question Q,
    ``response_Q``, ``rt_s_Q`` and (Likert) ``rating_Q``. ``technique`` and ``condition`` name what is judged: one name
    on a rated sequence, the candidates joined by ``|`` in a comparison. ``response``: the condition chosen, or the
    rating as text; ``side``: the slot chosen; ``rating``: the first Likert answer. ``excluded`` and ``reason`` follow
    the rules of the study's analysis plan (`analysis.exclusions`). Raises InputError where a file is no session or
    persons and simulated observers would be mixed.
    """
    from analysis.exclusions import apply_exclusions, rules_of

    sessions = read_sessions([paths] if isinstance(paths, str | Path) else paths)
    return apply_exclusions(combine(sessions), rules_of(sessions), sessions).table
