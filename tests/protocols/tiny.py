"""Small protocols for tests."""

from __future__ import annotations

import json
from typing import Any

from protocols.study import Study

TEXT = """\
study: tiny
scenes: {a: tunnel_geom, b: bar}
conditions:
  gold: {technique: reference, params: {spp: 4}}
  full: vanilla
  half: {technique: vanilla, rate_hz: 120}
  dense: temporally_dense
questions:
  closer: {kind: choice, text: Which is closer?}
  clean: {kind: likert, text: It was clean.}
blocks:
  - name: pairs
    kind: side_by_side
    reference: gold
    compare: {of: [full, half, dense]}
    factors: {scene: [a, b]}
    questions: [closer]
  - name: rating
    kind: likert
    factors:
      scene: [a, b]
      condition: [full, half, dense]
    questions: [clean]
    repetitions: 2
"""


def tiny(**over: Any) -> Study:
    """The study of TEXT with top-level keys replaced."""
    data: dict[str, Any] = {
        "study": "tiny",
        "scenes": {"a": "tunnel_geom", "b": "bar"},
        "conditions": {
            "gold": {"technique": "reference", "params": {"spp": 4}},
            "full": "vanilla",
            "half": {"technique": "vanilla", "rate_hz": 120},
            "dense": "temporally_dense",
        },
        "questions": {
            "closer": {"kind": "choice", "text": "Which is closer?"},
            "clean": {"kind": "likert", "text": "It was clean."},
        },
        "blocks": [pairs(), rating()],
        **over,
    }
    return Study.model_validate_json(json.dumps(data))


def pairs(**over: Any) -> dict[str, Any]:
    """A block of comparisons."""
    return {
        "name": "pairs",
        "kind": "side_by_side",
        "reference": "gold",
        "compare": {"of": ["full", "half", "dense"]},
        "factors": {"scene": ["a", "b"]},
        "questions": ["closer"],
        **over,
    }


def rating(**over: Any) -> dict[str, Any]:
    """A block of ratings."""
    return {
        "name": "rating",
        "kind": "likert",
        "factors": {"scene": ["a", "b"], "condition": ["full", "half", "dense"]},
        "questions": ["clean"],
        "repetitions": 2,
        **over,
    }
