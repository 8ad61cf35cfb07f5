"""The mouse pointer in place of the eyes: for trying out gaze-contingent studies without a tracker."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from studyapp.clock import now_ns
from studyapp.gaze.angles import ScreenGeometry


class MouseGaze:
    """A `GazeSource` (studyapp.seams) over a window's pointer. ``pointer()``: (x, y) in pixels from the top left."""

    name = "mouse"

    def __init__(self, pointer: Callable[[], tuple[float, float]], screen: ScreenGeometry) -> None:
        self._pointer, self._screen = pointer, screen

    def newest(self) -> tuple[float, float, int, bool] | None:
        x_px, y_px = self._pointer()
        width, height = self._screen.size_px
        x_dva, y_dva = self._screen.to_dva(np.float64(x_px / width), np.float64(y_px / height))
        inside = 0 <= x_px < width and 0 <= y_px < height
        return float(x_dva), float(y_dva), now_ns(), inside

    def alive(self) -> bool:
        return True
