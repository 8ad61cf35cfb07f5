"""Same seed, same bytes: every technique's stored clip from this process with all its threads, from two workers of one
thread each, and from this process again.

Two scenes (mirrors and movers; textures), all three lightings for the techniques that trace whole pictures, channels
included. ``python -m tests.prove.workers_alike`` writes evidence/workers_alike.json.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import renderers.units
from renderers.catalogue import CATALOGUE
from renderers.produce import produce
from stimuli import load_scene
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob
from stimuli.clip_request import ClipRequest
from tests.evidence import write_evidence
from tests.renderers.test_produce import all_files

SIZE_PX = (40, 28)
PARAMS: dict[str, dict[str, Any]] = {
    "reference": {"spp": 70}, "polar": {"width": 32, "height": 24}, "adaptive_frameless": {"samples_per_s": 60_000.0},
    "traditional_frameless": {"samples_per_s": 60_000.0}, "framed_low_resolution": {"samples_per_s": 60_000.0},
    "framed_low_rate": {"samples_per_s": 60_000.0},
}  # fmt: skip


def work(frames: int) -> list[ClipJob]:
    """A clip of each technique in both scenes, and of the whole-picture ones under other lightings."""
    jobs = []
    for scene_name in ("toy_car", "tunnel_maps"):
        scene = load_scene(scene_name)
        for name, entry in CATALOGUE.items():
            channels = ["Z", "motion.X", "motion.Y", *(["samples"] if entry.counts_samples else [])]
            asked = ClipRequest(
                scene=scene_name, scene_sha256=scene.sha256, technique=name, params=PARAMS.get(name, {}),
                size_px=SIZE_PX, rate_hz="240", duration_s=f"{frames}/240", start_s="1", warm_up_s="1/80", seed=11,
                exposure=1.0, extra={"channels": channels},
            )  # fmt: skip
            jobs.append(ClipJob(asked, scene_name))
            if scene_name == "toy_car" and entry.framed:
                jobs += [
                    ClipJob(replace(asked, lighting=lighting), scene_name)
                    for lighting in ("ambient_occlusion", "probes")
                ]
    return jobs


def prove(frames: int) -> dict[str, Any]:
    """Render three times; which clips differ."""
    renderers.units.UNIT_SAMPLES = 2 * SIZE_PX[0] * SIZE_PX[1]  # small clips, and still several units each
    jobs = work(frames)
    began = time.perf_counter()
    with TemporaryDirectory() as folder:
        stores = {name: ClipStore(Path(folder) / name) for name in ("one", "two", "again")}
        poisoned = [
            f"{unit.label}: {unit.reason}"
            for name, store in stores.items()
            for unit in produce(jobs, store, 2 if name == "two" else 1, bar=False).poisoned
        ]
        files = {name: all_files(store) for name, store in stores.items()}
    labels = {
        job.request.identity: f"{job.request.scene} {job.request.technique} {job.request.lighting}" for job in jobs
    }
    apart = {
        name: sorted(
            {labels[file.split("/")[0]] for file, data in files["one"].items() if files[name].get(file) != data}
        )
        for name in ("two", "again")
    }
    return {
        "clips": len(jobs),
        "files": len(files["one"]),
        "other_bytes_from_two_workers": apart["two"],
        "other_bytes_again": apart["again"],
        "failed": poisoned,
        "seconds": round(time.perf_counter() - began, 1),
        "load_average": os.getloadavg(),
        "passed": not poisoned
        and not apart["two"]
        and not apart["again"]
        and files["one"].keys() == files["two"].keys(),
    }


def main(arguments: list[str] | None = None) -> int:
    """Compare, write the evidence; exit code 1 where a byte differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--out", default="evidence/workers_alike.json")
    args = parser.parse_args(arguments)
    result = prove(args.frames)
    write_evidence("workers_alike", result, args.out)
    print(json.dumps(result, indent=2))
    return 0 if result["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
