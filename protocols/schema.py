"""JSON Schema (2020-12) of protocol files, made from the models; what editors complete and underline by."""

from __future__ import annotations

from typing import Any

from protocols.study import Study


def protocol_schema() -> dict[str, Any]:
    """The schema. Shorthands that `load_study` takes (a scene, a condition or a path as one word, levels and keys as a
    list) and ``extends`` are included; names that must lead somewhere are checked by `studyapp check` alone."""
    schema = Study.model_json_schema(mode="validation")
    definitions = schema["$defs"]
    for name in ("Scene", "Condition"):
        definitions[name] = {"anyOf": [{"type": "string"}, definitions[name]]}
    definitions["CameraKeys"] = {"anyOf": [{"type": "string"}, definitions["CameraKeys"]]}
    factors = definitions["Block"]["properties"]["factors"]
    listed = {"type": "array", "items": {"type": ["string", "number"]}, "minItems": 1}
    tables = factors["patternProperties"]
    factors["patternProperties"] = {key: {"anyOf": [listed, levels]} for key, levels in tables.items()}
    schema["properties"]["extends"] = {"type": "string", "description": "a protocol file that this one varies"}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "studyapp protocol", **schema}
