"""``studyapp tradeoff --table``: the tables of the papers, made here and printed beside the paper's own numbers."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath, Scene

TABLES = {
    "dayal2005": "Table 1 of Dayal et al. 2005 at 60 Hz (adaptive frameless)",
    "weier2016": "Table 1 of Weier et al. 2016 (foveated) on the study's four scenes under three kinds of light",
    "herr2021": "Table 1 of Peuhkurinen and Mikkonen 2021 (polar), and errors at equal rays",
}

_FIXED: dict[str, Any] = {
    "technique": None, "budget": "", "rate": "240", "lighting": "direct", "spp": 64, "trials": 4, "warm_up": 48,
    "jod": False, "jod_gaze": False, "gaze": None, "seed": 0, "duration": "20",
}  # fmt: skip
"""Options of `studyapp tradeoff`, with their defaults, that weier2016 and herr2021 fix themselves."""


@dataclass(frozen=True)
class Asked:
    """What the command line asks of a table, checked. ``size_px``, ``frames``: None: the table's own."""

    scenes: tuple[str, ...]
    size_px: tuple[int, int] | None
    frames: int | None
    animation: str | None
    path: str | None
    scale: Fraction | None
    configuration: str | None
    start_s: Fraction
    out: Path
    fresh: bool
    as_json: bool


class _Rows:
    """The rows of one table in DIR: measured where they are missing, each kept as soon as it is there."""

    def __init__(self, asked: Asked, name: str) -> None:
        from renderers.tradeoff import RowFile

        self._file, self._fresh = RowFile(asked.out / f"{name}.jsonl"), asked.fresh

    def of(self, keys: Sequence[str], measure: Callable[[int], dict[str, Any]]) -> list[dict[str, Any]]:
        """The rows of ``keys``; ``measure(i)`` makes the i-th."""
        return [
            self._file.add(key, measure(i)) if self._fresh or key not in self._file.rows else self._file.rows[key]
            for i, key in enumerate(keys)
        ]


def asked_of(args: argparse.Namespace) -> Asked:
    """The options of ``studyapp tradeoff`` that a table takes. Raises InputError for one that it does not."""
    from studyapp.commands.tradeoff import rational, size

    only = {"scale": "herr2021", "configuration": "weier2016"}
    for option, table in only.items():
        if getattr(args, option) is not None and args.table != table:
            got = f"with {'no --table' if args.table is None else f'--table {args.table}'}"
            raise InputError(problem(f"--{option}", "option", got, f"--table {table}"))
    if args.table in ("weier2016", "herr2021"):
        fixed = [option for option, default in _FIXED.items() if getattr(args, option) != default]
        if fixed:
            got = ", ".join(f"--{option.replace('_', '-')}" for option in fixed)
            wanted = "what the paper leaves open (--scene, --size, --frames, --start, --path)"
            raise InputError(problem(f"--table {args.table}", "option", got, wanted))
    return Asked(
        scenes=tuple(args.scene or ()), size_px=size(args.size) if args.size else None, frames=args.frames,
        animation=args.animation, path=args.path, scale=None if args.scale is None else rational(args.scale, "--scale"),
        configuration=args.configuration, start_s=rational(args.start, "--start"), out=args.out, fresh=args.fresh,
        as_json=args.json,
    )  # fmt: skip


