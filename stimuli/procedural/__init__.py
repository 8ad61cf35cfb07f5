"""Procedural scenes, one file each; SCENES maps a name to its builder (the file is imported when it is called).

Importing this package loads neither pyrender nor numpy, so that study checks may ask for the names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stimuli.scene import Scene

_NAMES = (
    "tunnel_geom",
    "tunnel_maps",
    "toy_car",
    "bar",
    "voxel_city",
    "living_room",
    "hairball",
    "robot",
    "mixed_reality_room",
)


def _builder(name: str) -> Callable[[], Scene]:
    def build() -> Scene:
        scene: Scene = import_module(f"stimuli.procedural.{name}").build()
        return scene

    build.__name__ = build.__qualname__ = name
    build.__doc__ = f"The procedural scene {name!r}."
    return build


SCENES: Mapping[str, Callable[[], Scene]] = {name: _builder(name) for name in _NAMES}
"""Name -> builder without arguments; the same scene, byte for byte, on every call."""
