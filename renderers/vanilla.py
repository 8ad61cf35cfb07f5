"""Vanilla: one sample at each pixel's centre, at t1, every refresh. Also how full frames reach the host."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from renderers.backend import dr, mi
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen, opaque_float, opaque_uint
from renderers.parameters import Vanilla as VanillaParameters
from renderers.pixels import pixel_centres, tile_order
from renderers.rng import combined
from renderers.samples import Sample
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, LazyCounts, Measure, View
from stimuli.errors import InputError, problem


def frame_lanes(size_px: tuple[int, int]) -> tuple[Any, Any, Any]:
    """Pixel numbers (UInt32) of a whole frame in tile order, and the x and y (Float) of their centres.

    Raises InputError for a size below 1 px.
    """
    if min(size_px) < 1:
        raise InputError(problem("size_px", "picture size", f"{size_px[0]}x{size_px[1]}", "at least 1x1"))
    order = tile_order(*size_px)
    x, y = pixel_centres(order, size_px[0])
    return opaque_uint(order), opaque_float(x), opaque_float(y)


def interleaved(color: Any, pixel: Any, buffer: Any) -> Any:
    """Write lanes' colours (Color3f) into the picture ``buffer`` (H * W * 3) at their pixel numbers."""
    dr.scatter(buffer, mi.Color3f(color), pixel)  # one packet a lane: three single scatters cost 50 ms more at 960x540
    return buffer


def delayed(view: View, frames: int) -> View:
    """``view`` as it was ``frames`` refreshes ago."""
    step = (view.t1 - view.t0) * frames
    return replace(view, t0=view.t0 - step, t1=view.t1 - step) if frames else view


def ray_counts(primary: int, rays: dict[str, Any]) -> LazyCounts:
    """Counts of one frame from its lanes' counters, summed when they are read."""
    return LazyCounts({"primary": primary, **{kind: _lazy_sum(lanes) for kind, lanes in rays.items()}})


def finished_frame(
    view: View,
    size_px: tuple[int, int],
    picture: Any,
    primary: int,
    rays: dict[str, Any],
    clamped: Any,
    watch: Stopwatch,
) -> Frame:
    """The frame of ``view`` on the host, once ``watch`` has stopped.

    Args:
        picture: Float, H * W * 3, or H * W * 4 whose fourth channel is the technique's own.
        primary: primary rays of this frame.
        rays: UInt32 lanes of the other kinds' counters.
        clamped: UInt32 lanes, 1 where shading's end clamped a value; summed here, as a sum on the device would be a
            kernel of its own.
    """
    width, height = size_px
    return Frame(
        color=picture.numpy().reshape(height, width, -1)[..., :3],
        rays=ray_counts(primary, rays),
        seconds=dict(watch.seconds),
        time_s=float(view.index * (view.t1 - view.t0)),
        clamped=int(np.sum(clamped.numpy(), dtype=np.int64)),
    )


def _lazy_sum(lanes: Any) -> Any:
    return lambda: int(np.asarray(lanes.numpy(), np.int64).sum())


def frame_seed(seed: int, index: int) -> Any:
    """One UInt32 (width 1) for a frame, from the technique's seed."""
    return opaque_uint(int(np.random.SeedSequence([seed, index]).generate_state(1)[0]))


class Vanilla:
    """One sample a pixel. Lights with an area and ambient occlusion are sampled anew each frame."""

    name: ClassVar[str] = "vanilla"
    Params: ClassVar[type[VanillaParameters]] = VanillaParameters

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: VanillaParameters, seed: int, measure: Measure
    ) -> None:
        self.engine, self.size_px, self.params = engine, size_px, params
        self._pixel, self._x, self._y = frame_lanes(size_px)
        self._buffer = opaque_float(np.zeros(size_px[0] * size_px[1] * 3))
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._kernel = frozen(self._trace)
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        self._seed = seed

    def _trace(self, state: EngineState, pixel: Any, x: Any, y: Any, seed: Any, buffer: Any) -> tuple[Any, Any, Any]:
        sample: Sample = self.engine.sample(
            state,
            self.engine.camera_ray(state, x, y),
            rng=combined(seed, pixel),
            light_samples=self.params.light_samples,
        )
        interleaved(sample.color, pixel, buffer)
        return sample.rays, sample.clamped, buffer

    def render(self, view: View) -> Frame:
        """The picture at t1, ``delay_frames`` refreshes ago."""
        width, height = self.size_px
        with self._watch.frame():
            with self._watch.stage("state"):
                state = self.engine.state(delayed(view, self.params.delay_frames), self.size_px)
                seed = frame_seed(self._seed, view.index)
            with self._watch.stage("trace"):
                rays, clamped, self._buffer = self._kernel(
                    width * height, state, self._pixel, self._x, self._y, seed, self._buffer
                )
        return finished_frame(view, self.size_px, self._buffer, width * height, rays, clamped, self._watch)
