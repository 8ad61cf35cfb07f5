"""``studyapp analyze``: hands over to ``python -m analysis`` in a process of its own."""

from __future__ import annotations

import argparse
import subprocess
import sys

HELP = "statistics and report from session files"
EXAMPLE = "studyapp analyze data --report report.html --json results.json"


def configure(parser: argparse.ArgumentParser) -> None:
    """The options of ``python -m analysis``."""
    parser.add_argument("data", nargs="+", metavar="DATA", help="session files, or folders that hold them")
    parser.add_argument("--report", metavar="FILE", required=True, help="the page to write (.html)")
    parser.add_argument("--json", metavar="FILE", help="every number of the page")
    parser.add_argument("--tables", metavar="DIR", help="the tables as CSV and LaTeX")
    parser.add_argument("--blind", action="store_true", help="coded condition names, no answers; locks the exclusions")
    parser.add_argument("--registration", metavar="FILE", help="NAME.freeze.json: says what differs from it")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(args: argparse.Namespace) -> int:
    """Run the analysis; returns its exit code (0, 1 or 2)."""
    command = [sys.executable, "-m", "analysis", *args.data, "--report", args.report]
    for option in ("json", "tables", "registration"):
        if getattr(args, option):
            command += [f"--{option}", getattr(args, option)]
    command += [f"--{flag}" for flag in ("blind", "quiet") if getattr(args, flag)]
    return subprocess.run(command, check=False).returncode
