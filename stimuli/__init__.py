"""What is shown: scenes, camera paths, clips on disk. Public names are resolved on first use (PEP 562)."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PUBLIC = {
    "load_scene": "stimuli.load",
    "SCENES": "stimuli.procedural",
    "Scene": "stimuli.scene",
    "InputError": "stimuli.errors",
}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'stimuli' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)
