"""NAME.match.yaml: what `studyapp match` solved and measured, read whenever the protocol is read.

The lock belongs to one question: where conditions, scenes or ``match`` of the protocol have changed since, it is stale
and refused.
"""

from __future__ import annotations

import hashlib
import io
import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError
from ruamel.yaml import YAML

from protocols.condition_references import parameter_problems
from protocols.conditions import Condition
from protocols.match import Matched
from protocols.quantity import Model, Name
from protocols.study import Study
from protocols.yaml_source import read_yaml
from stimuli.errors import InputError, problem

SUFFIX = ".match.yaml"
HEAD = "# Written by `studyapp match`; do not edit: run it again. The values below replace those of the protocol.\n"


class SolvedKnob(Model):
    """A knob where it was left: ``condition``'s ``parameter`` has ``value``."""

    condition: Name
    parameter: Name
    value: Any


class MatchLock(Model):
    """The lock file. ``found``: one list for each entry under ``match``, in its order; ``machine`` and ``engine``
    say where it was measured; ``size_px``, ``frames``, ``scenes``: on what."""

    format: Annotated[int, Field(ge=1, le=1)] = 1
    study: Name
    asked_sha256: str
    machine: str
    size_px: list[int]
    frames: int
    scenes: list[str]
    knobs: list[SolvedKnob]
    found: list[list[Matched]]


def asked_sha256(study: Study) -> str:
    """The hash of all that a match hangs on; what an earlier match found is no part of it."""
    asked = {
        "match": [match.model_dump(mode="json", exclude={"found"}) for match in study.match],
        "conditions": {name: one.model_dump(mode="json") for name, one in study.all_conditions().items()},
        "scenes": {name: scene.model_dump(mode="json") for name, scene in study.scenes.items()},
        "defaults": study.defaults.model_dump(mode="json"),
        "display": study.display.model_dump(mode="json"),
    }
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


def write_lock(path: Path, lock: MatchLock) -> None:
    """Write ``lock`` as YAML."""
    stream = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.width = 100
    yaml.dump(lock.model_dump(mode="json"), stream)
    path.write_text(HEAD + stream.getvalue(), encoding="utf-8")


def read_lock(path: Path) -> MatchLock:
    """The lock at ``path``. Raises InputError where it is none."""
    try:
        return MatchLock.model_validate_json(json.dumps(read_yaml(path).plain()))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(problem(path, where or "match lock", first["msg"], "a file by `studyapp match`")) from None


def with_lock(study: Study, lock: MatchLock, path: Path) -> Study:
    """The study with the solved values in its conditions and what was found in its matches.

    Raises InputError where the lock is another study's or stale, or a technique refuses a value.
    """
    if lock.study != study.study or lock.asked_sha256 != asked_sha256(study):
        got = "of another study" if lock.study != study.study else "made before the protocol was changed"
        raise InputError(problem(path, "match lock", got, f"a new one (studyapp match), or none ({path.name} removed)"))
    conditions = dict(study.conditions)
    known = study.all_conditions()
    refused = []
    for knob in lock.knobs:
        base = conditions.get(knob.condition, known.get(knob.condition))
        if base is None:
            raise InputError(problem(path, "condition", repr(knob.condition), " | ".join(known)))
        params = {**base.params, knob.parameter: knob.value}
        what = f"{knob.condition}.{knob.parameter}"
        refused += [
            problem(path, what, got, wanted)
            for _, _, got, wanted in parameter_problems(base.technique, params, (), what)
        ]
        conditions[knob.condition] = Condition(**{**dict(base), "params": params})
    if len(lock.found) != len(study.match):
        refused.append(problem(path, "found", f"{len(lock.found)} lists", f"{len(study.match)}, one a match"))
    if refused:
        raise InputError(*refused)
    matches = [match.model_copy(update={"found": found}) for match, found in zip(study.match, lock.found, strict=True)]
    return study.model_copy(update={"conditions": conditions, "match": matches})
