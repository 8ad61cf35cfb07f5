"""``studyapp export``: session files as CSV or BIDS, by ``python -m analysis`` in a process of its own."""

from __future__ import annotations

import argparse
import subprocess
import sys

HELP = "session files as a BIDS data set or as CSV with codebook and R script"
EXAMPLE = "studyapp export data --bids bids --csv csv"


def configure(parser: argparse.ArgumentParser) -> None:
    """Data and the folders to write; at least one of them."""
    parser.add_argument("data", nargs="+", metavar="DATA", help="session files, or folders that hold them")
    parser.add_argument("--bids", metavar="DIR", help="BIDS data set with eye tracking as physio")
    parser.add_argument("--csv", metavar="DIR", help="trials, participants, flips, gaze, codebook and analysis.R")


def run(args: argparse.Namespace) -> int:
    """Run the exports asked for, one after the other; returns the first exit code that is not 0."""
    wanted = [(kind, getattr(args, kind)) for kind in ("bids", "csv") if getattr(args, kind)]
    if not wanted:
        print("export: output: got none, wanted --bids DIR or --csv DIR", file=sys.stderr)
        return 2
    for kind, folder in wanted:
        command = [sys.executable, "-m", "analysis", kind, *args.data, "--out", folder]
        code = subprocess.run(command, check=False).returncode
        if code:
            return code
    return 0
