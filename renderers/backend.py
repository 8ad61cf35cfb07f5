"""Dr.Jit and Mitsuba, with a compiler that works and one variant for the whole process.

Dr.Jit on CPUs needs an LLVM shared library of version 15 or newer; Debian 12's own 15 aborts on AVX-512 machines, so
the newest that the system has is named before Dr.Jit is imported. Mitsuba's variant is global by its nature: it is set
here, once, and nowhere else (the one exception to "no global state"). Import ``dr`` and ``mi`` from here.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stimuli.errors import InputError, problem

_OLDEST_LLVM = 15
_LLVM_LINE = re.compile(r"\s*libLLVM[-.](?:so\.)?(\d+)[^ ]*\s.*=>\s*(\S+)")


def newest_llvm(listing: str) -> str | None:
    """The path of the newest usable LLVM in the text that ``ldconfig -p`` prints; None where there is none."""
    found = [(int(m[1]), m[2]) for m in map(_LLVM_LINE.match, listing.splitlines()) if m]
    usable = [entry for entry in found if entry[0] >= _OLDEST_LLVM]
    return max(usable, key=lambda entry: entry[0])[1] if usable else None


def _library_listing() -> str:
    """What ``ldconfig -p`` prints; empty on systems without it (macOS, Windows: Dr.Jit then searches for itself)."""
    tool = shutil.which("ldconfig") or next(
        (p for p in ("/sbin/ldconfig", "/usr/sbin/ldconfig") if Path(p).exists()), None
    )
    if tool is None:
        return ""
    return subprocess.run([tool, "-p"], capture_output=True, text=True, check=False).stdout


if "DRJIT_LIBLLVM_PATH" not in os.environ and (_llvm := newest_llvm(_library_listing())):
    os.environ["DRJIT_LIBLLVM_PATH"] = _llvm  # Dr.Jit reads it when it is imported, below

# Numba's OpenMP threads would spin for some 14 ms (300,000 pauses) after each parallel loop, on the cores that Dr.Jit's
# threads want. On two cores: a frame of adaptive_frameless 42 ms instead of 34 (256x256, 400,000 samples a second), one
# of foveated 90 instead of 76 (1182x1464). OpenMP reads this when numba runs its first parallel loop.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import drjit  # noqa: E402
import mitsuba  # noqa: E402

dr: Any = drjit  # their types depend on the variant, so their stubs can only describe one
mi: Any = mitsuba

__all__ = ["activate", "cores_for_numba", "dr", "is_cuda", "mi", "newest_llvm"]

_VARIANTS = {"cuda": "cuda_ad_rgb", "llvm": "llvm_ad_rgb"}


def activate(device: str = "auto") -> str:
    """Set Mitsuba's variant ('auto': CUDA where there is a GPU, else LLVM) and return it; later calls must agree.

    Raises InputError for an unknown device, a device that is not there, or one that differs from the one in use.
    """
    if device not in ("auto", *_VARIANTS):
        raise InputError(problem("device", "unknown device", repr(device), "auto | cuda | llvm"))
    current = mi.variant()
    if current is not None:
        if device != "auto" and current != _VARIANTS[device]:
            raise InputError(problem("device", "one device a process", device, f"{current}, already in use"))
        return current
    has = {"cuda": dr.has_backend(dr.JitBackend.CUDA), "llvm": dr.has_backend(dr.JitBackend.LLVM)}
    chosen = ("cuda" if has["cuda"] else "llvm") if device == "auto" else device
    if not has[chosen]:
        wanted = "an NVIDIA driver" if chosen == "cuda" else "LLVM 15 or newer (Debian: apt-get install libllvm19)"
        raise InputError(problem("device", f"{chosen} is not usable here", "no library", wanted))
    mi.set_variant(_VARIANTS[chosen])
    return _VARIANTS[chosen]


def is_cuda() -> bool:
    """Whether the variant in use runs on a GPU."""
    return str(mi.variant()).startswith("cuda")


@contextmanager
def cores_for_numba() -> Iterator[None]:
    """Inside, Dr.Jit's kernels are done and it has no threads beside the caller's: between kernels they would spin on
    the cores that a parallel numba loop wants. On two cores `span_rasteriser._draw` takes 5.1 ms so, 9.9 otherwise;
    going and coming back take 0.15.
    """
    dr.sync_thread()
    threads = dr.thread_count()
    if threads <= 1:
        yield
        return
    dr.set_thread_count(1)
    try:
        yield
    finally:
        dr.set_thread_count(threads)
