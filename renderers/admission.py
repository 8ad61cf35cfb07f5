"""Is there memory for a clip of this size? Asked before anything is allocated: the answer is a line, not a kill.

Bytes a pixel were measured (peak of the process at 1600x1200 over 128x128, three frames of tunnel_geom, LLVM backend:
reference 126, vanilla 61, taa 104, temporally_dense 133, checkerboard 98, framed_low_resolution 33, framed_low_rate 61,
traditional_frameless 218, adaptive_frameless 560, foveated 215, polar 56) and are taken a quarter larger here.
"""

from __future__ import annotations

from collections.abc import Mapping

from stimuli.errors import InputError, problem

BYTES_PER_PX: Mapping[str, int] = {
    "reference": 160,
    "vanilla": 80,
    "taa": 130,
    "temporally_dense": 170,
    "checkerboard": 125,
    "framed_low_resolution": 80,
    "framed_low_rate": 80,
    "traditional_frameless": 280,
    "adaptive_frameless": 700,
    "foveated": 270,
    "polar": 80,
}
_UNKNOWN = 700  # an external technique: as the largest of ours
_MOST_LANES = 1 << 32  # pixel numbers are 32-bit


def bytes_needed(technique: str, size_px: tuple[int, int]) -> int:
    """Bytes that ``technique`` takes for a picture of ``size_px``, its buffers and one frame's intermediate results."""
    return size_px[0] * size_px[1] * BYTES_PER_PX.get(technique, _UNKNOWN)


def free_bytes() -> int:
    """Bytes of main memory that can be had without swapping."""
    import psutil

    return int(psutil.virtual_memory().available)


def admit(technique: str, size_px: tuple[int, int], available: int | None = None) -> None:
    """Raise InputError, with the bytes needed, where a picture does not fit in memory (default: what is free now)."""
    needed, there = bytes_needed(technique, size_px), free_bytes() if available is None else available
    size = f"{size_px[0]}x{size_px[1]}"
    if size_px[0] * size_px[1] >= _MOST_LANES:
        raise InputError(problem("size_px", "picture size", size, f"fewer than {_MOST_LANES} pixels"))
    if needed > there:
        got = f"{size}, for which {technique} needs {needed} bytes ({needed / 1e9:.1f} GB)"
        raise InputError(problem("size_px", "picture size", got, f"what fits in the {there} bytes that are free"))
