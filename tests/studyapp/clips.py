"""Clips in memory for tests of the presenter, and a responder whose presses are scripted on the display's clock."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from protocols.trial import Panel, Trial
from studyapp.display.choose import open_display
from studyapp.seams import Display, Press


class NumberedClip:
    """A FrameSource whose every pixel of frame i has the code (i mod 251, panel, 255 - i mod 251)."""

    def __init__(
        self, rate_hz: int | Fraction, frame_count: int, size_px: tuple[int, int] = (32, 24), panel: int = 0
    ) -> None:
        self.size_px, self.rate_hz, self.frame_count = size_px, Fraction(rate_hz), frame_count
        self.asked: list[int] = []
        self._panel = panel
        self._frame = np.full((size_px[1], size_px[0], 4), 255, np.uint8)

    def frame(self, index: int) -> np.ndarray:
        self.asked.append(index)
        self._frame[..., 0], self._frame[..., 1], self._frame[..., 2] = index % 251, self._panel, 255 - index % 251
        return self._frame


class ScriptedResponder:
    """Presses at given times of the display's clock; `after` schedules one from an onset."""

    name = "scripted"

    def __init__(self, display: Display, presses: list[tuple[int, str]] | None = None) -> None:
        self._display = display
        self._coming = sorted(presses or [])
        self.there = True

    def after(self, delay_s: float, key: str):
        """An ``on_onset`` that presses ``key`` so long after it."""

        def on_onset(onset_ns: int) -> None:
            self._coming.append((onset_ns + round(delay_s * 1e9), key))
            self._coming.sort()

        return on_onset

    def next_press_ns(self) -> int | None:
        return self._coming[0][0] if self._coming else None

    def poll(self) -> list[Press]:
        now, pressed = self._display.now_ns(), []
        while self._coming and self._coming[0][0] <= now:
            at, key = self._coming.pop(0)
            pressed.append(Press(key, at, at, self.name))
        return pressed

    def alive(self) -> bool:
        return self.there


def trial(*slots: str, duration_s: float = 0.25, fixation: str = "free") -> Trial:
    """Panels in these slots, side by side."""
    panels = tuple(Panel(slot, "c", "t") for slot in slots)
    return Trial(0, "b", "side_by_side", panels=panels, duration_s=duration_s, fixation=fixation)


class Watched:
    """An off-screen display that keeps a pixel of every panel at each flip."""

    def __init__(self, points: list[tuple[int, int]]) -> None:
        self._display = open_display("offscreen", (320, 60), 120)
        self.points, self.seen = points, []

    def __getattr__(self, name: str):
        return getattr(self._display, name)

    def flip(self):
        picture = self._display.read_pixels()
        self.seen.append([picture[y, x].tolist() for x, y in self.points])
        return self._display.flip()
