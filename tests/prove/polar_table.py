"""HERR's table: what the polar buffer costs and what it loses, beside a full Cartesian render of the same pictures.

The headset's four viewports (40 degrees at 60 and 90 degrees at 22 pixels per degree, for each eye) are scaled by
`HEADSET_SCALE` in each direction, said aloud in the result. Probes are on in both columns. Errors are of display values
(x 255) against one sample a pixel with the same light samples, at one gaze, for both mappings and a uniform grid of as
many rays. The paper's Table 1 is compared as ratios (35.4 / 10.2 and 114.8 / 10.2).
"""

from __future__ import annotations

import json
import math
import os
import statistics
import sys
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from renderers.clip_frames import view_at
from renderers.eccentricity import eye_plane, picture_eccentricity_deg
from renderers.engine import Engine
from renderers.framed import FramedLowResolution
from renderers.metrics import ring_rmse
from renderers.parameters import FramedLowResolution as FramedParameters
from renderers.parameters import Polar as PolarParameters
from renderers.parameters import Probes
from renderers.parameters import Vanilla as VanillaParameters
from renderers.polar.technique import Polar
from renderers.technique import Viewport
from renderers.vanilla import Vanilla
from stimuli.encode import display_values
from stimuli.load import load_scene
from stimuli.scene import Scene, StillCamera

RATE = Fraction(60)
START_S = Fraction(1)
GAZE = (5.0, -6.0)
RINGS_DEG = (0.0, 2.5, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0)
PAPER = {"64": 35.4 / 10.2, "256": 114.8 / 10.2}
HEADSET_SCALE = 1 / 4
FRAMES = {1: 7, 64: 3, 256: 1}


def viewports(scale: float) -> tuple[Viewport, ...]:
    """The four viewports, each side shortened by ``scale``."""

    def pixels(field_deg: float, ppd: float) -> int:
        return round(2 * math.tan(math.radians(field_deg / 2)) * math.degrees(ppd * scale))

    return tuple(
        Viewport(f"{side} {name}", (pixels(field, ppd),) * 2, math.radians(field), offset)
        for side, offset in (("left", -0.032), ("right", 0.032))
        for name, field, ppd in (("inset", 40.0, 60.0), ("surround", 90.0, 22.0))
    )


def frame_times(scene: Scene, scale: float, samples: int, frames: int) -> dict[str, float]:
    """Median seconds of a frame and rays of both renders of the four viewports, probes included.

    On a machine that does other work too, CPU time says more than the clock; the load average stands beside them.
    """
    engine, panels = Engine(scene, lighting="probes"), viewports(scale)
    polar = Polar(engine, panels[0].size_px, PolarParameters(quality=samples, dynamic_width=False), 0, "total")
    plain = Engine(scene, lighting="probes")
    light = VanillaParameters(light_samples=samples)
    cartesian = [Vanilla(plain, panel.size_px, light, 0, "total") for panel in panels]
    seconds: dict[str, list[float]] = {"polar": [], "cartesian": []}
    cpu_s: dict[str, list[float]] = {"polar": [], "cartesian": []}
    rays = {}
    for k in range(frames + 1):  # the first records kernels and settles the probes
        view = view_at(k, RATE, START_S, panels[0].size_px, scene.camera, GAZE)
        began = time.process_time()
        frame = polar.render(replace(view, viewports=panels))
        cpu_s["polar"].append(time.process_time() - began)
        seconds["polar"].append(frame.seconds["total"])
        rays["polar"] = frame.rays["primary"]
        total, count = 0.0, 0
        began = time.process_time()
        for panel, technique in zip(panels, cartesian, strict=True):
            pose = scene.camera.pose(np.array([float(view.t1)]))[0]
            pose[:3, 3] += pose[:3, 0] * panel.eye_offset_m
            seen = technique.render(replace(view, size_px=panel.size_px, camera=StillCamera(pose, panel.yfov_rad)))
            total, count = total + seen.seconds["total"], count + seen.rays["primary"]
        cpu_s["cartesian"].append(time.process_time() - began)
        seconds["cartesian"].append(total)
        rays["cartesian"] = count
    found = {f"{name}_ms": 1000 * statistics.median(values[1:]) for name, values in seconds.items()}
    found |= {f"{name}_rays": float(value) for name, value in rays.items()}
    found |= {f"{name}_cpu_ms": 1000 * statistics.median(values[1:]) for name, values in cpu_s.items()}
    found["less_cpu_time"] = found["cartesian_cpu_ms"] / found["polar_cpu_ms"]
    found["faster"] = found["cartesian_ms"] / found["polar_ms"]
    found["load"] = os.getloadavg()[0]
    found["fewer_rays"] = found["cartesian_rays"] / found["polar_rays"]
    return found


