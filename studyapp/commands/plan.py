"""``studyapp plan``: the exact trials of one participant, in order."""

from __future__ import annotations

import argparse
import json

from protocols.check import first_adaptive_trial
from protocols.design import plan
from protocols.load import load_study
from protocols.session_size import size_of_block
from protocols.trial import Trial

HELP = "print the exact trials of one participant, in order"
EXAMPLE = "studyapp plan demo --participant 3"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("--participant", type=int, required=True, metavar="N", help="slot number, from 1")
    parser.add_argument("--seed", type=int, help="instead of the protocol's own")
    parser.add_argument("--json", action="store_true", help="one JSON list of trials")


def run(args: argparse.Namespace) -> int:
    """Print the plan."""
    study = load_study(args.protocol)
    trials = plan(study, args.participant, args.seed)
    if args.json:
        print(json.dumps([trial.as_dict() for trial in trials], indent=1))
        return 0
    print(f"{'#':>4} {'block':<14} {'kind':<14} {'scene':<12} shown")
    for trial in trials:
        print(f"{trial.index:>4} {trial.block:<14} {trial.kind:<14} {trial.scene:<12} {_shown(trial)}".rstrip())
    for block in study.blocks:
        if block.adaptive is not None and first_adaptive_trial(study, block, args.participant) is not None:
            most = size_of_block(study, block)
            said = f"at most {most} trials, made as the answers come ({block.adaptive.kind})"
            print(f"   + {block.name:<14} {block.kind:<14} {said}")
    return 0


def _shown(trial: Trial) -> str:
    if not trial.panels:
        return trial.text.strip().replace("\n", " ")[:60]
    marks = [word for word, on in (("practice", trial.practice), ("catch", trial.catch)) if on]
    skip = {"scene", "pair", "condition", "catch"}
    levels = [f"{name}={level}" for name, level in trial.factors.items() if name not in skip]
    panels = "  ".join(f"{p.slot}:{p.condition}" + ("*" if p.role == "reference" else "") for p in trial.panels)
    return "  ".join([panels, *levels, *(f"({mark})" for mark in marks)])
