"""Two workers against one on the same units, each worker of one thread: at least 1.8 times as fast on two free cores.

Rendering only: the time from the first to the last finished sample block of the reference, once every worker has loaded
its scene and compiled its kernels. Beside the rates stand what the workers got of the processors and what they made of
it, which tells a machine that others use from workers that are in each other's way.
``python -m tests.prove.worker_speedup`` writes evidence/worker_speedup.json.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil

from renderers.produce import units_of
from renderers.render_unit import RENDERER
from renderers.worker_pool import Task, run_local
from stimuli import load_scene
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob
from stimuli.clip_request import ClipRequest
from tests.evidence import write_evidence


@dataclass(frozen=True)
class Rate:
    """Primary samples a second while all workers are at work; a processor second of theirs; processors they had."""

    a_second: float
    a_processor_second: float
    processors: float


def _worker_seconds() -> float:
    """Processor seconds of this process's children so far."""
    times = [child.cpu_times() for child in psutil.Process().children(recursive=True)]
    return sum(time.user + time.system for time in times)


def measure(workers: int, frames: int, folder: Path) -> Rate:
    """The tunnel's reference (16 spp, 192x144) by so many workers."""
    scene = load_scene("tunnel_geom")
    request = ClipRequest(
        scene="tunnel", scene_sha256=scene.sha256, technique="reference", params={"spp": 16}, size_px=(192, 144),
        rate_hz="240", duration_s=f"{frames}/240", start_s="1", warm_up_s="0", exposure=0.5,
    )  # fmt: skip
    job = ClipJob(request, "tunnel_geom")
    frame_samples = 192 * 144 * 16
    tasks = [Task(job, unit, (unit.stop - unit.first) * frame_samples) for unit in units_of(request)]
    store = ClipStore(folder / f"workers-{workers}")
    marks: list[tuple[float, float, int]] = []
    for event in run_local(store, tasks, RENDERER, workers):
        assert event.kind in ("samples", "made"), event.text
        if event.kind == "samples":
            marks.append((time.perf_counter(), _worker_seconds(), event.samples))
    # the first frames stand for loading and compiling, the last ones for workers without a unit
    inner = marks[4 * workers : len(marks) - frames // len(tasks)]
    made = sum(samples for *_, samples in inner[1:])
    wall, used = inner[-1][0] - inner[0][0], inner[-1][1] - inner[0][1]
    return Rate(made / wall, made / used, used / wall)


def main(arguments: list[str] | None = None) -> int:
    """Measure alternately, write, and end with 1 below 1.8."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=240)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", default="evidence/worker_speedup.json")
    args = parser.parse_args(arguments)
    rates: dict[int, list[Rate]] = {1: [], 2: []}
    with TemporaryDirectory() as name:
        psutil.cpu_percent()
        for number in range(args.rounds):
            for workers in (1, 2):
                rates[workers].append(measure(workers, args.frames, Path(name) / str(number)))
    best = {workers: max(found, key=lambda rate: rate.a_second) for workers, found in rates.items()}
    ratio = best[2].a_second / best[1].a_second
    result: dict[str, Any] = {
        "samples_a_second": {str(k): [round(rate.a_second) for rate in v] for k, v in rates.items()},
        "processors_they_had": {str(k): [round(rate.processors, 2) for rate in v] for k, v in rates.items()},
        "samples_a_processor_second": {
            str(k): [round(rate.a_processor_second) for rate in v] for k, v in rates.items()
        },
        "speedup": round(ratio, 3),
        "speedup_of_two_undisturbed": round(
            2 * max(r.a_processor_second for r in rates[2]) / max(r.a_processor_second for r in rates[1]), 3
        ),
        "load_average": psutil.getloadavg(),
        "passed": ratio >= 1.8,
    }
    write_evidence("worker_speedup", result, args.out)
    print(json.dumps(result, indent=2))
    return 0 if result["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
