"""Table 1 of HERR (Peuhkurinen and Mikkonen 2021) made here: what the polar buffer costs, and what it loses.

Cost: the headset's four viewports (`renderers.stereo.herr_viewports`, scaled) against a full Cartesian render of the
same pictures by the same engine, probes in both columns, a row for each number of light samples; polar frames hold the
resolve too. Both alternate in one process. Errors: of display values (x 255) against one sample a pixel with the same
light samples, at one gaze of a monitor view, for both mappings and a uniform grid of as many rays.
"""

from __future__ import annotations

import hashlib
import json
import os
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from renderers.admission import admit
from renderers.clip_frames import scene_exposure, view_at
from renderers.eccentricity import eye_plane, picture_eccentricity_deg
from renderers.engine import Engine
from renderers.framed import FramedLowResolution
from renderers.metrics import ring_rmse
from renderers.parameters import FramedLowResolution as FramedParameters
from renderers.parameters import Polar as PolarParameters
from renderers.parameters import Vanilla as VanillaParameters
from renderers.polar.technique import Polar
from renderers.stereo import EyeCamera, headset_viewports
from renderers.technique import Gaze
from renderers.vanilla import Vanilla
from stimuli.encode import display_values
from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath, Scene

SCENE = "mixed_reality_room"
LIGHT_SAMPLES = (1, 64, 256)
FRAMES = {1: 7, 64: 3, 256: 1}
"""Frames that are measured, by light samples, where nothing else is asked for."""
MAPPINGS = ("acuity", "equal_density")
RINGS_DEG = (0.0, 2.5, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0)
NEAR_DEG = 5.0
PAPER_MS: Mapping[str, Mapping[int, float]] = {
    "1576x768": {1: 10.2, 64: 35.4, 256: 114.8},
    "2048x1024": {1: 17.2, 64: 71.9, 256: 199.5},
}
"""Table 1: ms of a frame by rays of both eyes and light samples (RTX 2080 Ti)."""


@dataclass(frozen=True)
class Conditions:
    """What is the same for all rows. ``scale``: of the headset's pixels along each side; ``frames`` None: `FRAMES`;
    ``error_px`` and ``error_samples``: the monitor view, and light samples, of the errors."""

    scale: Fraction = Fraction(1, 4)
    frames: int | None = None
    gaze: Gaze = (5.0, -6.0)
    rate_hz: Fraction = Fraction(60)
    start_s: Fraction = Fraction(1)
    error_px: tuple[int, int] = (512, 288)
    error_samples: int = 64

    def frames_of(self, samples: int) -> int:
        """Frames that are measured with so many light samples."""
        return FRAMES[samples] if self.frames is None else self.frames

    def check(self) -> None:
        """Raise InputError for what cannot be measured."""
        pixels = [v.size_px for v in headset_viewports("polar", float(self.scale))]
        if (self.frames is not None and self.frames < 1) or min(self.error_px) < 1:
            got = f"{self.frames}, {self.error_px[0]}x{self.error_px[1]}"
            raise InputError(problem("table", "frames, size", got, "at least 1, 1x1"))
        admit("vanilla", (max(w for w, _ in pixels), sum(h for _, h in pixels)))


def key(scene_sha256: str, row: str, camera: CameraPath, c: Conditions, version: int) -> str:
    """The identity of a row's measurement; ``row``: 'samples 64', 'errors acuity'."""
    return hashlib.sha256(json.dumps([scene_sha256, row, camera.name, repr(c), version]).encode()).hexdigest()


