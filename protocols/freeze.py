"""The registration of a study before data: what will be tested, on whom, with which exclusions, under which hashes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from protocols.study import Study

FORMAT = 1


def sha256(text: str) -> str:
    """Hex digest of UTF-8 text."""
    return hashlib.sha256(text.encode()).hexdigest()


def registration(study: Study, protocol_text: str, match_text: str | None = None) -> dict[str, Any]:
    """What `studyapp freeze` writes and `analyze` compares with, JSON-ready and without dates.

    ``families``: adjusted together, name -> tests; a test without a family stands in one of its own name.
    ``sections``: part of the protocol -> hash, so that what was changed can be named.
    """
    plan = study.analysis_plan()
    families: dict[str, list[str]] = {}
    for test in study.analysis.tests:
        families.setdefault(test.family or test.name, []).append(test.name)
    data = study.as_dict()
    return {
        "format": FORMAT,
        "study": study.study,
        "protocol_sha256": sha256(protocol_text),
        "match_sha256": None if match_text is None else sha256(match_text),
        "hypotheses": {test.name: test.hypothesis for test in study.analysis.tests if test.hypothesis},
        "participants": study.participants.target,
        "stopping_rule": study.participants.stopping_rule,
        "inclusion": data["participants"]["inclusion"],
        "exclusions": plan["exclusions"],
        "alpha": plan["alpha"],
        "adjust": plan["adjust"],
        "tests": plan["tests"],
        "families": families,
        "bounds": {t.name: [t.low, t.high] for t in study.analysis.tests if t.low is not None or t.high is not None},
        "sections": {key: sha256(json.dumps(value, sort_keys=True)) for key, value in data.items()},
    }


def differences(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between two registrations, one line each; ``sections`` name the part of the protocol."""
    lines = []
    for key in ("participants", "stopping_rule", "alpha", "adjust", "hypotheses", "exclusions", "inclusion", "bounds"):
        if frozen.get(key) != now.get(key):
            lines.append(f"{key}: frozen {json.dumps(frozen.get(key))}, now {json.dumps(now.get(key))}")
    before = {test["name"]: test for test in frozen.get("tests", [])}
    after = {test["name"]: test for test in now.get("tests", [])}
    lines += [f"test {name}: not registered" for name in after if name not in before]
    lines += [f"test {name}: registered, now absent" for name in before if name not in after]
    lines += [f"test {name}: changed" for name in after if name in before and before[name] != after[name]]
    told = {"participants", "analysis"}
    sections, here = frozen.get("sections", {}), now.get("sections", {})
    lines += [
        f"{key}: changed since it was frozen" for key in sections if key not in told and sections[key] != here.get(key)
    ]
    if frozen.get("match_sha256") != now.get("match_sha256"):
        lines.append("match: the lock file was written anew since it was frozen")
    return lines
