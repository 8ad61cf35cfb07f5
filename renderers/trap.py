"""Debug mode: nan and inf are trapped at each stage, inside the engine's kernels and in what every kernel returns.

`Engine(debug=True)` counts, on the device and in the stage where it first can be seen, every active lane whose value is
not finite; `trapping` looks at the results of every frozen kernel (each stage of a technique is one). Neither changes a
pixel. A miss's distance is inf by its meaning and passes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np

STAGES = ("camera ray", "hit", "surface", "shading", "mirrors and glass", "motion")
"""The engine's own stages, in the order of `Engine.trapped`."""
_INFINITE_BY_MEANING = ("t", "z")


@dataclass
class Trapped:
    """What was found: the kernel and the place in its result -> how many values were not finite."""

    found: dict[str, int] = field(default_factory=dict)


_TRAP: ContextVar[Trapped | None] = ContextVar("trap", default=None)


@contextmanager
def trapping() -> Iterator[Trapped]:
    """Within it, every result of every frozen kernel is looked at (slow: all of it is copied to the host)."""
    trapped = Trapped()
    token = _TRAP.set(trapped)
    try:
        yield trapped
    finally:
        _TRAP.reset(token)


def active_trap() -> Trapped | None:
    """The trap that stands now, or None."""
    return _TRAP.get()


def look_into(trapped: Trapped, kernel: str, result: Any) -> None:
    """Count the values of ``result`` (any PyTree) that are not finite."""
    for place, values in _floats(result, ""):
        wrong = np.isnan(values) if place.rsplit(".", 1)[-1] in _INFINITE_BY_MEANING else ~np.isfinite(values)
        if wrong.any():
            name = f"{kernel}{place}"
            trapped.found[name] = trapped.found.get(name, 0) + int(wrong.sum())


def _floats(value: Any, place: str) -> Iterator[tuple[str, np.ndarray]]:
    """Every array of floats in a PyTree, with the way to it."""
    if value is None or isinstance(value, str | bytes | bool | int | float):
        return
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _floats(item, f"{place}.{name}")
    elif isinstance(value, tuple | list):
        for k, item in enumerate(value):
            yield from _floats(item, f"{place}[{k}]")
    elif is_dataclass(value):
        for f in fields(value):
            yield from _floats(getattr(value, f.name), f"{place}.{f.name}")
    elif hasattr(value, "numpy"):
        values = np.asarray(value.numpy())
        if values.dtype.kind == "f":
            yield place, values
