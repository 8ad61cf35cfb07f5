"""Numba's compiled code on disk, and what numba does not see: that a function it calls in another file has changed."""

from __future__ import annotations

from pathlib import Path

SOURCES = (
    "balance", "buffers", "crosshair", "deep_buffer", "rays", "reconstructor", "sampler", "splats", "tiling", "visits",
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
