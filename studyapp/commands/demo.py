"""``studyapp demo``: from nothing to a report."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "render a small study, run it, simulate 11 more participants, analyse, print the report's path"
EXAMPLE = "studyapp demo --scene kitchen.glb --out demo-output"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--scene", type=Path, default=None, metavar="FILE", help="your own scene instead of the embedded ones"
    )
    parser.add_argument("--animation", default=None, metavar="NAME", help="of a file with several animations")
    parser.add_argument("--out", type=Path, default=Path("demo-output"), metavar="DIR", help="default: demo-output")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="rendering processes (default: 2)")


def run(args: argparse.Namespace) -> int:
    """Do it."""
    from studyapp.demo import DemoRequest, run_demo

    run_demo(DemoRequest(out=args.out, scene=args.scene, animation=args.animation, workers=args.workers))
    return 0
