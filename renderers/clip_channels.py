"""What clips may store beside colour: the scene's depth and motion at each pixel's centre, and samples of each pixel.

Depth and motion are the scene's at t1, whatever a technique shows of it; they cost a frame of rays of their own, which
no count of the technique's rays holds.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.catalogue import CATALOGUE
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen
from renderers.technique import Frame, Technique, View
from renderers.vanilla import frame_lanes
from stimuli.errors import InputError, problem

SCENE_CHANNELS = ("Z", "motion.X", "motion.Y")


class SceneChannels:
    """``Z`` (world units along the camera's axis, inf: nothing there), ``motion.X``, ``motion.Y`` (pixels over the
    view's interval, now - before, y down; of the reflection where a mirror makes up most of a pixel)."""

    def __init__(self, engine: Engine, size_px: tuple[int, int]) -> None:
        # Probes remember what they were shown: they are neither needed here nor to be asked twice.
        self._engine, self._size_px = copy.copy(engine), size_px
        self._engine.lighting, self._engine.indirect = "direct", None
        self._pixel, self._x, self._y = frame_lanes(size_px)
        self._buffer = dr.zeros(mi.Float, size_px[0] * size_px[1] * 3)
        dr.make_opaque(self._buffer)
        self._kernel = frozen(self._trace)

    def _trace(self, state: EngineState, pixel: Any, x: Any, y: Any, buffer: Any) -> Any:
        sample = self._engine.sample(state, self._engine.camera_ray(state, x, y), want_motion=True)
        moved = self._engine.motion(state, sample)
        dr.scatter(buffer, mi.Vector3f(sample.z, moved.x, moved.y), pixel)
        return buffer

    def of(self, view: View) -> dict[str, np.ndarray]:
        """(H, W) float32 each."""
        width, height = self._size_px
        state = self._engine.state(view, self._size_px)
        self._buffer = self._kernel(width * height, state, self._pixel, self._x, self._y, self._buffer)
        planes = np.array(self._buffer.numpy()).reshape(height, width, 3)
        return {name: np.ascontiguousarray(planes[..., i]) for i, name in enumerate(SCENE_CHANNELS)}


def samples_of(technique: Technique, frame: Frame, view: View, size_px: tuple[int, int]) -> np.ndarray:
    """(H, W) uint32: primary rays that this frame shaded for each pixel. InputError for techniques whose samples belong
    to no pixel of the picture."""
    width, height = size_px
    if "samples" in frame.channels:
        return np.asarray(frame.channels["samples"], np.uint32)
    known = CATALOGUE.get(technique.name)
    if known is None or not known.counts_samples:
        able = " | ".join(name for name, entry in CATALOGUE.items() if entry.counts_samples)
        raise InputError(problem(technique.name, "channels", "samples", f"depth, motion; samples only of {able}"))
    if hasattr(technique, "show"):
        maps = technique.show(view)
        traced = maps["sampled"] if "sampled" in maps else maps["class"] >= 2
        return np.asarray(traced, np.uint32)
    return np.full((height, width), frame.rays["primary"] // (width * height), np.uint32)
