"""What a quarter of the pixels would cost if the rays of four refreshes shared their packets.

Three ways to trace four refreshes of temporally dense rendering, the same primary and shadow rays each: *apart*, as the
technique does, a launch of a quarter of the pixels for each refresh; *together*, one launch of all pixels along the Z
curve, each with the time of its refresh, so that the four rays of a 2x2 tile lie in one packet; and *full*, one whole
frame at one time, which is what no sparse tracing can beat by coherence alone. Together needs the cameras and movers of
three refreshes to come, and its pictures come three refreshes late: it is for stored clips, not for a live display.

``python -m tests.prove.packets_across_frames [SCENE ...]`` (default: the embedded scenes and the assets' rooms) writes
evidence/packets_across_frames.json: medians of milliseconds, and what a sparse refresh saves against a whole frame.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.clip_frames import view_at
from renderers.engine import Engine, EngineState
from renderers.frozen import frozen, opaque_float, opaque_uint
from renderers.pixels import tile_order
from stimuli.load import load_scene
from stimuli.scene import Scene
from tests.evidence import write_evidence

RATE_HZ = Fraction(240)
SIZE_PX = (960, 540)
ROUNDS = 12


def lanes(step: int, sub: int) -> tuple[Any, Any, Any]:
    """Pixel centres (Float x, y) and subframes (UInt32) of every ``step``-th pixel a row and column, on a Z curve."""
    width, height = SIZE_PX[0] // step, SIZE_PX[1] // step
    order = tile_order(width, height).astype(np.int64)
    x, y = order % width, order // width
    frame = (x & 1) + 2 * (y & 1) if step == 1 else np.full(len(order), sub)
    px, py = (x, y) if step == 1 else (2 * x + (sub & 1), 2 * y + (sub >> 1))
    return opaque_float(px + 0.5), opaque_float(py + 0.5), opaque_uint(frame)


def measured(scene: Scene) -> dict[str, Any]:
    """Median ms of the three ways, in turn in every round, and how far their pictures lie apart."""
    engine = Engine(scene)

    def at_t1(state: EngineState, x: Any, y: Any, frame: Any) -> Any:
        sample = engine.sample(state, engine.camera_ray(state, x, y), rng=frame)
        return sample.color, sample.rays["shadow"]

    def in_time(state: EngineState, x: Any, y: Any, frame: Any, step_s: Any) -> Any:
        time_s = (mi.Float(frame) - 3) * step_s
        sample = engine.sample(state, engine.camera_ray(state, x, y, time_s), time_s, rng=frame)
        return sample.color, sample.rays["shadow"]

    apart_kernel, full_kernel, together_kernel = frozen(at_t1), frozen(at_t1), frozen(in_time)
    quarter, whole = [lanes(2, sub) for sub in range(4)], lanes(1, 0)
    n_quarter, n_whole = SIZE_PX[0] * SIZE_PX[1] // 4, SIZE_PX[0] * SIZE_PX[1]
    step_s = opaque_float(1 / float(RATE_HZ))
    taken: dict[str, list[float]] = {"apart": [], "together": [], "full": []}
    pictures: dict[str, Any] = {}

    def timed(name: str, work: Callable[[], list[Any]]) -> None:
        dr.sync_thread()
        began = time.perf_counter()
        made = work()
        dr.eval(made)
        dr.sync_thread()
        taken[name].append((time.perf_counter() - began) * 1e3)
        pictures[name] = made

    for k in range(ROUNDS + 2):
        views = [view_at(4 * k + sub, RATE_HZ, Fraction(1), SIZE_PX, scene.camera) for sub in range(4)]
        spanning = replace(views[3], t0=views[0].t1)

        def apart(views: Any = views) -> list[Any]:
            return [apart_kernel(n_quarter, engine.state(view), *quarter[sub]) for sub, view in enumerate(views)]

        timed("apart", apart)
        timed("together", lambda v=spanning: [together_kernel(n_whole, engine.state(v), *whole, step_s)])
        timed("full", lambda v=views[3]: [full_kernel(n_whole, engine.state(v), *whole)])
    ms = {name: statistics.median(values[2:]) for name, values in taken.items()}
    return {
        **{f"{name}_ms": value for name, value in ms.items()},
        "saving_apart": 4 * ms["full"] / ms["apart"],
        "saving_together": 4 * ms["full"] / ms["together"],
        "differing_share": differing(pictures, whole),
    }


def differing(pictures: dict[str, Any], whole: tuple[Any, Any, Any]) -> float:
    """Share of pixels in which tracing together and apart differ by more than 1e-3 of the brighter one."""
    found = np.zeros((SIZE_PX[1], SIZE_PX[0], 3))
    for sub, (color, _) in enumerate(pictures["apart"]):
        x, y, _frame = lanes(2, sub)
        found[y.numpy().astype(int), x.numpy().astype(int)] = color.numpy().T
    x, y, _frame = whole
    together = pictures["together"][0][0].numpy().T
    own = found[y.numpy().astype(int), x.numpy().astype(int)]
    apart = np.abs(own - together) > 1e-3 * np.maximum(np.maximum(own, together), 1e-3)
    return float(apart.any(axis=1).mean())


def main(names: list[str]) -> None:
    """Measure and write."""
    assets = Path(os.environ["STUDYAPP_ASSETS"]) if "STUDYAPP_ASSETS" in os.environ else None
    if not names:
        names = ["toy_car", "bar", "tunnel_geom"]
        if assets is not None:
            names += [str(next(assets.rglob(f"{room}.glb"))) for room in ("bart_kitchen", "bart_robots", "white_room")]
    rows = {}
    for name in names:
        rows[Path(name).stem] = row = measured(load_scene(name))
        print(Path(name).stem, {key: round(value, 4) for key, value in row.items()}, flush=True)
    write_evidence("packets_across_frames", rows)


if __name__ == "__main__":
    main(sys.argv[1:])