def dayal2005(args: argparse.Namespace, budgets: list[float]) -> int:
    """Measure the lines of Table 1 that DIR lacks; write and print them beside the paper's numbers."""
    from tqdm import tqdm

    from renderers import table1
    from renderers.engine import Engine
    from renderers.tradeoff import RowFile
    from stimuli import load_scene
    from stimuli.camera_path import camera_path
    from stimuli.clip_request import ENGINE_VERSION
    from studyapp.commands.tradeoff import rational, size

    frames, duration_s = 100 if args.frames is None else args.frames, rational(args.duration, "--duration")
    if frames < 1 or args.spp < 1:
        raise InputError(problem("tradeoff", "frames and spp", f"{frames} and {args.spp}", "at least 1"))
    if not 1 < duration_s <= 20:
        raise InputError(problem("--duration", "seconds", args.duration, "more than 1 (the warm-up), at most 20"))
    if len(args.scene or []) != 1:
        raise InputError(problem("--scene", "scenes of Table 1", len(args.scene or []), "one, with a toy car in it"))
    scene = load_scene(args.scene[0], animation=args.animation)
    c = table1.Conditions(
        size_px=size(args.size), duration_s=duration_s, compared=frames, reference_spp=args.spp, seed=args.seed
    )
    file, engine, rows = RowFile(args.out / "table1.jsonl"), None, []
    for animation, path in table1.ANIMATIONS.items():
        lines = table1.methods(budgets)
        keys = [table1.key(scene.sha256, animation, line, c, ENGINE_VERSION) for line in lines]
        missing = [k for k, key in enumerate(keys) if args.fresh or key not in file.rows]
        if missing:
            engine = engine or Engine(scene)
            camera = camera_path(scene, path)
            with tqdm(total=len(c.refreshes) * (1 + len(missing)), desc=animation, disable=None) as bar:
                gold = table1.gold_standard(engine, camera, c, bar.update)
                for k in missing:
                    bar.set_postfix_str(f"{lines[k].label} {lines[k].samples_per_s}")
                    file.add(keys[k], table1.measure(engine, camera, lines[k], gold, c, bar.update))
        rows += table1.with_ratios(animation, [file.rows[key] for key in keys])
    (args.out / "table1.json").write_text(json.dumps(rows, indent=1))
    table1.write_curves(rows, c, args.out / "table1_errors.csv")
    table1.plot(rows, c, args.out / "table1.png")
    print(json.dumps(rows, indent=1) if args.json else table1.table(rows))
    if not args.json:
        print(
            f"\nRMS x 255 of {len(c.refreshes)} refreshes in seconds 1 to {args.duration} (the animations: 20 s) "
            f"against {c.reference_spp} samples a pixel without delay, {args.size} at 60 Hz; ratio: to {table1.FULL} "
            "(double buffered); *: least error at its samples a second; ms: of a refresh on this machine"
        )
        print(f"written: {args.out / 'table1.json'}, .jsonl, .png, {args.out / 'table1_errors.csv'}")
    return 0


def weier2016(asked: Asked) -> int:
    """Measure the cells that DIR lacks, print them beside the paper's Table 1, write JSON and plot."""
    from tqdm import tqdm

    from renderers.foveated import table, table_report
    from renderers.stereo import field_words
    from stimuli.clip_request import ENGINE_VERSION

    c = table.Conditions(
        frames=30 if asked.frames is None else asked.frames, size_px=asked.size_px, start_s=asked.start_s,
        configuration=asked.configuration or "medium",
    )  # fmt: skip
    c.check()
    rows, cells = _Rows(asked, "weier2016"), []
    for scene, camera in _scenes(asked, list(table.SCENES)):
        keys = [table.key(scene.sha256, setting, camera, c, ENGINE_VERSION) for setting in table.SETTINGS]

        def measured(i: int, scene: Scene = scene, camera: CameraPath = camera) -> dict[str, Any]:
            setting = table.SETTINGS[i]
            with tqdm(total=c.warm_up + c.frames, desc=f"{scene.name}, {setting}", disable=None) as bar:
                return asdict(table.measure_cell(scene, setting, c, camera, progress=bar.update))

        cells += [table.Cell.of(row) for row in rows.of(keys, measured)]
    if not cells:
        raise InputError(problem("--table weier2016", "scenes", "none", " | ".join(table.SCENES)))
    found = table.summary(cells)
    _write(asked, "weier2016", found, lambda path: table_report.plot(cells, path))
    if not asked.as_json:
        width, height = c.picture_px
        print(
            f"Table 1 of Weier et al. 2016: {width}x{height}, {field_words(c.headset.yfov_rad, c.picture_px)}, "
            f"gaze at the centre, {c.configuration}, {c.frames} frames a cell, ms are medians\n\n"
            f"{table_report.table(cells)}\n\n"
            f"errors against full ray tracing by eccentricity (degrees)\n{table_report.rings(cells)}"
        )
    return _said(asked, "weier2016")


