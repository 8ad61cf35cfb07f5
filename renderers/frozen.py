"""Frozen Dr.Jit kernels behind one wrapper that keeps clear of their traps.

`dr.freeze` records a function once and replays its kernels. Everything on the device that the function reads must come
in as an argument (closures are not looked into); Python numbers among the arguments are part of the recording. A
zero-width argument aborts the process, so a call without lanes never reaches the recording.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.trap import active_trap, look_into

MAX_RECORDINGS = 32
"""More recordings than this of one kernel mean that a changing Python value slipped in (each costs 0.1 to 1 s).

A call whose lane count happens to equal another argument's width is recorded anew too, so a few are honest.
"""


def plain_values(value: Any) -> str:
    """The Python values inside ``value`` (numbers, strings, settings), in order, as one string.

    Dr.Jit 1.5 keys a recording by the *set* of Python objects among its arguments: ``f(x, 1, 2, 1)`` replays what was
    recorded for ``f(x, 1, 2, 2)``, silently, because the last 1 was met before. This string is a new object each time.
    """
    kind: Any = type(value)
    names = _field_names(kind)
    if names is not None:
        return f"{kind.__name__}({','.join([plain_values(getattr(value, name)) for name in names])})"
    if kind in _PLAIN:
        return repr(value)
    if kind is tuple or kind is list:
        return f"[{','.join([plain_values(item) for item in value])}]"
    if kind is dict:
        return f"{{{','.join([f'{key!r}:{plain_values(item)}' for key, item in value.items()])}}}"
    if isinstance(value, int | float | str):  # numpy's floats, enumerations
        return repr(value)
    if isinstance(value, tuple | list):  # named tuples
        return f"{kind.__name__}[{','.join([plain_values(item) for item in value])}]"
    return kind.__name__


_PLAIN = frozenset({type(None), bool, int, float, str})


@cache
def _field_names(kind: type) -> tuple[str, ...] | None:
    """What is looked into in a value of this type by name (Dr.Jit structures, dataclasses); None: it has no names."""
    if hasattr(kind, "DRJIT_STRUCT"):
        return tuple(kind.DRJIT_STRUCT)
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else None


class Frozen:
    """A frozen function. Call it with ``lanes``, the number of lanes of this call, then the function's arguments.

    Returns the function's result, or None where ``lanes`` is 0 (nothing ran). The function's results of width 1 and
    of other widths are separate recordings. Raises RuntimeError where it was recorded more than ``max_recordings``
    times: a caller's bug that would show only as slowness.
    """

    def __init__(self, function: Callable[..., Any], max_recordings: int = MAX_RECORDINGS) -> None:
        self.name = getattr(function, "__qualname__", repr(function))
        self.max_recordings = max_recordings
        self._function = dr.freeze(function, warn_after=10_000, state_fn=lambda *arguments: [plain_values(arguments)])

    @property
    def recordings(self) -> int:
        """How often the function has been recorded so far."""
        return self._function.n_recordings

    def __call__(self, lanes: int, *arguments: Any) -> Any:
        if lanes == 0:
            return None
        # A garbage collection in the middle of a recording may free another scene or frozen kernel: Dr.Jit then aborts.
        collecting = gc.isenabled()
        gc.disable()
        try:
            result = self._function(*arguments)
        finally:
            if collecting:
                gc.enable()
        if self.recordings > self.max_recordings:
            raise RuntimeError(
                f"{self.name}: recorded {self.recordings} times; a Python value changes from call to call"
            )
        trap = active_trap()
        if trap is not None:
            look_into(trap, self.name, result)
        return result


def frozen(function: Callable[..., Any], max_recordings: int = MAX_RECORDINGS) -> Frozen:
    """``function`` as a `Frozen` kernel."""
    return Frozen(function, max_recordings)


_ALIGNMENT_BYTES = 64


def aligned(values: Any, kind: Any) -> np.ndarray:
    """``values`` flat, as ``kind``, at an address that is a multiple of 64 bytes.

    Dr.Jit maps numpy memory as it is, and whether it is aligned is part of a recording.
    """
    flat = np.asarray(values, kind).ravel()
    room = np.empty(flat.nbytes + _ALIGNMENT_BYTES, np.uint8)
    start = -room.ctypes.data % _ALIGNMENT_BYTES
    place = room[start : start + flat.nbytes].view(kind)
    place[:] = flat
    return place


def opaque_float(values: Any) -> Any:
    """A Float array that lies in memory: its values may change from call to call without a new recording."""
    return mi.Float(aligned(values, np.float32))


def opaque_uint(values: Any) -> Any:
    """The same for UInt32."""
    return mi.UInt32(aligned(values, np.uint32))
