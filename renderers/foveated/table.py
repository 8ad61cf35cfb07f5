"""Table 1 of Weier et al. 2016 made here: samples, stage times and speed-up of `foveated` against full ray tracing.

Foveated and full frames alternate in one process, so that what else the machine does falls on both alike. Each cell is
a scene under one light setting: a point light, an area light (9 shadow rays, the paper's 8 being no square), ambient
occlusion (16 rays). One eye of a headset, gaze at its centre.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from fractions import Fraction
from typing import Any, Literal

import numpy as np

from renderers.admission import admit
from renderers.clip_frames import scene_exposure, view_at
from renderers.eccentricity import eye_plane, picture_eccentricity_deg
from renderers.engine import Engine
from renderers.foveated.technique import Foveated
from renderers.metrics import flip_map, pixels_per_degree
from renderers.parameters import FOVEAL_REGIONS
from renderers.parameters import Foveated as FoveatedParameters
from renderers.parameters import Vanilla as VanillaParameters
from renderers.stereo import OCULUS_DK2, Headset
from renderers.vanilla import Vanilla
from stimuli.encode import display_values
from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath, Light, Scene

Setting = Literal["point", "area", "ambient_occlusion"]
SETTINGS: tuple[Setting, ...] = ("point", "area", "ambient_occlusion")
RATE_HZ = Fraction(75)
RINGS_DEG = (0.0, 10.0, 20.0, 30.0, 40.0, 90.0)
PAPER: dict[str, dict[Setting, tuple[float, float]]] = {
    "sibenik": {"point": (0.81 / 3.46, 1.59), "area": (3.64 / 15.57, 2.61), "ambient_occlusion": (6.88 / 29.42, 3.02)},
    "sponza": {"point": (0.64 / 3.46, 1.92), "area": (2.89 / 15.54, 3.52), "ambient_occlusion": (5.45 / 29.36, 4.18)},
    "rungholt": {"point": (0.58 / 2.90, 1.50), "area": (2.25 / 11.10, 2.64), "ambient_occlusion": (4.17 / 20.47, 3.10)},
    "urban_sprawl": {
        "point": (0.64 / 3.06, 1.46), "area": (2.60 / 12.34, 2.52), "ambient_occlusion": (4.85 / 22.95, 3.32),
    },
}  # fmt: skip
"""Table 1: share of the full renderer's rays, and speed-up (Titan X)."""
PAPER_MEANS = {"fewer_samples_percent": 79, "speedup_mean": 2.55, "speedup_best": 4.18}
SCENES: dict[str, str | None] = {
    "tunnel_geom": None, "tunnel_maps": None, "voxel_city": "rungholt", "sponza": "sponza",
}  # fmt: skip
"""The scenes of the paper's study, and the scene of its Table 1 that each is or stands in for."""


@dataclass(frozen=True)
class Conditions:
    """What is the same for all cells: ``frames`` are measured after ``warm_up`` others; one eye of ``headset``, in
    ``size_px`` where it is given."""

    frames: int = 30
    warm_up: int = 4
    configuration: str = "medium"
    headset: Headset = OCULUS_DK2
    size_px: tuple[int, int] | None = None
    start_s: Fraction = Fraction(1)

    @property
    def picture_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.headset.size_px if self.size_px is None else self.size_px

    def check(self) -> None:
        """Raise InputError for what cannot be measured."""
        size = self.picture_px
        if self.frames < 1 or self.warm_up < 1 or min(size) < 1:
            got = f"{self.frames}, {self.warm_up}, {size[0]}x{size[1]}"
            raise InputError(problem("table", "frames, warm-up, size", got, "at least 1, 1, 1x1"))
        regions = [name for name in FOVEAL_REGIONS if name != "full"]
        if self.configuration not in regions:
            raise InputError(problem("table", "configuration", self.configuration, " | ".join(regions)))
        admit("foveated", size)


@dataclass(frozen=True)
class Cell:
    """One scene under one light setting. Times are medians in ms; ``share``: traced of all pixels, mean over frames.

    ``trace_speedup`` compares the trace stages, ``speedup`` whole frames. ``rmse_by_ring``: of display values x 255
    against the full frames, by `RINGS_DEG`, over all frames compared (one in five); ``flip_by_ring``: mean LDR-FLIP of
    the last frame. ``load``: the machine's load average.
    """

    scene: str
    setting: Setting
    frames: int
    share: float
    marked: float
    full_ms: float
    full_trace_ms: float
    total_ms: float
    stages_ms: dict[str, float]
    trace_speedup: float
    speedup: float
    rmse_by_ring: tuple[float, ...]
    flip_by_ring: tuple[float, ...]
    load: float

    @staticmethod
    def of(row: Mapping[str, Any]) -> Cell:
        """The cell that was written as ``row`` (`dataclasses.asdict`; other entries are passed over)."""
        return Cell(**{field.name: row[field.name] for field in fields(Cell)})


