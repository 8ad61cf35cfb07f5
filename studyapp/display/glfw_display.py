"""A window (or a whole monitor) by GLFW: X11, Wayland, Windows, macOS; paced by the swap interval."""

from __future__ import annotations

import os
from fractions import Fraction
from types import ModuleType
from typing import Any

import moderngl
import numpy as np

from stimuli.errors import InputError, problem
from studyapp.clock import now_ns
from studyapp.display.stamps import FenceStamp, OmlStamp, StampSource, oml_wait, probe
from studyapp.display.vblank import DEADLINE_SLACK, VblankGrid
from studyapp.seams import Flip, StampClass

KEY_NAMES = {
    256: "escape", 257: "return", 258: "tab", 32: "space", 262: "right", 263: "left", 264: "down", 265: "up",
    335: "return", **{320 + digit: str(digit) for digit in range(10)},
}  # fmt: skip
"""GLFW key code -> key name, where the key prints nothing (digits of the number pad count as digits)."""


def import_glfw() -> ModuleType:
    """The glfw module; on Linux the Wayland build where only a Wayland display is there (chosen before the import)."""
    if os.environ.get("WAYLAND_DISPLAY") and not os.environ.get("DISPLAY"):
        os.environ.setdefault("PYGLFW_LIBRARY_VARIANT", "wayland")
    import glfw

    return glfw


