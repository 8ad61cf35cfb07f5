"""``studyapp recommend``: the most accurate setting that this machine holds at the rate."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

from stimuli.errors import InputError, problem

HELP = "the most accurate setting that this machine holds within so many ms a frame"
EXAMPLE = "studyapp recommend --budget-ms 4.17 --size 256x144 --scene toy_car"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--budget-ms", type=float, metavar="MS", help="of a frame (default: one refresh)")
    parser.add_argument("--size", default="256x144", metavar="WxH", help="pixels (default 256x144)")
    parser.add_argument("--scene", default="toy_car", metavar="S", help="a name or a file (default toy_car)")
    parser.add_argument("--technique", action="append", metavar="T", help="repeatable (default: all)")
    parser.add_argument("--rate", default="240", metavar="HZ", help="the display's (default 240)")
    parser.add_argument("--path", default=None, metavar="P", help="camera path: file | still | sway | toycar | FILE")
    parser.add_argument("--animation", default=None, metavar="NAME", help="of a file with several animations")
    parser.add_argument("--start", default="1", metavar="S", help="scene second of refresh 0 (default 1)")
    parser.add_argument(
        "--trials", type=int, default=2, metavar="N", help="points of each technique's knobs (default 2)"
    )
    parser.add_argument("--lighting", default="direct", choices=("direct", "ambient_occlusion", "probes"))
    parser.add_argument("--frames", type=int, default=120, metavar="N", help="of the last timing (default 120)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("tradeoff"),
        metavar="DIR",
        help="rows of `studyapp tradeoff` (default: tradeoff)",
    )
    parser.add_argument("--fresh", action="store_true", help="measure anew what DIR already holds")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Measure what is missing, time the best anew, and say which setting holds; exit 1 where none does."""
    from renderers import recommend, search, tradeoff
    from renderers.clip_frames import scene_exposure
    from renderers.engine import Engine
    from stimuli import load_scene
    from stimuli.camera_path import chosen_path
    from studyapp.cli import JobFailed
    from studyapp.commands.tradeoff import rational, scene_rows, size

    rate = rational(args.rate, "--rate")
    if rate <= 0:
        raise InputError(problem("--rate", "refreshes a second", args.rate, "above 0"))
    budget_ms = float(1000 / rate) if args.budget_ms is None else args.budget_ms
    if not (math.isfinite(budget_ms) and budget_ms > 0):
        raise InputError(problem("--budget-ms", "ms a frame", args.budget_ms, "above 0"))
    if args.frames < 8:
        raise InputError(problem("--frames", "frames", args.frames, "at least 8"))
    size_px = size(args.size)
    conditions = tradeoff.Conditions(
        size_px=size_px, rate_hz=rate, frames=16, warm_up_frames=16, start_s=rational(args.start, "--start"),
        seed=args.seed, reference_spp=16, lighting=args.lighting,
    )  # fmt: skip
    names = tradeoff.techniques_for(args.technique)
    settings = search.settings_of(names, size_px, rate, [], args.trials, args.seed)
    settings = [setting for setting in settings if setting.rate_hz == rate]
    rows = scene_rows(args.scene, args, settings, conditions)
    scene = load_scene(args.scene, animation=args.animation)
    camera = chosen_path(scene, args.path)
    engine = Engine(scene, lighting=args.lighting)
    exposure = scene_exposure(engine, camera, conditions.start_s)
    found = list(recommend.tried(engine, camera, rows, budget_ms, conditions, exposure, args.frames))
    if not found or not found[-1].holds(budget_ms):
        fastest = min(rows, key=lambda row: row["ms_p95"])
        shrink = math.sqrt(budget_ms / fastest["ms_p95"]) * 0.95
        fits = f"{max(1, int(size_px[0] * shrink))}x{max(1, int(size_px[1] * shrink))}"
        raise JobFailed(
            f"no setting keeps {budget_ms:g} ms at {args.size}: the fastest, {fastest['label']}, takes"
            f" {fastest['ms_p95']:.2f} ms in 95 % of frames; about {fits} would fit"
        )
    if args.json:
        print(
            json.dumps({"budget_ms": budget_ms, "size": args.size, "tried": [_plain(held) for held in found]}, indent=1)
        )
        return 0
    for held in found[:-1]:
        print(f"does not hold: {held.row['label']}: 95 % within {held.ms_p95:.2f} ms")
    best = found[-1]
    print(f"{best.row['label']}")
    print(
        f"  {scene.name}, {args.size} at {args.rate} Hz:"
        f" median {best.ms_median:.2f} ms, 95 % within {best.ms_p95:.2f} ms"
    )
    print(
        f"  RMSE {best.row['rmse_still'] * 255:.2f} (still eye), {best.row['rmse_tracking'] * 255:.2f} (tracking eye)"
        f" display codes; budget {budget_ms:g} ms"
    )
    print(f"  params: {json.dumps(best.row['params'])}")
    return 0


def _plain(held: Any) -> dict[str, Any]:
    """One timed candidate as plain values."""
    return {
        "label": held.row["label"],
        "technique": held.row["technique"],
        "params": held.row["params"],
        "ms_median": held.ms_median,
        "ms_p95": held.ms_p95,
        "rmse_still": held.row["rmse_still"],
        "rmse_tracking": held.row["rmse_tracking"],
    }
