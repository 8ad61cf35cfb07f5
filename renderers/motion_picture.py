"""The motion of every pixel's centre over a view's interval: what a tracking eye follows, and what clips may store."""

from __future__ import annotations

from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen
from renderers.technique import View
from renderers.vanilla import frame_lanes


class MotionPicture:
    """Motion vectors of whole frames of one engine and size."""

    def __init__(self, engine: Engine, size_px: tuple[int, int], reflected: bool = True) -> None:
        self.engine, self.size_px, self.reflected = engine, size_px, reflected
        self._pixel, self._x, self._y = frame_lanes(size_px)
        self._buffer = dr.zeros(mi.Float, size_px[0] * size_px[1] * 2)
        self._kernel = frozen(self._trace)

    def _trace(self, state: EngineState, pixel: Any, x: Any, y: Any, buffer: Any) -> Any:
        ray = self.engine.camera_ray(state, x, y)
        sample = self.engine.sample(state, ray, want_motion=True)
        dr.scatter(buffer, self.engine.motion(state, sample, reflected=self.reflected), pixel)
        return buffer

    def of(self, view: View) -> np.ndarray:
        """(H, W, 2) float32 pixels over the view's interval, now - before, x right, y down."""
        width, height = self.size_px
        state = self.engine.state(view, self.size_px)
        self._buffer = self._kernel(width * height, state, self._pixel, self._x, self._y, self._buffer)
        return np.array(self._buffer.numpy()).reshape(height, width, 2)
