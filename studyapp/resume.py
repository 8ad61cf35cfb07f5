"""Going on after an interruption: same file, same order, the next trial; and what was lost, said."""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from protocols.records import FLIP_DTYPE, has_table
from protocols.trial import Trial
from stimuli.errors import InputError, problem
from studyapp.session import MAX_ATTEMPTS, Progress
from studyapp.session_file import SessionFile, read_header
from studyapp.trial import planned_row


@dataclass(frozen=True)
class Interrupted:
    """A session that can go on. ``plan``: as it was stored; ``lost``: planned indices that were being shown when it
    ended (at most one each time); ``last_ns``: the newest stamp in the file."""

    path: Path
    header: dict[str, Any]
    plan: tuple[Trial, ...]
    progress: Progress
    lost: tuple[int, ...]
    last_ns: int


def session_paths(folder: Path, study: str, participant: int) -> list[Path]:
    """Session files of the slot ``participant`` in this study, oldest first."""
    pattern = re.compile(re.escape(f"{study}_p{participant}_") + r"(\d+)\.sqlite")
    found = [(int(match[1]), path) for path in folder.glob("*.sqlite") if (match := pattern.fullmatch(path.name))]
    return [path for _, path in sorted(found)]


def unfinished(path: Path) -> bool:
    """Was this session begun and never completed?"""
    db = sqlite3.connect(path)
    try:
        header = read_header(db)
    except sqlite3.Error:
        return False
    finally:
        db.close()
    return "plan" in header and not header.get("completed_utc")


def next_session_path(folder: Path, study: str, participant: int) -> Path:
    """Where a new session of the slot goes."""
    runs = [int(path.stem.rpartition("_")[2]) for path in session_paths(folder, study, participant)]
    run = max(runs, default=0) + 1
    return folder / f"{study}_p{participant}_{run}.sqlite"


def interrupted(path: Path, protocol_sha256: str) -> Interrupted:
    """Read an interrupted session; its file is not changed.

    Raises InputError where the file is no session, is complete, or was begun with another protocol.
    """
    try:
        db = sqlite3.connect(path)
        header = read_header(db)
    except sqlite3.Error as error:
        raise InputError(problem(path, "session", error, "a session file")) from error
    try:
        if "plan" not in header:
            raise InputError(problem(path, "session", "no plan in it", "a session that had begun"))
        if header.get("completed_utc"):
            raise InputError(
                problem(path, "session", f"complete since {header['completed_utc']}", "an interrupted one")
            )
        if header.get("protocol_sha256") != protocol_sha256:
            got = f"protocol {protocol_sha256[:12]}"
            wanted = f"the protocol it was begun with ({str(header.get('protocol_sha256'))[:12]})"
            raise InputError(problem(path, "the protocol has changed since", got, wanted))
        plan = tuple(Trial.from_dict(trial) for trial in header["plan"])
        return _progress(db, path, header, plan)
    finally:
        db.close()


def _progress(db: sqlite3.Connection, path: Path, header: dict[str, Any], plan: tuple[Trial, ...]) -> Interrupted:
    rows = []
    last_ns = 0
    if has_table(db, "trials"):
        rows = db.execute("SELECT trial, planned, status, offset_ns FROM trials").fetchall()
        last_ns = max((row[3] for row in rows), default=0)
    attempts = Counter(planned for _, planned, _, _ in rows)
    done = {planned for _, planned, status, _ in rows if status == "ok"}
    failed = Counter(planned for _, planned, status, _ in rows if status == "timing_failed")
    done |= {planned for planned, times in failed.items() if times >= MAX_ATTEMPTS}
    requeued = frozenset(failed) - done
    committed = {trial for trial, _, _, _ in rows}
    orphans = _flips_without_trial(db, committed)
    # The presentation in hand was of the first planned trial that is not done, as its block's queue stood.
    queue = [trial.index for trial in plan if trial.index not in done]
    first_block = plan[queue[0]].block if queue else ""
    queue.sort(key=lambda index: (plan[index].block != first_block, index in requeued))
    lost = tuple(queue[:1]) if orphans and queue else ()
    number = max([*committed, *orphans], default=-1) + 1
    for rows_of in orphans.values():
        last_ns = max(last_ns, int(rows_of["shown_ns"].max()))
    return Interrupted(path, header, plan, Progress(frozenset(done), requeued, dict(attempts), number), lost, last_ns)


def answers_so_far(path: Path) -> dict[int, str | None]:
    """Planned index -> condition chosen, of the trials that are done (None: no choice was made)."""
    db = sqlite3.connect(path)
    try:
        if not has_table(db, "trials"):
            return {}
        rows = db.execute("SELECT trial, planned FROM trials WHERE status IN ('ok', 'timing_failed') ORDER BY trial")
        planned = dict(rows.fetchall())
        chosen: dict[int, str | None] = dict.fromkeys(planned.values())
        if has_table(db, "responses"):
            for trial, name in db.execute("SELECT trial, chosen FROM responses WHERE kind='choice' ORDER BY trial"):
                if trial in planned:
                    chosen[planned[trial]] = name
        return chosen
    finally:
        db.close()


def _flips_without_trial(db: sqlite3.Connection, committed: set[int]) -> dict[int, np.ndarray]:
    """Flips of presentations that have no row in ``trials``."""
    if not has_table(db, "flips"):
        return {}
    chunks: dict[int, list[np.ndarray]] = {}
    for trial, data in db.execute("SELECT trial, data FROM flips ORDER BY trial, chunk"):
        if trial not in committed:
            chunks.setdefault(trial, []).append(np.frombuffer(data, FLIP_DTYPE))
    return {trial: np.concatenate(parts) for trial, parts in chunks.items()}


def mend(session: Interrupted, observer_kind: str, now_ns: int) -> None:
    """Give the presentation that was cut short its row (status aborted), and note the interruption; durable."""
    file = SessionFile(session.path)
    try:
        db = sqlite3.connect(session.path)
        committed = set()
        if has_table(db, "trials"):
            committed = {trial for (trial,) in db.execute("SELECT trial FROM trials")}
        orphans = _flips_without_trial(db, committed)
        db.close()
        for number, flips in orphans.items():
            trial = session.plan[session.lost[0]] if session.lost else session.plan[-1]
            attempt = session.progress.attempts.get(trial.index, 0)
            row = planned_row(
                trial, number, attempt, int(flips["shown_ns"][0]), int(flips["shown_ns"][-1]), len(flips),
                int(flips["missed"][1:].sum()), "aborted", observer_kind,
            )  # fmt: skip
            file.trial(row)
        file.note(now_ns, f"resumed; lost: {f'planned trial {session.lost[0]}' if session.lost else 'nothing'}")
        file.commit()
    finally:
        file.close()
