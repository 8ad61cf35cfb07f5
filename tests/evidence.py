"""Where the full-length evidence of ``make prove`` goes: one JSON file a module, in ./evidence."""

from __future__ import annotations

import json
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any


def evidence_folder() -> Path:
    """./evidence, made where it is not."""
    folder = Path("evidence")
    folder.mkdir(exist_ok=True)
    return folder


def write_evidence(name: str, found: object, path: str | Path | None = None) -> Path:
    """Write ``found`` (JSON-ready; dataclasses inside are taken apart) to evidence/NAME.json, or to ``path``."""
    out = evidence_folder() / f"{name}.json" if path is None else Path(path)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(found, indent=1, default=_plain) + "\n", encoding="utf-8")
    return out


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    raise TypeError(f"evidence: cannot write a {type(value).__name__}")
