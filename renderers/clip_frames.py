"""Frames of a scene by a technique, one after another: the plain call for scripts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from pydantic import ValidationError

from renderers.admission import admit
from renderers.catalogue import TECHNIQUES, entry
from renderers.engine import Engine, Lighting
from renderers.parameters import Reference
from renderers.reference import ReferenceRenderer
from renderers.technique import Frame, Gaze, LazyCounts, Measure, View, ViewGeometry
from stimuli.errors import InputError, problem
from stimuli.exposure import PROBE_SEED, PROBE_SIZE_PX, default_exposure
from stimuli.scene import CameraPath, Scene

_PROBE_SPP = 16
GazeInput = Gaze | Callable[[float], Gaze | None] | None


def exact(value: object, what: str) -> Fraction:
    """``value`` (number, Fraction or text like '60000/1001') as a rational; a float by its shortest decimal."""
    try:
        return Fraction(repr(value)) if isinstance(value, float) else Fraction(str(value))
    except (ValueError, ZeroDivisionError) as error:
        raise InputError(problem("render_clip", what, repr(value), "a finite number")) from error


def technique_params(technique: str, params: Mapping[str, Any]) -> Any:
    """The checked parameters of ``technique``. Raises InputError, a line for each mistake."""
    model = entry(technique).params
    try:
        return model(**params)
    except ValidationError as error:
        lines = []
        for detail in error.errors():
            place, got = ".".join(map(str, detail["loc"])), repr(detail["input"])
            if detail["type"] == "extra_forbidden":
                lines.append(problem(technique, "parameter", repr(place), f"one of {' | '.join(model.model_fields)}"))
            else:
                said = (
                    detail["msg"].removeprefix("Input should be ").removeprefix("Value error, ").partition(", got ")[0]
                )
                lines.append(problem(technique, place or "parameters", got, said))
        raise InputError(*lines) from error


def view_at(
    index: int, rate: Fraction, start: Fraction, size_px: tuple[int, int], camera: CameraPath, gaze: GazeInput = None,
    geometry: ViewGeometry | None = None, exposure: float = 1.0, cut: bool = False,
) -> View:  # fmt: skip
    """Refresh ``index`` of a clip: t1 = start + index / rate, t0 = t1 - 1 / rate."""
    t1 = start + index / rate
    now = gaze(float(index / rate)) if callable(gaze) else gaze
    return View(
        index=index,
        t0=t1 - 1 / rate,
        t1=t1,
        size_px=size_px,
        camera=camera,
        gaze=now,
        geometry=geometry,
        exposure=exposure,
        cut=cut,
    )


def scene_exposure(engine: Engine, camera: CameraPath, start: Fraction) -> float:
    """The scene's exposure: its own default, else 0.18 / log-average luminance of a small reference at ``start``."""
    if engine.scene.default_exposure is not None:
        return engine.scene.default_exposure
    probe = ReferenceRenderer(engine, PROBE_SIZE_PX, Reference(spp=_PROBE_SPP), PROBE_SEED, "total")
    return default_exposure(probe.render(view_at(0, Fraction(240), start, PROBE_SIZE_PX, camera)).color)


def render_clip(
    scene: Scene,
    technique: str,
    size_px: tuple[int, int] = (512, 288),
    rate_hz: float | Fraction | str = 240,
    duration_s: float | Fraction | str = 0.5,
    params: Mapping[str, Any] | None = None,
    seed: int = 0,
    start_s: float | Fraction | str = 0.0,
    gaze: GazeInput = None,
    view_geometry: ViewGeometry | None = None,
    camera: CameraPath | None = None,
    measure: Measure = "total",
    lighting: Lighting = "direct",
    exposure: float | None = None,
    device: str = "auto",
) -> Iterator[Frame]:
    """Yield the round(duration_s * rate_hz) frames of a clip, as copies that stay valid.

    Input is checked at once, nothing is rendered before it is asked for, and there is no warm-up. ``gaze``: (azimuth,
    elevation) in degrees, a function of clip time giving it, or None. ``exposure`` None: `scene_exposure`. Raises
    InputError for an unknown technique or parameter, a size below 1x1 or beyond the free memory, a rate that is not
    positive, times not finite.
    """
    checked = technique_params(technique, params or {})
    rate, duration, start = exact(rate_hz, "rate_hz"), exact(duration_s, "duration_s"), exact(start_s, "start_s")
    width, height = (int(v) for v in size_px)
    if width < 1 or height < 1:
        raise InputError(problem("render_clip", "size_px", f"{size_px[0]}x{size_px[1]}", "at least 1x1"))
    if rate <= 0 or duration < 0:
        raise InputError(
            problem("render_clip", "rate_hz and duration_s", f"{rate} and {duration}", "above 0, and 0 or more")
        )
    if measure not in ("total", "stages"):
        raise InputError(problem("render_clip", "measure", repr(measure), "total | stages"))
    if exposure is not None and not (math.isfinite(exposure) and exposure > 0):
        raise InputError(problem("render_clip", "exposure", exposure, "a finite number above 0"))
    admit(technique, (width, height))
    path = scene.camera if camera is None else camera

    def frames() -> Iterator[Frame]:
        engine = Engine(scene, device=device, lighting=lighting)
        made = TECHNIQUES[technique](engine, (width, height), checked, seed, measure)
        value = scene_exposure(engine, path, start) if exposure is None else exposure
        for index in range(round(duration * rate)):
            view = view_at(index, rate, start, (width, height), path, gaze, view_geometry, value, cut=index == 0)
            yield copied(made.render(view))

    return frames()


def copied(frame: Frame) -> Frame:
    """``frame`` with arrays of its own and its ray counts read."""
    return replace(
        frame,
        color=np.array(frame.color, np.float32),
        rays=LazyCounts({kind: int(count) for kind, count in frame.rays.items()}),
        seconds=dict(frame.seconds),
        alpha=None if frame.alpha is None else np.array(frame.alpha),
        channels={name: np.array(values) for name, values in frame.channels.items()},
        viewports={name: np.array(values) for name, values in frame.viewports.items()},
    )
