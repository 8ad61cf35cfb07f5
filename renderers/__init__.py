"""How it is made: one ray engine, the techniques, the measure of speed against accuracy. Names resolve lazily."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PUBLIC = {
    "TECHNIQUES": "renderers.catalogue",
    "Tracer": "renderers.tracer",
    "render_clip": "renderers.clip_frames",
}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'renderers' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)
