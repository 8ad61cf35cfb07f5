"""What was registered (`studyapp freeze`) against what was run: differences in words, and the registered tests."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from analysis.sessions import Session
from protocols.freeze import differences, registration
from protocols.load import read_study
from stimuli.errors import InputError, problem

_PLANNED = ("alpha", "adjust", "exclusions", "tests")


@dataclass(frozen=True)
class Comparison:
    """``lines``: what differs, one line each; ``registered``: names of the tests that are as they were registered."""

    lines: tuple[str, ...]
    registered: frozenset[str]


def read_registration(path: Path) -> Mapping[str, Any]:
    """A ``NAME.freeze.json``; InputError where it cannot be read or is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(problem(path, "registration", str(error.strerror), "a file of studyapp freeze")) from error
    except ValueError as error:
        raise InputError(problem(path, "registration", str(error), "a file of studyapp freeze")) from error
    if not isinstance(found, dict) or "tests" not in found or "protocol_sha256" not in found:
        raise InputError(problem(path, "registration", "other content", "a file of studyapp freeze"))
    return found


def compare(frozen: Mapping[str, Any], sessions: Sequence[Session], analysed: int) -> Comparison:
    """Compare the registration with the plan stored in the sessions and the number of participants analysed."""
    if frozen.get("study") != sessions[0].header.get("study"):
        wanted = f"a registration of {sessions[0].header.get('study')}"
        raise InputError(problem("--registration", "study", frozen.get("study"), wanted))
    plan = sessions[0].header.get("analysis_plan") or {}
    hashes = {str(session.header.get("protocol_sha256")) for session in sessions}
    as_registered = hashes == {frozen["protocol_sha256"]}
    # The part that was changed is named by reading the text that was run; the same text has the same parts.
    here = {} if as_registered else _registration_of(sessions[0])
    here["match_sha256"] = frozen.get("match_sha256")
    now = {**frozen, **here, **{key: plan.get(key, frozen.get(key)) for key in _PLANNED}, "participants": analysed}
    lines = [line.replace("now", "here", 1) for line in differences(frozen, now)]
    if not as_registered:
        lines.append("protocol: the text that was run is not the text that was registered")
    before = {test["name"]: test for test in frozen["tests"]}
    same = {test["name"] for test in plan.get("tests") or [] if before.get(test["name"]) == test}
    return Comparison(tuple(lines), frozenset(same))


def _registration_of(session: Session) -> dict[str, Any]:
    """What `studyapp freeze` would write for the protocol text that the session holds; empty where the text is none
    that stands alone (it is then compared by its hash)."""
    text = str(session.header.get("protocol_text") or "")
    with TemporaryDirectory() as folder:
        file = Path(folder) / "protocol.yaml"
        file.write_text(text, encoding="utf-8")
        try:
            study, _ = read_study(file)
        except InputError:
            return {}
    return registration(study, text)
