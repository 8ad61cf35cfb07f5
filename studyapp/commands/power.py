"""``studyapp power``: how many participants the planned test needs; hands over to ``python -m analysis power``."""

from __future__ import annotations

import argparse
import subprocess
import sys

HELP = "how many participants give the planned test the wanted power, by simulation"
EXAMPLE = "studyapp power foveated_2016"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("options", nargs=argparse.REMAINDER, help="options of python -m analysis power")


def run(args: argparse.Namespace) -> int:
    """Run the simulation; returns its exit code (0, 1 or 2)."""
    command = [sys.executable, "-m", "analysis", "power", args.protocol, *args.options]
    return subprocess.run(command, check=False).returncode
