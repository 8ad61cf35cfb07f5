"""How fast is Whitted ray tracing here, against Mitsuba's own direct-light integrator and against bare traversal?"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.clip_frames import view_at
from renderers.engine import Engine, EngineState
from renderers.frozen import Frozen, frozen
from renderers.mitsuba_scene import diffuse_only, mitsuba_scene
from renderers.vanilla import frame_lanes
from stimuli.scene import Scene

RATE_HZ = Fraction(240)


@dataclass(frozen=True)
class WhittedFigures:
    """Medians of interleaved runs. ``ratio``: Mitsuba's time over ours, both on watertight traversal.

    ``default_ratio``: the same with Mitsuba's default traversal, which lets 4 to 5 % of the rays through that are aimed
    at an edge between two triangles (ours: none of 16 million). ``share``: our rays a second over those of bare
    ``ray_intersect``. ``mean_difference`` and ``differing`` (share of pixels more than 1e-3 apart): our picture against
    Mitsuba's. Where they differ (shadow edges), Mitsuba's shadow rays start too far off the surface.
    """

    whitted_ms: float
    mitsuba_direct_ms: float
    ratio: float
    mitsuba_default_ms: float
    default_ratio: float
    raw_intersect_mrays_s: float
    whitted_mrays_s: float
    share: float
    mean_difference: float
    differing: float


def _timed_ms(run: Callable[[], Any]) -> float:
    """One run, finished on the device."""
    dr.sync_thread()
    start_s = time.perf_counter()
    dr.eval(run())
    dr.sync_thread()
    return (time.perf_counter() - start_s) * 1e3


def measure_whitted(
    scene: Scene, size_px: tuple[int, int] = (960, 540), runs: int = 25, device: str = "auto"
) -> WhittedFigures:
    """The figures of ``scene`` with diffuse materials (what both renderers express), one sample a pixel."""
    scene = diffuse_only(scene)
    engine = Engine(scene, device=device)
    _, x, y = frame_lanes(size_px)
    lanes = size_px[0] * size_px[1]
    state = engine.state(view_at(0, RATE_HZ, Fraction(0), size_px, scene.camera))
    theirs = mitsuba_scene(scene, engine.space, size_px)
    as_installed = mitsuba_scene(scene, engine.space, size_px, watertight=False)
    integrator = mi.load_dict({"type": "direct", "emitter_samples": 1, "bsdf_samples": 0})
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})

    def whitted(state: EngineState, x: Any, y: Any) -> Any:
        return engine.sample(state, engine.camera_ray(state, x, y)).color

    def shadow_rays(state: EngineState, x: Any, y: Any) -> Any:
        return engine.sample(state, engine.camera_ray(state, x, y)).rays["shadow"]

    def raw(their_scene: Any, state: EngineState, x: Any, y: Any) -> Any:
        ray = engine.camera_ray(state, x, y)
        return their_scene.ray_intersect(mi.Ray3f(ray.o, ray.d), mi.RayFlags.All, True).t

    def centres(their_scene: Any, state: EngineState, x: Any, y: Any) -> Any:
        ray = engine.camera_ray(state, x, y)
        sampler.seed(0, lanes)
        return integrator.sample(their_scene, sampler, mi.RayDifferential3f(ray.o, ray.d))[0]

    kernels: list[Frozen] = [frozen(whitted), frozen(raw)]
    jobs: tuple[Callable[[], Any], ...] = (
        lambda: kernels[0](lanes, engine.state(view_at(0, RATE_HZ, Fraction(0), size_px, scene.camera)), x, y),
        lambda: kernels[1](lanes, theirs, state, x, y),
        lambda: mi.render(theirs, integrator=integrator, spp=1),
        lambda: mi.render(as_installed, integrator=integrator, spp=1),
    )
    # Interleaved, so that what else the machine does falls on all alike; two runs to warm up.
    times = np.array([[_timed_ms(job) for job in jobs] for _ in range(runs + 2)])[2:]
    whitted_ms, raw_ms, direct_ms, default_ms = np.median(times, axis=0)
    shadow = int(np.asarray(frozen(shadow_rays)(lanes, state, x, y).numpy(), np.int64).sum())
    ours, other = (np.asarray(color.numpy(), np.float64) for color in (jobs[0](), centres(theirs, state, x, y)))
    apart = np.abs(ours - other).max(axis=0)
    mrays = (lanes + shadow) / whitted_ms / 1e3
    raw_mrays = lanes / raw_ms / 1e3
    return WhittedFigures(
        whitted_ms=float(whitted_ms),
        mitsuba_direct_ms=float(direct_ms),
        ratio=float(np.median(times[:, 2] / times[:, 0])),
        mitsuba_default_ms=float(default_ms),
        default_ratio=float(np.median(times[:, 3] / times[:, 0])),
        raw_intersect_mrays_s=float(raw_mrays),
        whitted_mrays_s=float(mrays),
        share=float(mrays / raw_mrays),
        mean_difference=float(np.mean(np.abs(ours - other))),
        differing=float(np.mean(apart > 1e-3)),
    )
