"""An off-screen buffer paced by an absolute timer grid: the display where there is no window.

Refresh k is due at exactly ``start + k / rate``: late work loses refreshes, it never moves the grid (phase-true).
The wait sleeps while it can and reads the clock at the end; the stamp's class is ``timer``.
"""

from __future__ import annotations

import time
from fractions import Fraction
from typing import Any

import moderngl
import numpy as np

from studyapp.clock import now_ns
from studyapp.display.vblank import grid_time_ns, wait_until
from studyapp.seams import Flip, StampClass

SPIN_NS = 400_000
"""Spun instead of slept at the end of a wait: what Linux's timer slack and wake-up take in the worst usual case."""

_BACKEND: dict[str, Any] = {"backend": "egl"}


class OffscreenDisplay:
    """See the module. ``size_px`` (width, height) in [1, 16384]; ``rate_hz`` in [20, 1000]."""

    stamp_class: StampClass = "timer"
    stamp_source = "timer grid, clock"
    counts_refreshes = True

    def __init__(self, size_px: tuple[int, int] = (1920, 1080), rate_hz: Fraction | int = 240) -> None:
        self.size_px = size_px
        self.nominal_hz = Fraction(rate_hz)
        self._gl = moderngl.create_context(standalone=True, require=330, **_BACKEND)
        self.renderer = str(self._gl.info["GL_RENDERER"])
        self.description = (
            f"off-screen buffer, {size_px[0]}x{size_px[1]}, timer at {float(self.nominal_hz):g} Hz, {self.renderer}"
        )
        self.framebuffer = self._gl.framebuffer([self._gl.renderbuffer(size_px, 4)])
        self.framebuffer.use()
        self._start_ns = 0
        self._index = -1
        self._closed = False

    @property
    def period_ns(self) -> float:
        """The timer's period."""
        return float(1_000_000_000 / self.nominal_hz)

    def context(self) -> moderngl.Context:
        """The context whose bound framebuffer is shown."""
        return self._gl

    def now_ns(self) -> int:
        """The session clock."""
        return now_ns()

    def flip(self) -> Flip:
        """Finish drawing, wait for the first grid time that is still ahead, stamp it."""
        self._gl.finish()
        submitted = now_ns()
        if self._index < 0:
            self._start_ns, self._index = submitted, 0
            return Flip(0, submitted, submitted, submitted, 0)
        elapsed = submitted - self._start_ns
        passed = elapsed * self.nominal_hz.numerator // (1_000_000_000 * self.nominal_hz.denominator)
        index = max(self._index + 1, passed + 1)
        due = grid_time_ns(self._start_ns, index, self.nominal_hz)
        shown = wait_until(due, now_ns, time.sleep, SPIN_NS)
        # The machine may have slept through whole refreshes while we waited.
        late = (shown - due) * self.nominal_hz.numerator // (1_000_000_000 * self.nominal_hz.denominator)
        if late:
            index += late
            due = grid_time_ns(self._start_ns, index, self.nominal_hz)
        missed = index - self._index - 1
        self._index = index
        return Flip(index, due, submitted, shown, missed)

    def keys(self) -> list[tuple[str, int]]:
        """No keyboard."""
        return []

    def read_pixels(self) -> np.ndarray:
        """(H, W, 3) uint8 of what is in the buffer, row 0 at the top."""
        raw = self.framebuffer.read(components=3, alignment=1)
        picture = np.frombuffer(raw, np.uint8).reshape(self.size_px[1], self.size_px[0], 3)
        return np.ascontiguousarray(picture[::-1])

    def close(self) -> None:
        """Release the context."""
        if not self._closed:
            self._closed = True
            self.framebuffer.release()
            self._gl.release()
