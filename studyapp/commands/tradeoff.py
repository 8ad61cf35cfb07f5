"""``studyapp tradeoff``: what each technique's accuracy costs on this machine, and what its speed costs in accuracy."""

from __future__ import annotations

import argparse
import json
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

from stimuli.errors import InputError, problem
from studyapp.paper_tables import TABLES

HELP = "speed against accuracy of the techniques on scenes: table, CSV, JSON, plot"
EXAMPLE = (
    "studyapp tradeoff --scene toy_car --technique temporally_dense --technique vanilla --technique taa --size 256x256"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--scene", action="append", metavar="S", help="a name or a file; repeatable (default: toy_car, bar)"
    )
    parser.add_argument("--technique", action="append", metavar="T", help="repeatable (default: all)")
    parser.add_argument("--budget", default="", metavar="N,N", help="samples a second, as in 100k,400k,1.6M")
    parser.add_argument(
        "--size", default=None, metavar="WxH", help="pixels (default 256x256; of weier2016 1182x1464, one eye; of the "
        "errors of herr2021 512x288)",
    )  # fmt: skip
    parser.add_argument(
        "--frames", type=int, default=None, metavar="N", help="compared refreshes (default 16; of dayal2005 100; of "
        "weier2016 30 a cell; of herr2021 7, 3 and 1 for 1, 64 and 256 light samples)",
    )  # fmt: skip
    parser.add_argument("--warm-up", type=int, default=48, metavar="N", help="refreshes before them (default 48)")
    parser.add_argument("--rate", default="240", metavar="HZ", help="the display's (default 240)")
    parser.add_argument("--start", default="1", metavar="S", help="scene second of refresh 0 (default 1)")
    parser.add_argument("--path", default=None, metavar="P", help="camera path: file | still | sway | toycar | FILE")
    parser.add_argument("--animation", default=None, metavar="NAME", help="of a file with several animations")
    parser.add_argument(
        "--trials", type=int, default=4, metavar="N", help="points of each technique's knobs (default 4)"
    )
    parser.add_argument("--spp", type=int, default=64, metavar="N", help="samples of the gold standard (default 64)")
    parser.add_argument(
        "--table", choices=tuple(TABLES), help="a paper's table made here, beside the paper's numbers: "
        + "; ".join(f"{name}: {words}" for name, words in TABLES.items()),
    )  # fmt: skip
    parser.add_argument("--table1", action="store_const", const="dayal2005", dest="table", help="--table dayal2005")
    parser.add_argument(
        "--scale", default=None, metavar="S", help="of herr2021: of the headset's pixels along each side (default 1/4)"
    )
    parser.add_argument(
        "--configuration", default=None, metavar="C", help="of weier2016: small | medium | large (default medium)"
    )
    parser.add_argument(
        "--duration", default="20", metavar="S", help="seconds of each of dayal2005's animations (default 20)"
    )
    parser.add_argument("--lighting", default="direct", choices=("direct", "ambient_occlusion", "probes"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=Path("tradeoff"), metavar="DIR", help="rows, table, plot (default: tradeoff)"
    )
    parser.add_argument("--fresh", action="store_true", help="measure anew what DIR already holds")
    parser.add_argument("--jod", action="store_true", help="ColorVideoVDP too (an optional extra: pip install cvvdp)")
    parser.add_argument(
        "--jod-gaze", action="store_true", help="FovVideoVDP too, looking at --gaze (an extra: pip install pyfvvdp)"
    )
    parser.add_argument(
        "--gaze", default=None, metavar="X,Y", help="degrees right and up of the picture's middle (default: its middle)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")


def number(text: str, where: str) -> float:
    """'400k', '1.6M', '25000' -> samples a second."""
    factor = {"k": 1e3, "K": 1e3, "M": 1e6}.get(text[-1:], 1.0)
    try:
        value = float(text.rstrip("kKM")) * factor
    except ValueError as error:
        raise InputError(problem(where, "number", repr(text), "as in 400k or 1.6M")) from error
    if not value > 0:
        raise InputError(problem(where, "number", text, "more than 0"))
    return value


def size(text: str) -> tuple[int, int]:
    """'256x144' -> (256, 144)."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) > 0 and int(height) > 0):
        raise InputError(problem("--size", "picture size", repr(text), "WxH, as in 256x256"))
    return int(width), int(height)


def gaze(text: str | None) -> tuple[float, float] | None:
    """'10,-5' -> degrees right and up of the middle; None: nothing was said."""
    if text is None:
        return None
    try:
        right, up = (float(part) for part in text.split(","))
        if not (math.isfinite(right) and math.isfinite(up)):
            raise ValueError(text)
    except ValueError as error:
        raise InputError(problem("--gaze", "direction", repr(text), "degrees right,up, as in 10,-5")) from error
    return right, up


def rational(text: str, where: str) -> Fraction:
    """An exact number."""
    try:
        return Fraction(text)
    except (ValueError, ZeroDivisionError) as error:
        raise InputError(problem(where, "number", repr(text), "as in 240 or 60000/1001")) from error


def run(args: argparse.Namespace) -> int:
    """Measure what is not yet there, write everything, print the table."""
    from renderers import operating_points, search, tradeoff, tradeoff_report
    from renderers.jod import require_jod
    from studyapp import paper_tables

    for option in ("--jod", "--jod-gaze"):
        if getattr(args, option[2:].replace("-", "_")):
            require_jod(option)
    budgets = [number(part, "--budget") for part in args.budget.split(",") if part]
    if is_table1(args):
        args.table = "dayal2005"
    asked = paper_tables.asked_of(args)
    if args.table in ("weier2016", "herr2021"):
        return {"weier2016": paper_tables.weier2016, "herr2021": paper_tables.herr2021}[args.table](asked)
    args.size = args.size or "256x256"
    if args.table == "dayal2005":
        return paper_tables.dayal2005(args, budgets or [1e5, 4e5, 8e5])
    names = tradeoff.techniques_for(args.technique)
    conditions = tradeoff.Conditions(
        size_px=size(args.size), rate_hz=rational(args.rate, "--rate"),
        frames=16 if args.frames is None else args.frames, warm_up_frames=args.warm_up,
        start_s=rational(args.start, "--start"), seed=args.seed, reference_spp=args.spp, lighting=args.lighting,
        gaze=gaze(args.gaze),
    )  # fmt: skip
    if (
        conditions.frames < 1
        or conditions.warm_up_frames < 0
        or conditions.rate_hz <= 0
        or conditions.reference_spp < 1
    ):
        raise InputError(problem("tradeoff", "frames, warm-up, rate, spp", "one below its least", "1, 0, above 0, 1"))
    settings = search.settings_of(
        names, conditions.size_px, conditions.rate_hz, budgets, args.trials, args.seed, args.spp
    )
    scenes = args.scene or ["toy_car", "bar"]
    by_scene = {Path(name).stem: scene_rows(name, args, settings, conditions, tuned=True) for name in scenes}
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "tradeoff.json").write_text(json.dumps(by_scene, indent=1))
    tradeoff_report.write_csv(
        [{"scene": s, **row} for s, rows in by_scene.items() for row in rows], args.out / "tradeoff.csv"
    )
    tradeoff_report.plot(by_scene, args.out / "tradeoff.png", conditions.size_px)
    if args.json:
        print(json.dumps(by_scene, indent=1))
    else:
        for name, rows in by_scene.items():
            print(f"\n{name}, {args.size} at {args.rate} Hz, errors x 255 against {args.spp} spp (*: on the front)")
            print(f"the gold standard's own error, from its two halves: {tradeoff_report.gold_error(rows)}")
            if warning := tradeoff_report.busy(rows):
                print(warning)
            print(tradeoff_report.table(rows))
            print("\noperating points: error x 255 (followed gaze: as far as it is resolved), cost, and the front")
            print(operating_points.lines(rows))
            print(f"\nspread over settings\n{tradeoff_report.spread(rows)}")
            print(f"\nat equal cost\n{tradeoff_report.comparisons(rows)}")
            print(f"\nprecision of what is stored, display codes\n{tradeoff_report.precision(rows)}")
        print(f"\nwritten: {args.out / 'tradeoff.csv'}, .json, .png")
    return 0


def is_table1(args: argparse.Namespace) -> bool:
    """Whether Table 1 of Dayal et al. 2005 is asked for: by name, or by its scene and budgets."""
    by_scene = [Path(name).stem for name in args.scene or []] == ["bart_kitchen"]
    return args.table == "dayal2005" or (
        args.table is None and by_scene and bool(args.budget) and not args.technique and args.path is None
    )


def scene_rows(
    name: str, args: argparse.Namespace, settings: list[Any], conditions: Any, tuned: bool = False
) -> list[dict[str, Any]]:
    """The rows of one scene, from DIR where they are there, measured where not. ``tuned``: then also the best setting
    of each technique at the rays a second of `temporally_dense`."""
    from tqdm import tqdm

    from renderers import operating_points, search, tradeoff, tradeoff_report
    from renderers.engine import Engine
    from stimuli import load_scene
    from stimuli.camera_path import chosen_path
    from stimuli.clip_request import ENGINE_VERSION

    scene = load_scene(name, animation=args.animation)
    for note in scene.notes:
        print(f"{scene.name}: {note}")
    camera = chosen_path(scene, args.path)
    file = tradeoff.RowFile(args.out / "rows.jsonl")
    known = {} if args.fresh else dict(file.rows)
    columns = [column for column in ("jod", "jod_gaze") if getattr(args, column, False)]
    made: list[tuple[Any, Any, Any]] = []
    with tqdm(total=conditions.frames + len(settings), desc=Path(name).stem, disable=None) as bar:

        def measured(setting: Any) -> dict[str, Any]:
            key = tradeoff.RowFile.key(scene, camera, setting, conditions, ENGINE_VERSION)
            if key not in known or any(column not in known[key] for column in columns):
                if not made:
                    engine = Engine(scene, lighting=args.lighting)
                    gold = tradeoff.gold_standard(engine, camera, conditions, bar.update)
                    made.append((engine, gold, tradeoff.perceptual_metrics(columns, camera, gold, conditions)))
                engine, gold, perceptual = made[0]
                bar.set_postfix_str(setting.label)
                row = tradeoff.measure_setting(engine, camera, setting, gold, conditions, perceptual)
                known[key] = file.add(key, row)
            bar.update(1)
            return known[key]

        rows = [measured(setting) for setting in settings]
        if tuned:
            more = search.tuned_to_equal_rays(rows, conditions.size_px, conditions.rate_hz)
            bar.total = conditions.frames + len(settings) + len(more)
            rows += [measured(setting) for setting in more]
        if not made:
            bar.update(conditions.frames)  # no gold standard was needed
    return operating_points.judged(tradeoff_report.with_ratios(rows))
