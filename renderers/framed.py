"""The two framed baselines of Dayal et al. 2005 (Table 1): all refreshes at low resolution, or whole frames seldom.

Both spend at most ``samples_per_s`` primary rays a second, and are otherwise `vanilla`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from renderers.backend import dr, mi
from renderers.engine import Engine
from renderers.frozen import frozen
from renderers.image import bilinear, store
from renderers.parameters import FramedLowRate as FramedLowRateParameters
from renderers.parameters import FramedLowResolution as FramedLowResolutionParameters
from renderers.parameters import Vanilla as VanillaParameters
from renderers.stopwatch import Stopwatch
from renderers.technique import Frame, LazyCounts, Measure, View
from renderers.vanilla import Vanilla, delayed


def affordable_size(size_px: tuple[int, int], rate_hz: Fraction, samples_per_s: float) -> tuple[int, int]:
    """The largest size of the same shape (whole pixels, at least 1x1, at most ``size_px``) within the budget."""
    width, height = size_px
    scale = min(1.0, math.sqrt(samples_per_s / float(rate_hz) / (width * height)))
    return max(1, math.floor(width * scale)), max(1, math.floor(height * scale))


def held_refreshes(size_px: tuple[int, int], rate_hz: Fraction, samples_per_s: float) -> int:
    """For how many refreshes each whole frame is shown so that the budget holds."""
    return max(1, math.ceil(size_px[0] * size_px[1] * float(rate_hz) / samples_per_s))


def enlarge(small: Any, from_width: int, from_height: int, width: int, height: int) -> Any:
    """A picture (flat, four channels) bilinearly at another size."""
    index = dr.arange(mi.UInt32, width * height)
    y = index // width
    x = index - y * width
    at_x = (mi.Float(x) + 0.5) * (from_width / width)
    at_y = (mi.Float(y) + 0.5) * (from_height / height)
    picture = dr.zeros(mi.Float, width * height * 4)
    store(picture, bilinear(small, at_x, at_y, from_width, from_height), mi.Float(0), index)
    return picture


class FramedLowResolution:
    """Every refresh, at the resolution that the budget allows, enlarged bilinearly."""

    name: ClassVar[str] = "framed_low_resolution"
    Params: ClassVar[type[FramedLowResolutionParameters]] = FramedLowResolutionParameters

    def __init__(
        self,
        engine: Engine,
        size_px: tuple[int, int],
        params: FramedLowResolutionParameters,
        seed: int,
        measure: Measure,
    ) -> None:
        self.engine, self.size_px, self.params, self._measure = engine, size_px, params, measure
        self._watch = Stopwatch(measure, dr.sync_thread)
        self._enlarge = frozen(enlarge)
        self._inner: Vanilla | None = None
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        self._seed = seed
        if self._inner is not None:
            self._inner.reset(seed)

    def render(self, view: View) -> Frame:
        """The small picture at t1, enlarged."""
        size = affordable_size(self.size_px, view.rate_hz, self.params.samples_per_s)
        if self._inner is None or self._inner.size_px != size:
            params = VanillaParameters(delay_frames=self.params.delay_frames, light_samples=self.params.light_samples)
            self._inner = Vanilla(self.engine, size, params, self._seed, self._measure)
        small = self._inner.render(replace(view, size_px=size))
        width, height = self.size_px
        with self._watch.frame(), self._watch.stage("enlarge"):
            padded = np.zeros((size[1], size[0], 4), np.float32)
            padded[..., :3] = small.color
            buffer = mi.Float(padded.ravel()) + dr.opaque(mi.Float, 0)
            dr.eval(buffer)
            picture = self._enlarge(width * height, buffer, *size, width, height)
        seconds = {**small.seconds, **self._watch.seconds}
        seconds["total"] = small.seconds["total"] + self._watch.seconds["total"]
        return replace(small, color=picture.numpy().reshape(height, width, 4)[..., :3], seconds=seconds)


class FramedLowRate:
    """Whole frames as often as the budget allows; each is held until the next. ``delay_frames`` counts whole frames."""

    name: ClassVar[str] = "framed_low_rate"
    Params: ClassVar[type[FramedLowRateParameters]] = FramedLowRateParameters

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: FramedLowRateParameters, seed: int, measure: Measure
    ) -> None:
        self.engine, self.size_px, self.params = engine, size_px, params
        self._inner = Vanilla(engine, size_px, VanillaParameters(light_samples=params.light_samples), seed, measure)
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start anew; the same views then give the same frames."""
        self._inner.reset(seed)
        self._shown: Frame | None = None
        self._age = 0

    def render(self, view: View) -> Frame:
        """A new whole frame, or the last one again (then no ray is traced)."""
        held = held_refreshes(self.size_px, view.rate_hz, self.params.samples_per_s)
        time_s = float(view.index * (view.t1 - view.t0))
        if self._shown is None or view.cut or self._age >= held:
            self._shown = self._inner.render(delayed(view, self.params.delay_frames * held))
            self._shown = replace(self._shown, color=self._shown.color.copy())
            self._age = 1
            return replace(self._shown, time_s=time_s)
        self._age += 1
        nothing = LazyCounts(dict.fromkeys(self._shown.rays, 0))
        seconds = dict.fromkeys(self._shown.seconds, 0.0)  # nothing was done
        return replace(self._shown, rays=nothing, seconds=seconds, time_s=time_s, clamped=0)
