"""A window to fly through a scene by hand: WASD and the mouse, Space records, Escape ends."""

from __future__ import annotations

import math
from typing import Any

import moderngl
import numpy as np

from stimuli.errors import InputError, problem
from stimuli.path_recording import Steering
from stimuli.scene import Scene
from studyapp.clock import now_ns
from studyapp.display.glfw_display import import_glfw
from studyapp.flight_preview import FlightPreview

SIZE_PX = (1280, 720)
TURN_DEG_A_PIXEL = 0.1
HELP = "W A S D: move; E Q: up, down; mouse: look; Shift: fast; Space: begin recording; Escape: end"


class GlfwFlight:
    """`stimuli.path_recording.FlightWindow` by GLFW. Close it. InputError where no display server answers."""

    def __init__(self, scene: Scene, yfov_rad: float, size_px: tuple[int, int] = SIZE_PX) -> None:
        self._glfw: Any = import_glfw()
        glfw = self._glfw
        said: list[str] = []
        glfw.set_error_callback(lambda code, text: said.append(text.decode(errors="replace")))
        wanted = "a running X11 or Wayland display (a path is flown by hand in a window)"
        if not glfw.init():
            raise InputError(problem("--record-path", "window", said[-1] if said else "no answer", wanted))
        for hint, value in (
            (glfw.CONTEXT_VERSION_MAJOR, 3), (glfw.CONTEXT_VERSION_MINOR, 3), (glfw.DEPTH_BITS, 24),
            (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE), (glfw.OPENGL_FORWARD_COMPAT, True),
        ):  # fmt: skip
            glfw.window_hint(hint, value)
        self._window = glfw.create_window(*size_px, f"{scene.name}: {HELP}", None, None)
        if not self._window:
            glfw.terminate()
            raise InputError(problem("--record-path", "window", said[-1] if said else "none", "OpenGL 3.3 core"))
        glfw.make_context_current(self._window)
        glfw.swap_interval(1)
        self._gl = moderngl.create_context(require=330)
        self._preview = FlightPreview(self._gl, scene, yfov_rad)
        self._name, self._titled = scene.name, -1
        # The pointer is caught, so that one can turn on and on.
        glfw.set_input_mode(self._window, glfw.CURSOR, glfw.CURSOR_DISABLED)
        self._pointer = glfw.get_cursor_pos(self._window)

    def now_s(self) -> float:
        """Seconds on the session clock."""
        return now_ns() * 1e-9

    def steering(self) -> Steering | None:
        """What is held down now, and how far the mouse went since the last call."""
        glfw = self._glfw
        glfw.poll_events()
        if self._held("ESCAPE") or glfw.window_should_close(self._window):
            return None
        x, y = glfw.get_cursor_pos(self._window)
        right, down = x - self._pointer[0], y - self._pointer[1]
        self._pointer = (x, y)
        turn = math.radians(TURN_DEG_A_PIXEL)
        return Steering(
            move=(self._held("D") - self._held("A"), self._held("E") - self._held("Q"),
                  self._held("W") - self._held("S")),
            turn_rad=(right * turn, -down * turn),
            fast=bool(self._held("LEFT_SHIFT") or self._held("RIGHT_SHIFT")),
            record=bool(self._held("SPACE")),
        )  # fmt: skip

    def show(self, pose: np.ndarray, time_s: float, recorded_s: float | None) -> None:
        """Draw and swap; the title says for how long one has recorded."""
        if recorded_s is not None and int(recorded_s) != self._titled:
            self._titled = int(recorded_s)
            self._glfw.set_window_title(self._window, f"{self._name}: recording, {self._titled} s; Escape ends")
        size_px = self._glfw.get_framebuffer_size(self._window)
        self._gl.screen.use()
        self._gl.viewport = (0, 0, *size_px)
        self._preview.draw(pose, time_s, size_px)
        self._glfw.swap_buffers(self._window)

    def close(self) -> None:
        """Close the window."""
        self._preview.close()
        self._gl.release()
        self._glfw.destroy_window(self._window)
        self._glfw.terminate()

    def _held(self, key: str) -> int:
        pressed: bool = self._glfw.get_key(self._window, getattr(self._glfw, f"KEY_{key}")) == self._glfw.PRESS
        return int(pressed)
