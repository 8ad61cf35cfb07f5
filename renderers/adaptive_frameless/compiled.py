"""How the control is compiled, and what numba does not see: that a function it calls in another file has changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numba import njit

_njit: Any = njit  # its stubs do not know _nrt

uncounted: Any = _njit(cache=True, _nrt=False)
"""Without numba's reference counts: code that is handed 27 arrays and takes views of them spent half its time on them
(19.7 instead of 9.5 ms a refresh at 400k samples/s). Such code cannot allocate: numba then refuses to compile it."""
inlined: Any = _njit(cache=True, forceinline=True, _nrt=False)
"""The same, for what is small and called often."""
SOURCES = (
    "balance", "buffers", "compiled", "crosshair", "deep_buffer", "rays", "reconstructor", "sampler", "splats",
    "tiling", "visits",
)  # fmt: skip
"""The modules whose code or constants are compiled."""


def drop_stale_code(folder: Path = Path(__file__).parent) -> int:
    """Delete the compiled code of this package that is older than the newest of `SOURCES`; returns how many files.

    Numba looks only at a function's own file. Call this before the first compiled function runs. A process that finds
    a file gone compiles anew.
    """
    newest = max(path.stat().st_mtime for path in folder.glob("*.py") if path.stem in SOURCES)
    dropped = 0
    for path in (folder / "__pycache__").glob("*.nb[ic]"):
        try:
            if path.stat().st_mtime < newest:
                path.unlink()
                dropped += 1
        except FileNotFoundError:
            continue  # another process was first
    return dropped
