"""Open a display by the kind's name."""

from __future__ import annotations

from fractions import Fraction
from typing import Literal, get_args

from stimuli.errors import InputError, problem
from studyapp.seams import Display

DisplayKind = Literal["glfw", "offscreen", "virtual"]


def open_display(
    kind: str, size_px: tuple[int, int] = (1920, 1080), rate_hz: Fraction | int = 240, monitor: int | None = None
) -> Display:
    """A display of ``kind``; ``rate_hz`` is the rate asked of it. glfw: fullscreen on ``monitor`` (its number), or a
    window where that is None. Raises InputError on unknown kinds and on sizes or rates out of range."""
    if kind not in get_args(DisplayKind):
        raise InputError(problem("display", "kind", kind, " | ".join(get_args(DisplayKind))))
    if not (20 <= rate_hz <= 1000):
        raise InputError(problem("display", "rate", f"{float(rate_hz):g} Hz", "20 to 1000 Hz"))
    if not all(1 <= side <= 16384 for side in size_px):
        raise InputError(problem("display", "size", "{}x{}".format(*size_px), "1 to 16384 pixels a side"))
    # Only the display that is opened is imported: glfw opens its library on import.
    if kind == "virtual":
        from studyapp.display.virtual_display import VirtualDisplay

        return VirtualDisplay(size_px, rate_hz)
    if kind == "offscreen":
        from studyapp.display.offscreen_display import OffscreenDisplay

        return OffscreenDisplay(size_px, rate_hz)
    from studyapp.display.glfw_display import GlfwDisplay

    return GlfwDisplay(size_px, rate_hz, monitor)