def herr2021(asked: Asked) -> int:
    """Measure the rows that DIR lacks, print them beside the paper's Table 1, write JSON and plot."""
    from tqdm import tqdm

    from renderers.polar import table, table_report
    from stimuli.clip_request import ENGINE_VERSION

    plain = table.Conditions()
    c = table.Conditions(
        scale=plain.scale if asked.scale is None else asked.scale, frames=asked.frames, start_s=asked.start_s,
        error_px=asked.size_px or plain.error_px,
    )  # fmt: skip
    c.check()
    if len(asked.scenes) > 1:
        raise InputError(problem("--scene", "scenes of --table herr2021", len(asked.scenes), "one"))
    ((scene, camera),) = _scenes(asked, [table.SCENE])
    names = [*(f"samples {n}" for n in table.LIGHT_SAMPLES), *(f"errors {mapping}" for mapping in table.MAPPINGS)]
    keys = [table.key(scene.sha256, name, camera, c, ENGINE_VERSION) for name in names]

    def measured(i: int) -> dict[str, Any]:
        if i >= len(table.LIGHT_SAMPLES):
            with tqdm(total=1, desc=names[i], disable=None) as bar:
                return table.measure_errors(scene, camera, table.MAPPINGS[i - len(table.LIGHT_SAMPLES)], c, bar.update)
        samples = table.LIGHT_SAMPLES[i]
        with tqdm(total=c.frames_of(samples) + 1, desc=f"{samples} light samples", disable=None) as bar:
            return table.measure_times(scene, camera, samples, c, bar.update)

    found = table.summary(_Rows(asked, "herr2021").of(keys, measured), scene, c)
    _write(asked, "herr2021", found, lambda path: table_report.plot(found, path))
    if not asked.as_json:
        sizes = ", ".join(f"{name} {w}x{h}" for name, (w, h) in found["times"][0]["viewports"].items())
        print(
            f"Table 1 of Peuhkurinen and Mikkonen 2021 in {scene.name}: the headset's four viewports scaled by "
            f"{asked.scale or c.scale} along each side ({sizes}), probes in both\n\n{table_report.times(found)}\n\n"
            f"errors (x 255) at equal rays, {c.error_px[0]}x{c.error_px[1]}, gaze at {c.gaze} degrees, "
            f"{c.error_samples} light samples, by eccentricity (degrees)\n{table_report.errors(found)}"
        )
    return _said(asked, "herr2021")


def _scenes(asked: Asked, default: Sequence[str]) -> list[tuple[Scene, CameraPath]]:
    """The scenes asked for with their camera paths; of the defaults, those that are there."""
    from stimuli import load_scene
    from stimuli.camera_path import chosen_path
    from stimuli.procedural import SCENES
    from studyapp.commands.check import find_scene

    found = []
    for name in asked.scenes or default:
        source: Path | str | None = name
        if not asked.scenes and name not in SCENES:
            source = find_scene(f"{name}.glb", Path.cwd())
            if source is None:
                print(f"{name}: no {name}.glb here or below $STUDYAPP_ASSETS, left out", file=sys.stderr)
                continue
        assert source is not None
        scene = load_scene(source, animation=asked.animation)
        found.append((scene, chosen_path(scene, asked.path)))
    return found


def _write(asked: Asked, name: str, found: dict[str, Any], plot: Callable[[Path], None]) -> None:
    asked.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(found, indent=1)
    (asked.out / f"{name}.json").write_text(text)
    plot(asked.out / f"{name}.png")
    if asked.as_json:
        print(text)


def _said(asked: Asked, name: str) -> int:
    if not asked.as_json:
        print(f"\nwritten: {asked.out / f'{name}.json'}, .jsonl, .png")
    return 0
