"""What it is worth to record only what a scene requires: kernels of one scene with features it does not need.

Both kernels come from the same code with other `Requirements`; pictures must agree. Times are the least of interleaved
runs: what else the machine does can only add (medians of the same runs spread five times as far).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from renderers.backend import dr
from renderers.clip_frames import view_at
from renderers.engine import Engine, EngineState
from renderers.frozen import Frozen, frozen
from renderers.requirements import FEATURES, Requirements, requirements_of
from renderers.vanilla import frame_lanes
from stimuli.scene import CameraPath, Scene

RATE_HZ = Fraction(240)


@dataclass(frozen=True)
class KernelFigures:
    """One kernel: least ms of a frame, operations of its recording, kB of its intermediate code, and the largest
    difference of its picture from the scene-specialised one's."""

    ms: float
    operations: int
    code_kb: float
    largest_difference: float


@dataclass(frozen=True)
class Specialisation:
    """``speedup``: all features over the scene's own. ``added``: what each feature costs alone, as a share of the
    scene's own time (0.1: a tenth dearer)."""

    scene: str
    own: KernelFigures
    all_features: KernelFigures
    speedup: float
    added: Mapping[str, float]
    kernels: Mapping[str, KernelFigures]


class PrimaryPass:
    """One engine with given requirements, its frozen primary pass and what was measured of it."""

    def __init__(self, scene: Scene, requirements: Requirements, size_px: tuple[int, int], device: str) -> None:
        self.engine = Engine(scene, device=device, requirements=requirements)
        self.lanes = size_px[0] * size_px[1]
        _, self._x, self._y = frame_lanes(size_px)
        self._size_px = size_px
        self._kernel: Frozen = frozen(self.color)
        self.milliseconds: list[float] = []

    def color(self, state: EngineState, x: Any, y: Any) -> Any:
        """What the kernel computes: the colour of each lane (Color3f)."""
        return self.engine.sample(state, self.engine.camera_ray(state, x, y)).color

    def _shade(self, camera: CameraPath) -> Any:
        state = self.engine.state(view_at(0, RATE_HZ, Fraction(0), self._size_px, camera))
        dr.sync_thread()
        start_s = time.perf_counter()
        color = self._kernel(self.lanes, state, self._x, self._y)
        dr.eval(color)
        dr.sync_thread()
        self.milliseconds.append((time.perf_counter() - start_s) * 1e3)
        return color

    def run(self, camera: CameraPath) -> np.ndarray:
        """One frame, timed; (lanes, 3)."""
        return np.array(self._shade(camera).numpy()).T

    def size(self, camera: CameraPath) -> tuple[int, float]:
        """(operations, kB of intermediate code) of the pass's largest kernel, from a recording of its own."""
        again = frozen(self.color)
        state = self.engine.state(view_at(0, RATE_HZ, Fraction(0), self._size_px, camera))
        dr.sync_thread()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(again(self.lanes, state, self._x, self._y))
            history = [entry for entry in dr.kernel_history() if "ir" in entry]
        operations = max((int(entry.get("operation_count", 0)) for entry in history), default=0)
        code = max((len(entry["ir"].read()) for entry in history), default=0)
        return operations, code / 1024


def measure_specialisation(
    scene: Scene,
    size_px: tuple[int, int] = (640, 360),
    runs: int = 15,
    features: tuple[str, ...] = FEATURES,
    device: str = "auto",
) -> Specialisation:
    """Time and size of the scene's own kernel, of the all-features kernel, and with each feature added alone."""
    own = requirements_of(scene)
    wanted = {"own": own, "all": Requirements.all(own)}
    for name in features:
        if not getattr(own, name):
            alone: dict[str, Any] = {name: True}
            wanted[name] = replace(own, **alone)
    kernels = {name: PrimaryPass(scene, needs, size_px, device) for name, needs in wanted.items()}
    pictures = {name: kernel.run(scene.camera) for name, kernel in kernels.items()}
    for kernel in kernels.values():
        kernel.run(scene.camera)  # the first replay
        kernel.milliseconds.clear()
    for _ in range(runs):
        for kernel in kernels.values():
            kernel.run(scene.camera)
    figures = {}
    for name, kernel in kernels.items():
        operations, code_kb = kernel.size(scene.camera)
        apart = float(np.abs(pictures[name] - pictures["own"]).max())
        figures[name] = KernelFigures(min(kernel.milliseconds), operations, code_kb, apart)
    base = figures["own"].ms
    return Specialisation(
        scene=scene.name,
        own=figures["own"],
        all_features=figures["all"],
        speedup=figures["all"].ms / base,
        added={name: found.ms / base - 1 for name, found in figures.items() if name not in ("own", "all")},
        kernels={name: found for name, found in figures.items() if name not in ("own", "all")},
    )


def specialisation_figures(scene: Scene) -> dict[str, object]:
    """The figures of `measure_specialisation` as plain values, for the bench."""
    found = asdict(measure_specialisation(scene))
    return {"specialisation": found}
