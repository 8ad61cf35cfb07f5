"""``studyapp run``: one session, every trial on disk before the next begins."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from stimuli.errors import InputError, problem

HELP = "run one session: a person at the display, or a simulated observer on real lines"
EXAMPLE = "studyapp run demo --participant 3 --display offscreen --observer simulated --data data"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("--participant", type=int, required=True, metavar="N", help="slot number, from 1")
    parser.add_argument("--code", default="", metavar="CODE",
                        help="the person's code, letters and digits (default: the slot's number); who replaces "
                        "somebody runs the same slot under a code of their own")  # fmt: skip
    parser.add_argument("--display", choices=("glfw", "offscreen", "virtual"), default=None, help="default: the lab's")
    parser.add_argument("--monitor", type=int, default=None, help="fullscreen on this monitor (default: the lab's)")
    parser.add_argument("--observer", choices=("keyboard", "simulated"), default="keyboard",
                        help="keyboard: a person (with the lab's box, if there is one)")  # fmt: skip
    parser.add_argument("--resume", action="store_true", help="go on with the participant's interrupted session")
    parser.add_argument("--data", type=Path, default=Path("data"), metavar="DIR", help="session files (default: data)")
    parser.add_argument("--store", type=Path, default=None, metavar="DIR",
                        help="clips (default: $STUDYAPP_STORE, else .clips beside the protocol)")  # fmt: skip
    parser.add_argument("--lab", default=None, metavar="FILE", help="lab file (default: $STUDYAPP_LAB, else lab.yaml)")
    parser.add_argument("--seed", type=int, default=None, help="of the simulated observer (default: the protocol's)")
    parser.add_argument("--override", action="append", default=[], metavar="CHECK=REASON",
                        help="go on although a check fails; repeatable, stands in the data")  # fmt: skip
    parser.add_argument("--about", action="append", default=[], metavar="NAME=VALUE",
                        help="an answer to an inclusion question of the protocol; repeatable")  # fmt: skip
    parser.add_argument("--markers", default="", metavar="ID", help="say trials and answers on an LSL marker stream")
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="ask the system for real-time priority for the presenter; what came of it is recorded",
    )
    parser.add_argument("--pids", type=Path, default=None, metavar="FILE", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Run or resume one session."""
    from studyapp.run_session import run_session
    from studyapp.session_parts import RunRequest

    request = RunRequest(
        protocol=args.protocol, participant=args.participant, code=args.code, display=args.display,
        monitor=args.monitor, simulated=args.observer == "simulated", resume=args.resume, data=args.data,
        store=args.store, lab=args.lab, seed=args.seed, overrides=pairs("--override", args.override),
        about=pairs("--about", args.about), markers=args.markers, pids=args.pids, realtime=args.realtime,
    )  # fmt: skip
    done = run_session(request)
    print(f"{done.path}: {done.presentations} presentations, {done.answers} answers; complete")
    if done.lost_records:
        print(f"{done.path}: {done.lost_records} stream records were lost", file=sys.stderr)
        return 1
    return os.EX_OK


def pairs(option: str, values: list[str]) -> dict[str, str]:
    """['a=b', ...] -> {a: b}. Raises InputError on anything else."""
    found = {}
    for value in values:
        name, equals, text = value.partition("=")
        if not (name and equals and text.strip()):
            raise InputError(problem(option, "value", repr(value), "NAME=TEXT"))
        found[name] = text
    return found
