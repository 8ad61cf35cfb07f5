"""``studyapp replay``: the frames of a live trial, rendered again from what the session recorded."""

from __future__ import annotations

import argparse
import json
import sqlite3
from pathlib import Path

from protocols.records import has_table
from stimuli.errors import InputError, problem
from studyapp.session_file import read_header

HELP = "render the frames of a live trial again; bit-exact on the same engine"
EXAMPLE = "studyapp replay data/study_p1_1.sqlite 4 --protocol study.yaml --out frames"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("session", type=Path, help="a session file")
    parser.add_argument("trial", type=int, help="number of the presentation")
    parser.add_argument("--protocol", default=None, help="the protocol it was run with (default: the shipped one)")
    parser.add_argument("--store", default=None, metavar="DIR", help="the clip store (settled exposures)")
    parser.add_argument("--out", type=Path, default=None, metavar="DIR", help="write the frames as PNG")


def run(args: argparse.Namespace) -> int:
    """0: the same frames; 1: other frames than were shown."""
    logs = recorded(args.session, args.trial)
    from studyapp.replay import replay

    same = True
    for slot, result in replay(args.session, args.trial, logs, args.protocol, args.store, args.out).items():
        word = "bit-exact" if result.exact else "NOT what was shown (another engine, machine or version)"
        print(f"trial {args.trial}, {slot}: {result.frames} frames rendered again, {word}")
        same = same and result.exact
    return 0 if same else 1


def recorded(session: Path, trial: int) -> list[tuple[dict[str, object], bytes]]:
    """(payload, frames) of each live panel of the presentation. Raises InputError where there is none."""
    if not session.is_file():
        raise InputError(problem(session, "session", "nothing there", "a session file"))
    db = sqlite3.connect(session)
    try:
        if not read_header(db) or not has_table(db, "trials"):
            raise InputError(problem(session, "session", "no trials in it", "a session file"))
        if db.execute("SELECT 1 FROM trials WHERE trial=?", (trial,)).fetchone() is None:
            last = db.execute("SELECT MAX(trial) FROM trials").fetchone()[0]
            raise InputError(problem(session, "trial", trial, f"0 to {last}"))
        rows = []
        if has_table(db, "events"):
            found = db.execute("SELECT payload, raw FROM events WHERE device='live' AND kind='frames'")
            rows = [(json.loads(payload), bytes(raw)) for payload, raw in found]
    except sqlite3.DatabaseError as error:
        raise InputError(problem(session, "session", error, "a session file")) from error
    finally:
        db.close()
    mine = [(payload, raw) for payload, raw in rows if payload["trial"] == trial]
    if not mine:
        raise InputError(
            problem(session, f"trial {trial}", "no live panel (its clips are in the store)", "a live trial")
        )
    return mine
