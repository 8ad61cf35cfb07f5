"""A participant withdraws: every trace of the code leaves the data and the exports; a tombstone stays.

The tombstone says that data of this code were removed, when, from which study and how many files; nothing of what they
held. Session files are overwritten before they are unlinked (on copy-on-write and flash disks that is no guarantee).
"""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stimuli.errors import InputError, problem
from studyapp.clock import wall_clock_utc
from studyapp.session_file import read_header

PARTICIPANT_COLUMNS = ("participant", "participant_id", "subject", "observer")


@dataclass(frozen=True)
class Withdrawn:
    """What was removed: sessions, rows of tables, folders of exports; where the tombstone is."""

    sessions: tuple[Path, ...]
    rows: int
    folders: tuple[Path, ...]
    tombstone: Path


def withdraw(code: str, data: Path, exports: Sequence[Path] = ()) -> Withdrawn:
    """Remove participant ``code`` from the session files in ``data`` and from every export folder.

    ``exports`` hold CSV/TSV tables with a participant column and BIDS folders ``sub-CODE``. Raises InputError where
    neither data nor exports know the code (a second withdrawal finds the tombstone and is refused with its date).
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", code):
        raise InputError(problem("withdraw", "code", repr(code), "a participant code (letters, digits, _ and -)"))
    tombstone = data / f"withdrawn_{code}.json"
    sessions, studies = _sessions_of(code, data)
    rows, folders = 0, []
    for folder in exports:
        if not folder.is_dir():
            raise InputError(problem(folder, "export", "nothing there", "a folder of exported data"))
        for table in sorted([*folder.rglob("*.csv"), *folder.rglob("*.tsv")]):
            rows += _remove_rows(table, code)
        for found in sorted(folder.rglob("sub-*")):
            if found.is_dir() and found.name.removeprefix("sub-").lstrip("0") == code.lstrip("0"):
                shutil.rmtree(found)
                folders.append(found)
    if not sessions and not rows and not folders:
        if tombstone.is_file():
            when = json.loads(tombstone.read_text())["withdrawn_utc"]
            raise InputError(problem(data, f"participant {code}", f"withdrawn already on {when}", "a participant"))
        raise InputError(problem(data, "participant", code, "a code that the sessions or exports hold"))
    for path in sessions:
        _erase(path)
    record = {
        "participant": code, "withdrawn_utc": wall_clock_utc(), "studies": sorted(studies),
        "sessions_removed": len(sessions), "rows_removed": rows, "folders_removed": len(folders),
    }  # fmt: skip
    tombstone.write_text(json.dumps(record, indent=1) + "\n")
    return Withdrawn(tuple(sessions), rows, tuple(folders), tombstone)


def _sessions_of(code: str, data: Path) -> tuple[list[Path], set[str]]:
    """Session files of the code, judged by their headers, not their names; and their studies."""
    if not data.is_dir():
        raise InputError(problem(data, "data folder", "nothing there", "a folder of session files"))
    found, studies = [], set()
    for path in sorted([*data.glob("*.sqlite"), *data.glob("*.sqlite.part")]):
        db = sqlite3.connect(path)
        try:
            header = read_header(db)
        except sqlite3.DatabaseError:
            continue  # not one of ours
        finally:
            db.close()
        if str(header.get("participant")) == code:
            found.append(path)
            studies.add(str(header.get("study")))
    return found, studies


def _remove_rows(table: Path, code: str) -> int:
    """Rewrite a table without the participant's rows; how many went."""
    delimiter = "\t" if table.suffix == ".tsv" else ","
    with open(table, newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file, delimiter=delimiter))
    if not rows:
        return 0
    columns = [place for place, name in enumerate(rows[0]) if name in PARTICIPANT_COLUMNS]
    names = {code, f"sub-{code}", f"sub-{code.zfill(2)}", f"sub-{code.zfill(3)}"}
    kept = [row for row in rows[1:] if not any(place < len(row) and row[place] in names for place in columns)]
    removed = len(rows) - 1 - len(kept)
    if removed:
        beside = table.with_name(f".{table.name}.new")
        with open(beside, "w", newline="", encoding="utf-8") as file:
            csv.writer(file, delimiter=delimiter, lineterminator="\n").writerows([rows[0], *kept])
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, table)
    return removed


def _erase(path: Path) -> None:
    """Overwrite with zeros, then unlink, SQLite's side files too."""
    for part in (path, path.with_name(path.name + "-wal"), path.with_name(path.name + "-shm")):
        if part.is_file():
            with open(part, "r+b") as file:
                left = part.stat().st_size
                while left > 0:
                    left -= file.write(bytes(min(left, 1 << 20)))
                file.flush()
                os.fsync(file.fileno())
            part.unlink()
