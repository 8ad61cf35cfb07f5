"""What the experimenter sees of a running session, in another terminal: gaze, trial in hand, devices that went away.

It only reads the session file (WAL: a reader never holds the writer up), whose streams are at most 250 ms behind: the
presenter knows nothing of it, and the participant sees nothing of it.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from protocols.records import GAZE_DTYPE, has_table
from stimuli.errors import InputError, problem
from studyapp.clock import now_ns
from studyapp.session_file import read_header

RECENT_S = 1.0


@dataclass(frozen=True)
class GazeNow:
    """The newest gaze of a device: degrees right and up of the screen's centre, its age in seconds, and the share of
    valid samples among those of its last `RECENT_S`."""

    device: str
    x_dva: float
    y_dva: float
    valid: bool
    age_s: float
    valid_share: float


@dataclass(frozen=True)
class SessionNow:
    """``planned``: trials of the plan; ``done``: those that are on disk and were well timed; ``in_hand``: number of the
    presentation whose refreshes came last; ``last``: status of the newest row of ``trials``; ``event``: the newest
    event of a device; ``fixation_worst_deg``: the farthest gaze of the last fixated trial."""

    planned: int
    done: int
    in_hand: int | None
    last: str | None
    gaze: tuple[GazeNow, ...]
    event: str | None
    fixation_worst_deg: float | None
    complete: bool

    def line(self) -> str:
        """The state in one line of text."""
        parts = [f"{self.done} of {self.planned} trials done"]
        if self.in_hand is not None:
            parts.append(f"presentation {self.in_hand}")
        if self.last is not None and self.last != "ok":
            parts.append(f"last trial {self.last}")
        for one in self.gaze:
            state = f"{one.x_dva:+6.2f} {one.y_dva:+6.2f} degrees" if one.valid else "no eye seen"
            share = f"{100 * one.valid_share:.0f} % valid"
            parts.append(f"{one.device} {state}, {one.age_s:.2f} s old, {share}")
        if self.fixation_worst_deg is not None:
            parts.append(f"last fixation within {self.fixation_worst_deg:.1f} degrees")
        if self.event is not None:
            parts.append(self.event)
        return " | ".join(parts)


@contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    if not path.is_file():
        raise InputError(problem(path, "session", "nothing there", "a session file"))
    db = sqlite3.connect(f"file:{path.resolve()}?mode=ro", uri=True)
    try:
        yield db
    except sqlite3.DatabaseError as error:
        raise InputError(problem(path, "session", error, "a session file")) from error
    finally:
        db.close()


def look(path: Path) -> SessionNow:
    """The state of the session at ``path`` as its file has it now. Raises InputError where it is no session file."""
    with _reading(path) as db:
        header = read_header(db) if has_table(db, "header") else {}
        done, last = 0, None
        if has_table(db, "trials"):
            (done,) = db.execute("SELECT COUNT(*) FROM trials WHERE status='ok'").fetchone()
            (last,) = db.execute("SELECT status FROM trials ORDER BY trial DESC LIMIT 1").fetchone()
        in_hand = db.execute("SELECT MAX(trial) FROM flips").fetchone()[0] if has_table(db, "flips") else None
        event, worst = None, None
        if has_table(db, "events"):
            kinds = "'vanished', 'absent', 'reconnected', 'connected'"
            found = db.execute(
                f"SELECT device, kind FROM events WHERE kind IN ({kinds}) ORDER BY t_ns DESC LIMIT 1"
            ).fetchone()
            event = None if found is None or found[1] == "connected" else f"{found[0]} {found[1]}"
            seen = db.execute("SELECT payload FROM events WHERE kind='fixation' ORDER BY t_ns DESC LIMIT 1").fetchone()
            worst = None if seen is None else json.loads(seen[0])["worst_deg"]
        gaze = tuple(_newest_gaze(db)) if has_table(db, "gaze") else ()
    plan = header.get("plan") or []
    return SessionNow(len(plan), done, in_hand, last, gaze, event, worst, "completed_utc" in header)


def _newest_gaze(db: sqlite3.Connection) -> Iterator[GazeNow]:
    for (device,) in db.execute("SELECT DISTINCT device FROM gaze ORDER BY device").fetchall():
        chunks = db.execute("SELECT data FROM gaze WHERE device=? ORDER BY chunk DESC LIMIT 8", (device,)).fetchall()
        samples = np.concatenate([np.frombuffer(data, GAZE_DTYPE) for (data,) in reversed(chunks)])
        newest = samples[-1]
        recent = samples[samples["host_ns"] > newest["host_ns"] - int(RECENT_S * 1e9)]
        yield GazeNow(
            device, float(newest["x_dva"]), float(newest["y_dva"]), bool(newest["valid"]),
            (now_ns() - int(newest["mapped_ns"])) * 1e-9, float(np.mean(recent["valid"] > 0)),
        )  # fmt: skip