def measure_times(
    scene: Scene, camera: CameraPath, samples: int, c: Conditions, progress: Callable[[int], object] = int
) -> dict[str, Any]:
    """The row of ``samples`` light samples: median ms of a frame and rays of both renders of the four viewports.

    On a machine that does other work too, CPU time says more than the clock; the load average stands beside them.
    ``progress`` is called with 1 after each frame; there is one more than is measured, which records the kernels and
    settles the probes.
    """
    engine, panels = Engine(scene, lighting="probes"), headset_viewports("polar", float(c.scale))
    params = PolarParameters.model_validate({"quality": samples, "dynamic_width": False})
    polar = Polar(engine, panels[0].size_px, params, 0, "total")
    light = VanillaParameters.model_validate({"light_samples": samples})
    plain = Engine(scene, lighting="probes")
    cartesian = [Vanilla(plain, panel.size_px, light, 0, "total") for panel in panels]
    taken: dict[str, list[tuple[float, float]]] = {"polar": [], "cartesian": []}
    rays = {"polar": 0, "cartesian": 0}
    for k in range(c.frames_of(samples) + 1):
        view = view_at(k, c.rate_hz, c.start_s, panels[0].size_px, camera, c.gaze)
        began = time.process_time()
        frame = polar.render(replace(view, viewports=panels))
        taken["polar"].append((frame.seconds["total"], time.process_time() - began))
        rays["polar"] = frame.rays["primary"]
        began = time.process_time()
        seen = [
            technique.render(
                replace(view, size_px=p.size_px, camera=EyeCamera(camera, p.yfov_rad, p.eye_offset_m, p.name))
            )
            for p, technique in zip(panels, cartesian, strict=True)
        ]
        cpu_s = time.process_time() - began
        taken["cartesian"].append((sum(one.seconds["total"] for one in seen), cpu_s))
        rays["cartesian"] = sum(one.rays["primary"] for one in seen)
        progress(1)
    ms = {name: 1e3 * statistics.median(wall for wall, _ in values[1:]) for name, values in taken.items()}
    cpu_ms = {name: 1e3 * statistics.median(cpu for _, cpu in values[1:]) for name, values in taken.items()}
    return {
        "row": f"samples {samples}",
        "light_samples": samples,
        "frames": c.frames_of(samples),
        "viewports": {p.name: p.size_px for p in panels},
        "polar_ms": ms["polar"],
        "cartesian_ms": ms["cartesian"],
        "faster": ms["cartesian"] / ms["polar"],
        "polar_cpu_ms": cpu_ms["polar"],
        "cartesian_cpu_ms": cpu_ms["cartesian"],
        "less_cpu_time": cpu_ms["cartesian"] / cpu_ms["polar"],
        "polar_rays": rays["polar"],
        "cartesian_rays": rays["cartesian"],
        "fewer_rays": rays["cartesian"] / rays["polar"],
        "load": os.getloadavg()[0],
    }


def measure_errors(
    scene: Scene, camera: CameraPath, mapping: str, c: Conditions, progress: Callable[[int], object] = int
) -> dict[str, Any]:
    """The row of ``mapping``: errors of one frame and of a uniform grid of as many rays, near the gaze and by ring."""
    engine, size = Engine(scene), c.error_px
    view = view_at(0, c.rate_hz, c.start_s, size, camera, c.gaze)
    far = picture_eccentricity_deg(eye_plane(size, camera.yfov_rad, None, c.gaze), size)
    exposure = scene_exposure(engine, camera, c.start_s)
    light = VanillaParameters.model_validate({"light_samples": c.error_samples})
    wanted = display_values(Vanilla(engine, size, light, 0, "total").render(view).color, exposure)
    params = {"mapping": mapping, "quality": c.error_samples, "dynamic_width": False}
    frame = Polar(engine, size, PolarParameters.model_validate(params), 0, "total").render(view)
    rays = frame.rays["primary"]
    budget = {"samples_per_s": float(rays * c.rate_hz), "light_samples": c.error_samples}
    grid = FramedLowResolution(engine, size, FramedParameters.model_validate(budget), 0, "total").render(view)

    def errors(picture: np.ndarray, count: int) -> dict[str, Any]:
        shown = display_values(picture, exposure)
        return {
            "rays": count,
            "rays_per_pixel": count / far.size,
            "near": 255 * ring_rmse(shown, wanted, far, (0.0, NEAR_DEG))[0],
            "rings": [255 * value for value in ring_rmse(shown, wanted, far, RINGS_DEG)],
        }

    progress(1)
    return {
        "row": f"errors {mapping}",
        "mapping": mapping,
        "polar": errors(frame.color, rays),
        "uniform": errors(grid.color, grid.rays["primary"]),
    }


def summary(rows: Sequence[Mapping[str, Any]], scene: Scene, c: Conditions) -> dict[str, Any]:
    """All rows, and frame times as ratios to 1 light sample beside the paper's."""
    times = {row["light_samples"]: row for row in rows if "light_samples" in row}
    one = times.get(1)
    return {
        "scene": scene.name,
        "viewports_scaled_by": float(c.scale),
        "gaze_deg": c.gaze,
        "ratio_to_1_light_sample": {n: row["polar_ms"] / one["polar_ms"] for n, row in times.items()} if one else {},
        "paper_ms": PAPER_MS,
        "paper_ratio_to_1_light_sample": {
            rays: {n: ms / told[1] for n, ms in told.items()} for rays, told in PAPER_MS.items()
        },
        "times": [dict(row) for row in times.values()],
        "rings_deg": RINGS_DEG,
        "errors_px": c.error_px,
        "errors": [dict(row) for row in rows if "mapping" in row],
    }
