"""The seams of the lab: what displays, frame sources, response devices and logs are to each other."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Literal, Protocol

import numpy as np

StampClass = Literal["hardware", "software", "timer", "virtual"]


@dataclass(frozen=True)
class Flip:
    """One refresh as the display saw it; ``index`` counts the display's refreshes, ``missed`` those lost before it."""

    index: int
    due_ns: int
    submitted_ns: int
    shown_ns: int
    missed: int
    flags: int = 0


class Display(Protocol):
    """Something that shows one picture per refresh and says when. Units: pixels, metres, session nanoseconds."""

    size_px: tuple[int, int]
    nominal_hz: Fraction
    stamp_class: StampClass
    description: str

    def context(self) -> object:
        """The moderngl.Context that draws to this display (None for the virtual display)."""
        ...

    def flip(self) -> Flip:
        """Show what was drawn at the next refresh, wait for it, and stamp it. Nothing else happens in here."""
        ...

    def now_ns(self) -> int:
        """The clock this display stamps with: the session clock, or the virtual display's own."""
        ...

    def keys(self) -> list[tuple[str, int]]:
        """Key presses since the last call: (key name, session ns). Empty where the display has no keyboard."""
        ...

    def read_pixels(self) -> np.ndarray:
        """(H, W, 3) uint8 of the picture last drawn, row 0 at the top (screenshots, tests)."""
        ...

    def close(self) -> None:
        """Give everything back. Twice is harmless."""
        ...


class FrameSource(Protocol):
    """A clip as the presenter sees it, stored or live: display-encoded RGBA8 frames by index."""

    size_px: tuple[int, int]
    rate_hz: Fraction
    frame_count: int

    def frame(self, index: int) -> np.ndarray:
        """(H, W, 4) uint8, C-contiguous, row 0 at the top; valid until the next call."""
        ...


@dataclass(frozen=True)
class Press:
    """A decoded press. ``host_ns``: when our reader had the last byte; ``mapped_ns``: the device's stamp on the session
    clock (where it has none, host_ns less a byte's time on the line); ``raw``: the very bytes it was decoded from."""

    key: str
    host_ns: int
    mapped_ns: int
    device: str
    device_stamp: float | None = None
    raw: bytes = b""


class Responder(Protocol):
    """Where answers come from: a keyboard, a box read by another process, a simulated observer's box."""

    name: str

    def poll(self) -> list[Press]:
        """Presses since the last call, without waiting; cheap enough for every refresh."""
        ...

    def alive(self) -> bool:
        """False once the device has vanished."""
        ...


class GazeSource(Protocol):
    """The newest gaze sample, from another process's shared memory."""

    name: str

    def newest(self) -> tuple[float, float, int, bool] | None:
        """(x_dva, y_dva, mapped_ns, valid), or None before the first sample."""
        ...

    def alive(self) -> bool:
        """False once the device has vanished."""
        ...


class FlipSink(Protocol):
    """Where per-refresh rows go: a shared-memory ring that a writer process drains. Never blocks, never allocates."""

    def put(self, row: np.ndarray) -> None:
        """Copy FLIP_DTYPE rows in: an (N,) block (one row in the frame loop, a whole phase on the virtual display)."""
        ...
