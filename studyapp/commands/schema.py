"""``studyapp schema``: JSON Schema of protocols, for completion and checking in editors."""

from __future__ import annotations

import argparse
import json

from protocols.schema import protocol_schema

HELP = "print the JSON Schema of protocols, for completion in editors"
EXAMPLE = "studyapp schema > protocol.schema.json"


def configure(parser: argparse.ArgumentParser) -> None:
    """No arguments."""


def run(args: argparse.Namespace) -> int:
    """Print it."""
    print(json.dumps(protocol_schema(), indent=1))
    return 0
