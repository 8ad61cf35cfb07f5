"""What temporally dense rendering saves against vanilla + TAA at one resolution, and how large it runs live.

Both techniques render the same refreshes in turn, so that what else the machine does hits both; ratios are of medians.

A quarter of the pixels costs more than a quarter, since packets of sparse rays part sooner. What was tried on two cores
(960x540, one primary ray and the scene's shadow rays): the Z curve gives 5 to 8 % over rows of 8x8 tiles, Dr.Jit's
block sizes and blocks of 4x2 or 2x4 tiles nothing; the rays of four refreshes in one launch (tests.prove's
packets_across_frames) would raise the saving of tracing from 3.1 to 3.8 (toy_car), 2.6 to 3.7 (tunnel_geom), 3.4 to 4.0
(bar), 3.6 to 4.0 (bart_kitchen) and 3.3 to 3.8 (bart_robots), but needs the camera three refreshes ahead, which no
live display has: the technique does not do it.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from renderers.catalogue import TECHNIQUES
from renderers.clip_frames import technique_params, view_at
from renderers.engine import Engine
from stimuli.scene import Scene

RATE_HZ = Fraction(240)
LIVE_SIZES_PX = ((160, 90), (240, 135), (288, 162), (320, 180), (400, 225), (480, 270), (640, 360))


@dataclass(frozen=True)
class DenseSaving:
    """Milliseconds of TAA by those of temporally dense: trace, whole; ``compositing_ratio``: its by theirs."""

    trace_ratio: float
    whole_ratio: float
    compositing_ratio: float
    taa_ms: float
    dense_ms: float
    stages_ms: dict[str, dict[str, float]]


def _medians(seconds: dict[str, list[float]]) -> dict[str, float]:
    return {name: statistics.median(values) * 1e3 for name, values in seconds.items()}


def measure_saving(
    scene: Scene,
    size_px: tuple[int, int] = (960, 540),
    frames: int = 32,
    warm_up: int = 10,
    start_s: Fraction = Fraction(1),
) -> DenseSaving:
    """Stage times of `taa` and `temporally_dense` on ``scene`` along its own camera, refresh by refresh in turn."""
    engine = Engine(scene)
    names = ("taa", "temporally_dense")
    made = {name: TECHNIQUES[name](engine, size_px, technique_params(name, {}), 0, "stages") for name in names}
    seconds: dict[str, dict[str, list[float]]] = {name: {} for name in names}
    for k in range(warm_up + frames):
        view = view_at(k, RATE_HZ, start_s, size_px, scene.camera, cut=k == 0)
        for name, technique in made.items():
            frame = technique.render(view)
            if k >= warm_up:
                for stage, value in frame.seconds.items():
                    seconds[name].setdefault(stage, []).append(value)
    ms = {name: _medians(seconds[name]) for name in names}
    taa, dense = ms["taa"], ms["temporally_dense"]
    return DenseSaving(
        trace_ratio=taa["trace"] / dense["trace"],
        whole_ratio=taa["total"] / dense["total"],
        compositing_ratio=dense["compose"] / taa["resolve"],
        taa_ms=taa["total"],
        dense_ms=dense["total"],
        stages_ms=ms,
    )


def live_sizes(
    scene: Scene, sizes_px: Sequence[tuple[int, int]] = LIVE_SIZES_PX, frames: int = 120
) -> dict[str, dict[str, float]]:
    """Median and 95th percentile milliseconds a refresh (picture on the host included) at each size.

    What a small size saves is less than its pixels: with the same field of view its rays lie farther apart, so packets
    part sooner. On tunnel_geom one core took 0.17 us a traced pixel at 960x540, 0.28 at 480x270, 0.36 at 320x180 and
    0.56 at 160x90 (shadow ray included). Python took 0.4 ms a refresh at every size.
    """
    engine, params = Engine(scene), technique_params("temporally_dense", {})
    found = {}
    for size_px in sizes_px:
        technique = TECHNIQUES["temporally_dense"](engine, size_px, params, 0, "total")
        taken = []
        for k in range(frames + 16):
            frame = technique.render(view_at(k, RATE_HZ, Fraction(1), size_px, scene.camera, cut=k == 0))
            if k >= 16:
                taken.append(frame.seconds["total"] * 1e3)
        found[f"{size_px[0]}x{size_px[1]}"] = {
            "median_ms": float(np.median(taken)),
            "p95_ms": float(np.percentile(taken, 95)),
        }
    return found
