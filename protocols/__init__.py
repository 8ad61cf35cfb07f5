"""What is run: study YAML, designs, trial order, and the records a session file holds. Names resolve lazily."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PUBLIC = {"load_study": "protocols.load"}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'protocols' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)
