"""``studyapp withdraw``: a participant's data leave sessions and exports; a tombstone stays."""

from __future__ import annotations

import argparse
from pathlib import Path

from studyapp.withdraw import withdraw

HELP = "remove a participant from sessions and exports, leaving a tombstone"
EXAMPLE = "studyapp withdraw 7 --data data --exports export_csv export_bids"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("code", help="the participant's code")
    parser.add_argument("--data", type=Path, default=Path("data"), metavar="DIR", help="session files (default: data)")
    parser.add_argument("--exports", type=Path, nargs="*", default=[], metavar="DIR", help="folders of exported data")


def run(args: argparse.Namespace) -> int:
    """Remove, and say what was removed."""
    done = withdraw(args.code, args.data, args.exports)
    print(
        f"participant {args.code}: removed {len(done.sessions)} sessions, {done.rows} rows and {len(done.folders)} "
        f"folders of exports; {done.tombstone} stays. Reports made before still show this person: make them again."
    )
    return 0