def errors(scene: Scene, size_px: tuple[int, int], samples: int) -> dict[str, dict[str, object]]:
    """Ring errors of both mappings and of uniform grids of as many rays, for one frame."""
    engine = Engine(scene)
    view = view_at(0, RATE, START_S, size_px, scene.camera, GAZE)
    plane = eye_plane(size_px, scene.camera.yfov_rad, None, GAZE)
    far = picture_eccentricity_deg(plane, size_px)
    truth = Vanilla(engine, size_px, VanillaParameters(light_samples=samples), 0, "total").render(view)
    exposure = 0.18 / math.exp(float(np.mean(np.log(truth.color.mean(axis=2) + 1e-4))))
    wanted = display_values(truth.color * exposure)

    def row(picture: np.ndarray, rays: int) -> dict[str, object]:
        shown = display_values(picture * exposure)
        rings = [255 * value for value in ring_rmse(shown, wanted, far, RINGS_DEG)]
        near = 255 * ring_rmse(shown, wanted, far, (0.0, 5.0))[0]
        return {"rays": rays, "rays_per_pixel": rays / far.size, "within_5_deg": near, "rings": rings}

    found = {}
    for mapping in ("acuity", "equal_density"):
        params = PolarParameters(mapping=mapping, quality=samples, dynamic_width=False)
        frame = Polar(engine, size_px, params, 0, "total").render(view)
        rays = frame.rays["primary"]
        found[mapping] = row(frame.color, rays)
        grid = FramedLowResolution(engine, size_px, FramedParameters(samples_per_s=float(rays * RATE)), 0, "total")
        uniform = grid.render(view)
        found[f"uniform grid beside {mapping}"] = row(uniform.color, uniform.rays["primary"])
    return found


def prove(scale: float = HEADSET_SCALE, frames: dict[int, int] | None = None) -> dict[str, object]:
    """The whole table. Raises AssertionError where a claim of issue 5 about rays or errors does not hold."""
    scene = load_scene("mixed_reality_room")
    times = {}
    for n, count in (FRAMES if frames is None else frames).items():
        times[str(n)] = frame_times(scene, scale, n, count)
        print(n, json.dumps(times[str(n)]), flush=True)
    found = errors(scene, (512, 288), 64)
    for mapping in ("acuity", "equal_density"):
        near = [found[name]["within_5_deg"] for name in (mapping, f"uniform grid beside {mapping}")]
        assert float(near[0]) < float(near[1]), (mapping, near)  # type: ignore[arg-type]
    assert all(row["fewer_rays"] > 1 for row in times.values())
    ratios = {n: row["polar_ms"] / times["1"]["polar_ms"] for n, row in times.items() if n != "1"}
    return {
        "viewports_scaled_by": scale,
        "probes": Probes().model_dump(),
        "headset": times,
        "ratio_to_1_light_sample": ratios,
        "paper_ratio_to_1_light_sample": PAPER,
        "rings_deg": RINGS_DEG,
        "errors_x255": found,
    }


if __name__ == "__main__":
    wanted_scale = float(Fraction(sys.argv[1])) if len(sys.argv) > 1 else HEADSET_SCALE
    only = {int(n): FRAMES[int(n)] for n in sys.argv[2].split(",")} if len(sys.argv) > 2 else None
    result = prove(wanted_scale, only)
    Path("evidence").mkdir(exist_ok=True)
    Path("evidence/polar_table.json").write_text(json.dumps(result, indent=1))
    print(json.dumps(result, indent=1))
