"""``studyapp freeze``: the registration of a study, written before the first person comes."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from protocols.freeze import differences, registration
from protocols.load import LIBRARY, library_path, read_study
from stimuli.errors import InputError, problem

HELP = "write the registration of a study: hypotheses, n, exclusions, tests, bounds, hashes"
EXAMPLE = "studyapp freeze foveated_2016"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("--amend", metavar="REASON", help="replace an earlier registration, which is kept inside")


def run(args: argparse.Namespace) -> int:
    """Write NAME.freeze.json; refuse to change an earlier one without a reason."""
    study, text = read_study(args.protocol)
    file = freeze_file(args.protocol)
    lock = file.with_name(file.name.replace(".freeze.json", ".match.yaml"))
    made = registration(study, text, lock.read_text(encoding="utf-8") if lock.exists() else None)
    if not study.analysis.tests:
        raise InputError(problem(args.protocol, "analysis.tests", "none", "the tests that will be made"))
    if file.exists():
        earlier = json.loads(file.read_text(encoding="utf-8"))
        found = differences(earlier, made)
        if not found and earlier["protocol_sha256"] == made["protocol_sha256"]:
            print(f"{file}: already frozen, nothing has changed")
            return 0
        if args.amend is None:
            said = "; ".join(found) or "words or comments only"
            raise InputError(problem(file, "registration", f"a protocol that differs ({said})", "--amend REASON"))
        made["amendments"] = [
            *earlier.pop("amendments", []),
            {"reason": args.amend, "changed": found, "before": earlier},
        ]
    file.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    count = (
        f"{len(made['tests'])} tests, {made['participants']} participants, {len(made['exclusions'])} exclusion rules"
    )
    print(f"{file}: {count}, protocol {made['protocol_sha256'][:12]}")
    return 0


def freeze_file(protocol: str) -> Path:
    """NAME.freeze.json beside the protocol (for shipped protocols, in the current folder)."""
    file = library_path(protocol)
    folder = Path.cwd() if file.parent == LIBRARY else file.parent
    return folder / f"{file.stem}.freeze.json"
