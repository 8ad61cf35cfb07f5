"""The stamp ladder: the best available answer to 'when was this swap on the screen', probed at run time.

1. ``hardware``: GLX_OML_sync_control (`glXWaitForSbcOML`): the kernel's own vblank time stamp.
2. ``software``: a token drawn behind the swap, glFinish, then the clock: when the swap was seen to be over.

Wayland's presentation times are not reachable through GLFW; such windows stand on the second rung.
Sanity as Psychtoolbox checks it: ust and msc not 0, no stamp before its swap was requested, msc advancing.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from itertools import pairwise
from typing import Protocol

import moderngl

from studyapp.clock import now_ns
from studyapp.seams import StampClass

PROBE_SWAPS = 8
BEFORE_REQUEST_NS = 1_000_000
"""A stamp this much before the swap's own request is nonsense."""


class StampSource(Protocol):
    """One rung of the ladder."""

    name: str
    stamp_class: StampClass
    faults: int

    def after_swap(self, requested_ns: int) -> int:
        """Wait until the swap requested at ``requested_ns`` is done; when it was shown, session nanoseconds."""
        ...


class FenceStamp:
    """Software rung. The token keeps drivers from returning before the swap: the back buffer has to be there."""

    stamp_class: StampClass = "software"
    name = "swap, one-pixel token, glFinish, clock"

    def __init__(self, gl: moderngl.Context) -> None:
        self._gl = gl
        self.faults = 0

    def after_swap(self, requested_ns: int) -> int:
        """See `StampSource`."""
        self._gl.scissor = (0, 0, 1, 1)
        self._gl.clear(0.0, 0.0, 0.0, 1.0)
        self._gl.scissor = None
        self._gl.finish()
        return now_ns()


WaitForSbc = Callable[[], tuple[int, int, int] | None]
"""() -> (ust in microseconds, msc, sbc) of the newest finished swap, None where the driver reports failure."""


class OmlStamp:
    """Hardware rung: OML's ust is CLOCK_MONOTONIC in microseconds on Linux, the session clock's own base."""

    stamp_class: StampClass = "hardware"
    name = "GLX_OML_sync_control"

    def __init__(self, wait: WaitForSbc) -> None:
        self._wait = wait
        self.faults = 0
        self.msc = 0

    def after_swap(self, requested_ns: int) -> int:
        """See `StampSource`; a stamp that fails the sanity checks is counted and replaced by the clock's."""
        answer = self._wait()
        now = now_ns()
        if answer is None:
            self.faults += 1
            return now
        ust, msc, _ = answer
        shown = ust * 1000
        if ust <= 0 or msc <= 0 or msc < self.msc or shown < requested_ns - BEFORE_REQUEST_NS or shown > now:
            self.faults += 1
            return now
        self.msc = msc
        return shown


def oml_wait(get_proc_address: Callable[[str], int | None], x11_display: int, glx_window: int) -> WaitForSbc | None:
    """`glXWaitForSbcOML` of this window by ctypes; None where the driver does not export it."""
    address = get_proc_address("glXWaitForSbcOML")
    if not address:
        return None
    long_p = ctypes.POINTER(ctypes.c_int64)
    prototype = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_ulong, ctypes.c_int64, long_p, long_p, long_p)
    function = prototype(address)
    ust, msc, sbc = ctypes.c_int64(), ctypes.c_int64(), ctypes.c_int64()
    references = ctypes.byref(ust), ctypes.byref(msc), ctypes.byref(sbc)

    def wait() -> tuple[int, int, int] | None:
        # target_sbc 0: until every swap requested so far is done.
        if not function(x11_display, glx_window, 0, *references):
            return None
        return ust.value, msc.value, sbc.value

    return wait


def probe(candidates: list[StampSource], swap: Callable[[], None]) -> tuple[StampSource, list[str]]:
    """The first rung that stamps `PROBE_SWAPS` swaps without a fault, and why the others were passed over."""
    refused: list[str] = []
    for source in candidates:
        stamps = []
        for _ in range(PROBE_SWAPS):
            requested = now_ns()
            swap()
            stamps.append(source.after_swap(requested))
        rising = all(later > earlier for earlier, later in pairwise(stamps))
        if source.faults == 0 and rising:
            return source, refused
        what = f"{source.faults} faulty stamps" if source.faults else "stamps that do not rise"
        refused.append(f"{source.name}: {what} in {PROBE_SWAPS} swaps")
    raise RuntimeError("no stamp source works: " + "; ".join(refused))
