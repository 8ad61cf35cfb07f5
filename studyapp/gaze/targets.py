"""A target to look at, anywhere on the screen: a disc with a dot in its middle."""

from __future__ import annotations

from collections.abc import Callable

import moderngl
import numpy as np

from studyapp.gaze.angles import ScreenGeometry
from studyapp.present.layout import PanelRect
from studyapp.present.uploader import Quads, Sprite
from studyapp.seams import Display

OUTER_DVA, INNER_DVA = 0.6, 0.15


def paint_target(geometry: ScreenGeometry) -> np.ndarray:
    """(n, n, 4) uint8: a white disc of 0.6 degrees with a black dot of 0.15 degrees, smooth edges, clear around."""
    px_per_deg = geometry.size_px[0] / geometry.width_m * geometry.distance_m * np.tan(np.radians(1.0))
    n = int(np.ceil(OUTER_DVA * px_per_deg)) + 2
    axis = np.arange(n) - (n - 1) / 2
    radius = np.hypot(*np.meshgrid(axis, axis))
    disc = np.clip(OUTER_DVA * px_per_deg / 2 - radius + 0.5, 0, 1)
    dot = np.clip(INNER_DVA * px_per_deg / 2 - radius + 0.5, 0, 1)
    picture = np.zeros((n, n, 4), np.uint8)
    picture[..., :3] = np.rint(255 * (1 - dot))[..., None]
    picture[..., 3] = np.rint(255 * disc)
    return picture


class TargetScreen:
    """Shows targets on ``display`` on a grey ground (display code ``background``, 0..1); nothing on the virtual one."""

    def __init__(self, display: Display, geometry: ScreenGeometry, background: float = 119 / 255) -> None:
        self._display, self._background = display, background
        context = display.context()
        self._gl = context if isinstance(context, moderngl.Context) else None
        self._quads = None if self._gl is None else Quads(self._gl, display.size_px)
        self._picture = paint_target(geometry)

    def show(self, x: float, y: float, duration_s: float, each_refresh: Callable[[], None] | None = None) -> None:
        """The target at normalised (x, y) for ``duration_s``; ``each_refresh`` is called after every flip."""
        refreshes = max(1, round(duration_s * float(self._display.nominal_hz)))
        sprite = None
        if self._gl is not None and self._quads is not None:
            width, height = self._display.size_px
            n = len(self._picture)
            rect = PanelRect("target", round(x * width - n / 2), round(y * height - n / 2), n, n)
            sprite = Sprite(self._gl, self._quads, rect, self._picture)
        for _ in range(refreshes):
            if self._gl is not None and sprite is not None:
                self._gl.clear(self._background, self._background, self._background, 1.0)
                sprite.draw()
            self._display.flip()
            if each_refresh is not None:
                each_refresh()
        if sprite is not None:
            sprite.release()

    def close(self) -> None:
        """Give the drawing parts back."""
        if self._quads is not None:
            self._quads.release()