def lit(scene: Scene, setting: Setting, start_s: float) -> Scene:
    """``scene`` under one light above and beside the start of its camera path; as it is for ambient occlusion."""
    if setting == "ambient_occlusion":
        return scene
    pose = scene.camera.pose(np.array([start_s]))[0]
    radius = _radius(scene)
    place = pose[:3, 3] + 0.02 * radius * (pose[:3, 1] + pose[:3, 0])
    side = 0.02 * radius
    if setting == "point":
        light = Light("point", (1.0, 1.0, 1.0), position=tuple(place), falloff="none")
    else:
        # Radiance such that a surface a tenth of the radius away gets about as much.
        corner = place - side / 2 * (pose[:3, 0] + pose[:3, 1])
        strength = (0.1 * radius) ** 2 / side**2
        light = Light(
            "area", (strength,) * 3, corner=tuple(corner), edge_u=tuple(pose[:3, 0] * side),
            edge_v=tuple(pose[:3, 1] * side), direction=tuple(-pose[:3, 2]),
        )  # fmt: skip
    return replace(scene, lights=(light,))


def _radius(scene: Scene) -> float:
    points = np.concatenate([part.positions @ part.matrix[:3, :3].T + part.matrix[:3, 3] for part in scene.static])
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)) / 2)


def key(scene_sha256: str, setting: Setting, camera: CameraPath, c: Conditions, version: int) -> str:
    """The identity of a cell's measurement."""
    told = [scene_sha256, setting, camera.name, repr(c), version]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def measure_cell(
    scene: Scene, setting: Setting, c: Conditions = Conditions(), camera: CameraPath | None = None,
    device: str = "auto", progress: Callable[[int], object] = int,
) -> Cell:  # fmt: skip
    """One cell: the warm-up records the kernels, then frames are measured, full and foveated alternating.

    ``progress`` is called with 1 after each frame. Raises what `Conditions.check` does.
    """
    c.check()
    size = c.picture_px
    path = scene.camera if camera is None else camera
    engine = Engine(
        lit(replace(scene, camera=path), setting, float(c.start_s)),
        device=device,
        lighting="ambient_occlusion" if setting == "ambient_occlusion" else "direct",
    )
    eye = c.headset.eyes(path)[0]
    samples = 9 if setting == "area" else 1
    params = FoveatedParameters.model_validate({"configuration": c.configuration, "light_samples": samples})
    foveated = Foveated(engine, size, params, 1, "stages")
    full = Vanilla(engine, size, VanillaParameters.model_validate({"light_samples": samples}), 1, "stages")
    exposure = scene_exposure(engine, eye, c.start_s)
    ring = np.digitize(picture_eccentricity_deg(eye_plane(size, eye.yfov_rad), size), RINGS_DEG) - 1
    squares, pixels = np.zeros(len(RINGS_DEG)), np.zeros(len(RINGS_DEG))
    rows, shares, marked = [], [], []
    for k in range(c.warm_up + c.frames):
        view = view_at(k, RATE_HZ, c.start_s, size, eye, exposure=exposure, cut=k == 0)
        wanted = full.render(view)
        frame = foveated.render(view)
        progress(1)
        if k < c.warm_up:
            continue
        rows.append((dict(wanted.seconds), dict(frame.seconds)))
        shares.append(frame.rays["primary"] / (size[0] * size[1]))
        marked.append(float(foveated.show(view)["marks"].mean()))
        if (k - c.warm_up) % 5 == 4 or c.frames < 5:
            error = display_values(frame.color, exposure) - display_values(wanted.color, exposure)
            squares += np.bincount(ring.ravel(), (error**2).mean(-1).ravel(), len(RINGS_DEG))
            pixels += np.bincount(ring.ravel(), minlength=len(RINGS_DEG))
    last = flip_map(
        display_values(frame.color, exposure), display_values(wanted.color, exposure),
        pixels_per_degree(*size, eye.yfov_rad, None),
    )  # fmt: skip
    flips = [float(last[ring == k].mean()) if (ring == k).any() else math.nan for k in range(len(RINGS_DEG) - 1)]
    foveated.close()

    def median_ms(which: int, stage: str) -> float:
        return 1e3 * float(np.median([row[which][stage] for row in rows]))

    stages = {stage: median_ms(1, stage) for stage in rows[0][1] if stage != "total"}
    full_ms, full_trace, total = median_ms(0, "total"), median_ms(0, "trace"), median_ms(1, "total")
    errors = 255 * np.sqrt(squares / np.maximum(pixels, 1))
    return Cell(
        scene=scene.name, setting=setting, frames=c.frames, share=float(np.mean(shares)),
        marked=float(np.mean(marked)), full_ms=full_ms, full_trace_ms=full_trace, total_ms=total, stages_ms=stages,
        trace_speedup=full_trace / stages["trace"], speedup=full_ms / total,
        rmse_by_ring=tuple(float(v) for v in errors[: len(RINGS_DEG) - 1]), flip_by_ring=tuple(flips),
        load=os.getloadavg()[0],
    )  # fmt: skip


def summary(cells: Sequence[Cell]) -> dict[str, Any]:
    """Means over cells as the paper gives them, beside the paper's, and every cell."""
    if not cells:
        raise ValueError("a summary needs at least one cell")
    by_setting = {s: [c for c in cells if c.setting == s] for s in SETTINGS}
    return {
        "fewer_samples_percent": 100 * (1 - math.fsum(c.share for c in cells) / len(cells)),
        "trace_speedup": {s: float(np.mean([c.trace_speedup for c in of])) for s, of in by_setting.items() if of},
        "speedup": {s: float(np.mean([c.speedup for c in of])) for s, of in by_setting.items() if of},
        "speedup_mean": float(np.mean([c.speedup for c in cells])),
        "speedup_best": max(c.speedup for c in cells),
        "paper": {**PAPER_MEANS, "table_1": PAPER},
        "cells": [asdict(cell) for cell in cells],
    }
