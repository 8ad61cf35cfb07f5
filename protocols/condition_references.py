"""What conditions name: techniques, their parameters, rates, and what they are matched by."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any

from pydantic import ValidationError

from protocols.names import Declared, Loc, Problem, unknown
from protocols.study import Study
from renderers.catalogue import CATALOGUE


def condition_problems(study: Study) -> Iterator[Problem]:
    """Unknown techniques, rates that do not divide the display's, parameters that a technique refuses."""
    if isinstance(study.techniques, list):
        for index, name in enumerate(study.techniques):
            if name not in CATALOGUE and name not in study.conditions:
                yield unknown(("techniques", index), f"techniques[{index}]", name, list(CATALOGUE))
    refresh = Fraction(study.display.refresh_hz)
    for name, condition in study.conditions.items():
        loc, what = ("conditions", name), f"conditions.{name}"
        if condition.rate_hz is not None and (refresh / Fraction(condition.rate_hz)).denominator != 1:
            wanted = f"{study.display.refresh_hz} divided by a whole number (the display's refresh rate)"
            yield (*loc, "rate_hz"), f"{what}.rate_hz", condition.rate_hz, wanted
        if condition.external:
            continue
        if condition.technique not in CATALOGUE:
            yield unknown((*loc, "technique"), f"{what}.technique", condition.technique, list(CATALOGUE))
            continue
        yield from parameter_problems(condition.technique, condition.params, (*loc, "params"), f"{what}.params")
        if condition.reference_error is not None and not CATALOGUE[condition.technique].averages:
            able = " | ".join(n for n, entry in CATALOGUE.items() if entry.averages)
            got = f"in a condition of {condition.technique}"
            yield (*loc, "reference_error"), f"{what}.reference_error", got, f"it in one of {able}"


def channel_problems(study: Study) -> Iterator[Problem]:
    """Conditions whose frames cannot say how often each pixel was sampled, where that is to be stored."""
    tables = [study.defaults, *study.scenes.values()]
    for block in study.blocks:
        tables += [block.set, *(level for levels in block.factors.values() for level in levels.values())]
    asked = any("samples" in (table.channels or ()) for table in tables)
    able = [name for name, entry in CATALOGUE.items() if entry.counts_samples]
    for name, condition in study.all_conditions().items():
        wanted = asked if condition.channels is None else "samples" in condition.channels
        if wanted and not condition.external and condition.technique in CATALOGUE and condition.technique not in able:
            said = f"channels of its own without samples (which {' | '.join(able)} have)"
            yield ("conditions", name, "channels"), f"conditions.{name}", "channels: samples", said


def parameter_problems(technique: str, params: Mapping[str, Any], loc: Loc, what: str) -> Iterator[Problem]:
    """Unknown parameters, wrong types and values out of range, by the technique's own model."""
    model = CATALOGUE[technique].params
    try:
        model.model_validate_json(json.dumps(params), strict=True)
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            key = str(detail["loc"][0]) if detail["loc"] else ""
            if detail["type"] == "extra_forbidden":
                yield unknown((*loc, key), f"{what}.{key}", key, list(model.model_fields))
            else:
                said = detail["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
                yield (*loc, key), f"{what}.{key}".rstrip("."), repr(detail["input"])[:60], said[0].lower() + said[1:]


def match_problems(study: Study, names: Declared) -> Iterator[Problem]:
    """Conditions and knobs under ``match`` that do not exist."""
    shown = study.all_conditions()
    for index, match in enumerate(study.match):
        loc: Loc = ("match", index)
        what = f"match[{index}]"
        for place, word in enumerate(match.conditions):
            yield from names.condition(word, (*loc, "conditions", place), f"{what}.conditions[{place}]")
        if match.to is not None:
            yield from names.condition(match.to, (*loc, "to"), f"{what}.to")
        for place, knob in enumerate(match.knobs):
            at: Loc = (*loc, "knobs", place)
            said = f"{what}.knobs[{place}]"
            yield from names.condition(knob.condition, (*at, "condition"), f"{said}.condition")
            technique = shown[knob.condition].technique if knob.condition in shown else ""
            if technique in CATALOGUE and knob.parameter not in CATALOGUE[technique].params.model_fields:
                fields = list(CATALOGUE[technique].params.model_fields)
                yield unknown((*at, "parameter"), f"{said}.parameter", knob.parameter, fields)