class GlfwDisplay:
    """See the module.

    ``monitor`` None: a window of ``size_px``; else fullscreen on that monitor (number in the system's order) at the
    video mode of ``size_px`` and ``rate_hz``. ``nominal_hz`` is the rate that the monitor announces, ``rate_hz`` where
    it announces none. ``keep_pixels`` copies every picture before its swap (screenshots; slow). Raises InputError
    where no display server answers or the mode does not exist (the modes that would serve are named).
    """

    def __init__(
        self,
        size_px: tuple[int, int] = (1280, 720),
        rate_hz: Fraction | int = 240,
        monitor: int | None = None,
        keep_pixels: bool = False,
    ) -> None:
        self._glfw: Any = import_glfw()
        glfw = self._glfw
        said: list[str] = []
        glfw.set_error_callback(lambda code, text: said.append(text.decode(errors="replace")))
        if not glfw.init():
            got = said[-1] if said else "no answer"
            raise InputError(
                problem("display", "glfw", got, "a running X11 or Wayland display, or --display offscreen")
            )
        self._open = True
        try:
            self._window = self._create_window(size_px, Fraction(rate_hz), monitor, said)
        except InputError:
            glfw.terminate()
            raise
        glfw.make_context_current(self._window)
        self._gl = moderngl.create_context(require=330)
        # Mode switches may have reset it, so it is set after the window is up.
        glfw.swap_interval(1)
        self.size_px = tuple(glfw.get_framebuffer_size(self._window))
        self.framebuffer = self._gl.screen
        self.framebuffer.use()
        self.renderer = str(self._gl.info["GL_RENDERER"])
        self._keep = keep_pixels
        self._kept: np.ndarray | None = None
        self._keys: list[tuple[str, int]] = []
        glfw.set_key_callback(self._window, self._on_key)
        stamps, refused = probe(self._ladder(), self._swap)
        self._stamps: StampSource = stamps
        self.stamp_class: StampClass = stamps.stamp_class
        self.stamp_source = stamps.name
        self.warnings = [*self._warnings(), *(f"stamp source passed over: {reason}" for reason in refused)]
        self.grid = VblankGrid(float(1_000_000_000 / self.nominal_hz), DEADLINE_SLACK[self.stamp_class])
        where = "window" if monitor is None else f"fullscreen on monitor {monitor}"
        self.description = (
            f"GLFW {where}, {self.size_px[0]}x{self.size_px[1]}, announced "
            f"{self.announced_hz or 'no rate'}{' Hz' if self.announced_hz else ''}, {self.renderer}"
        )

    @property
    def period_ns(self) -> float:
        """The period in use: announced, or measured once `use_period` was called."""
        return self.grid.period_ns

    def use_period(self, period_ns: float, wandering: bool = False) -> None:
        """Count refreshes on the measured period from here on; ``wandering``: as `VblankGrid` has it."""
        self.grid = VblankGrid(period_ns, DEADLINE_SLACK[self.stamp_class], wandering)

    def context(self) -> moderngl.Context:
        """The window's own context."""
        return self._gl

    def now_ns(self) -> int:
        """The session clock."""
        return now_ns()

    def flip(self) -> Flip:
        """Swap, wait for it, stamp it."""
        if self._keep:
            self._kept = self._read_back()
        submitted = now_ns()
        self._swap()
        shown = self._stamps.after_swap(submitted)
        index, due, missed, flags = self.grid.place(shown)
        self._glfw.poll_events()
        return Flip(index, due, submitted, shown, missed, flags)

    def swap_and_finish(self) -> None:
        """Swap and wait until it is done, without waiting for a vblank (benches only)."""
        self._glfw.swap_interval(0)
        self._swap()
        self._gl.finish()

    def keys(self) -> list[tuple[str, int]]:
        """Presses since the last call; GLFW delivers them when events are polled, once a refresh."""
        pressed, self._keys = self._keys, []
        return pressed

    def pointer(self) -> tuple[float, float]:
        """The mouse pointer in pixels from the top left of the window."""
        x, y = self._glfw.get_cursor_pos(self._window)
        wide, high = self._glfw.get_window_size(self._window)
        # Screen coordinates, which are not pixels on displays that scale.
        return x * self.size_px[0] / max(wide, 1), y * self.size_px[1] / max(high, 1)

    def should_close(self) -> bool:
        """The window's close button was used."""
        return bool(self._glfw.window_should_close(self._window))

    def read_pixels(self) -> np.ndarray:
        """(H, W, 3) uint8 of the picture last drawn: kept before the swap with ``keep_pixels``, else the back buffer
        as it is now (undefined after a swap)."""
        return self._read_back() if self._kept is None else self._kept

    def close(self) -> None:
        """Close the window."""
        if self._open:
            self._open = False
            self._gl.release()
            self._glfw.destroy_window(self._window)
            self._glfw.terminate()

    def _swap(self) -> None:
        self._glfw.swap_buffers(self._window)

    def _read_back(self) -> np.ndarray:
        raw = self.framebuffer.read(components=3, alignment=1)
        width, height = self.size_px
        return np.ascontiguousarray(np.frombuffer(raw, np.uint8).reshape(height, width, 3)[::-1])

    def _on_key(self, window: object, key: int, scancode: int, action: int, mods: int) -> None:
        if action == self._glfw.PRESS:
            name = KEY_NAMES.get(key) or self._glfw.get_key_name(key, scancode) or f"key_{key}"
            self._keys.append((name, now_ns()))

    def _create_window(self, size_px: tuple[int, int], rate_hz: Fraction, monitor: int | None, said: list[str]) -> Any:
        glfw = self._glfw
        monitors = glfw.get_monitors()
        chosen, mode = None, None
        if monitor is not None:
            if not 0 <= monitor < len(monitors):
                raise InputError(problem("display", "monitor", monitor, f"0 to {len(monitors) - 1}"))
            chosen = monitors[monitor]
            mode = _pick_mode(list(glfw.get_video_modes(chosen)), size_px, rate_hz)
            glfw.window_hint(glfw.REFRESH_RATE, mode.refresh_rate)
        elif monitors:
            mode = glfw.get_video_mode(monitors[0])
        self.monitor_count = len(monitors)
        self.monitor_rates_hz = [glfw.get_video_mode(m).refresh_rate for m in monitors]
        self.bits_per_channel = None if mode is None else mode.bits.red
        self.announced_hz: int | None = (mode.refresh_rate if mode is not None else 0) or None
        self.nominal_hz = Fraction(self.announced_hz or rate_hz)
        self.modes_hz = sorted(
            {Fraction(m.refresh_rate) for one in monitors for m in glfw.get_video_modes(one) if m.refresh_rate}
        )
        glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, 3)
        glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, 3)
        glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
        glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
        glfw.window_hint(glfw.DOUBLEBUFFER, True)
        glfw.window_hint(glfw.RESIZABLE, False)
        glfw.window_hint(glfw.AUTO_ICONIFY, False)
        window = glfw.create_window(size_px[0], size_px[1], "studyapp", chosen, None)
        if not window:
            got = said[-1] if said else "no window"
            raise InputError(problem("display", "glfw window", got, "OpenGL 3.3 core, or --display offscreen"))
        if chosen is not None:
            glfw.set_input_mode(window, glfw.CURSOR, glfw.CURSOR_HIDDEN)
        return window

    def _ladder(self) -> list[StampSource]:
        """Rungs that this window can be asked for, best first."""
        glfw = self._glfw
        rungs: list[StampSource] = []
        if hasattr(glfw, "get_glx_window") and glfw.extension_supported("GLX_OML_sync_control"):
            wait = oml_wait(_address(glfw), glfw.get_x11_display(), glfw.get_glx_window(self._window))
            if wait is not None:
                rungs.append(OmlStamp(wait))
        rungs.append(FenceStamp(self._gl))
        return rungs

    def _warnings(self) -> list[str]:
        found = []
        if os.environ.get("WAYLAND_DISPLAY") and not os.environ.get("DISPLAY"):
            found.append("a Wayland compositor stands between the window and the screen")
        if self.announced_hz is None:
            found.append("the monitor announces no refresh rate")
        if self.monitor_count > 1:
            found.append(f"{self.monitor_count} monitors are attached; one is better")
        if len(set(self.monitor_rates_hz)) > 1:
            rates = ", ".join(f"{rate} Hz" for rate in self.monitor_rates_hz)
            found.append(f"monitors run at different rates: {rates}")
        if any(name in self.renderer for name in ("llvmpipe", "softpipe", "swrast")):
            found.append(f"OpenGL runs on the CPU ({self.renderer})")
        return found


def _address(glfw: Any) -> Any:
    """glfw.get_proc_address as a plain integer or None."""

    def address(name: str) -> int | None:
        found = glfw.get_proc_address(name)
        return int(found) if found else None

    return address


def _pick_mode(modes: list[Any], size_px: tuple[int, int], rate_hz: Fraction) -> Any:
    """The video mode of that size and rate; InputError names the modes that would serve."""
    fitting = [mode for mode in modes if (mode.size.width, mode.size.height) == tuple(size_px)]
    exact = [mode for mode in fitting if mode.refresh_rate == round(rate_hz)]
    if exact:
        return max(exact, key=lambda mode: mode.bits.red)
    serving = [mode for mode in modes if mode.refresh_rate and (mode.refresh_rate / rate_hz).denominator == 1]
    named = sorted({f"{m.size.width}x{m.size.height} at {m.refresh_rate} Hz" for m in (serving or fitting or modes)})
    got = f"{size_px[0]}x{size_px[1]} at {float(rate_hz):g} Hz"
    raise InputError(problem("display", "video mode", got, " | ".join(named[:12]) or "a monitor with video modes"))
