"""``studyapp techniques``: what there is to compare, with every parameter."""

from __future__ import annotations

import argparse
import json
from typing import Any

from renderers.catalogue import CATALOGUE, Entry

HELP = "list techniques, their parameters, ranges, defaults and accuracy knobs"
EXAMPLE = "studyapp techniques --json"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--json", action="store_true", help="as JSON, parameters as JSON Schema")


def run(args: argparse.Namespace) -> int:
    """Print the catalogue."""
    described = {name: describe(entry) for name, entry in CATALOGUE.items()}
    if args.json:
        print(json.dumps(described, indent=1))
        return 0
    for name, what in described.items():
        marks = [word for word in ("gaze_contingent", "headset", "framed", "baseline") if what[word]]
        print(f"{name}" + (f"  ({', '.join(marks)})" if marks else ""))
        print(f"  {what['summary']}")
        for parameter in what["parameters"]:
            knob = "  [knob]" if parameter["knob"] else ""
            head = f"    {parameter['name']:<24} {parameter['type']:<28} default {parameter['default']}"
            print(head + (f"  {parameter['range']}" if parameter["range"] else "") + knob)
            if parameter["description"]:
                print(f"      {parameter['description']}")
    return 0


def describe(entry: Entry) -> dict[str, Any]:
    """One technique as plain values: summary, flags, knobs, parameters, and the parameters' JSON Schema."""
    schema = entry.params.model_json_schema()
    parameters = []
    for name, field in schema.get("properties", {}).items():
        parameters.append(
            {
                "name": name, "type": _type(field, schema), "default": field.get("default"), "range": _range(field),
                "knob": name in entry.knobs, "description": field.get("description", ""),
            }
        )  # fmt: skip
    return {
        "summary": entry.summary,
        "gaze_contingent": entry.gaze_contingent,
        "headset": entry.headset,
        "framed": entry.framed,
        "baseline": entry.baseline,
        "knobs": {name: list(values) for name, values in entry.knobs.items()},
        "parameters": parameters,
        "schema": schema,
    }


def _type(field: dict[str, Any], schema: dict[str, Any]) -> str:
    if "enum" in field:
        return " | ".join(str(choice) for choice in field["enum"])
    if "const" in field:
        return str(field["const"])
    if "anyOf" in field:
        return " | ".join(_type(part, schema) for part in field["anyOf"])
    if "$ref" in field:
        return _type(schema["$defs"][field["$ref"].rsplit("/", 1)[-1]], schema)
    if field.get("type") == "array":
        parts = field.get("prefixItems")
        return "[" + ", ".join(_type(part, schema) for part in parts) + "]" if parts else "list"
    return {"integer": "whole number", "null": "none", "string": "text"}.get(
        field.get("type", ""), field.get("type", "any")
    )


def _range(field: dict[str, Any]) -> str:
    """The bounds in words: ``> 0, <= 4096``; '' where there are none."""
    signs = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
    parts = [field, *field.get("anyOf", [])]
    return ", ".join(f"{sign} {part[key]}" for part in parts for key, sign in signs.items() if key in part)
