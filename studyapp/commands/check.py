"""``studyapp check``: every problem of a protocol at once, or what the protocol amounts to."""

from __future__ import annotations

import argparse
import difflib
import json
import os
from collections.abc import Iterator
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

from protocols.check import Summary, size_problems, summarise
from protocols.gaze_demands import SAME_SAMPLES_OVERRIDE, same_samples_problems
from protocols.load import library_path, load_study, located, read_root
from protocols.names import Loc, Problem
from protocols.study import Study
from stimuli.errors import InputError, problem
from stimuli.procedural import SCENES
from studyapp.store_root import store_directory

HELP = "find every mistake in a protocol, or print its plan in numbers"
EXAMPLE = "studyapp check demo"
SCENE_SUFFIXES = (".glb", ".gltf", ".obj", ".ply")


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("--json", action="store_true", help="the plan as JSON")
    parser.add_argument("--override", action="append", default=[], metavar="CHECK=REASON",
                        help=f"go on although a check fails ({SAME_SAMPLES_OVERRIDE}); repeatable")  # fmt: skip
    parser.add_argument("--store", default=None, metavar="DIR",
                        help="clips whose luminance is compared (default: $STUDYAPP_STORE, else .clips beside the "
                        "protocol); those not made yet are not waited for")  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Check and print; every problem at once."""
    missing, notes = missing_scenes(args.protocol)
    try:
        study = load_study(args.protocol)
    except InputError as error:
        raise InputError(*error.problems, *missing) from error
    problems = located(read_root(args.protocol), [*size_problems(study), *external_problems(study)]) + missing
    alike, reason = same_samples_problems(study), named_reasons(args.override).get(SAME_SAMPLES_OVERRIDE)
    if reason is None:
        problems += alike
    else:
        notes += [f"overridden ({reason}): {line}" for line in alike]
    if not problems:
        problems += _luminance(study, args)
    if problems:
        raise InputError(*problems)
    summary = summarise(study)
    if args.json:
        data = asdict(summary)
        data["notes"] = [*summary.notes, *notes]
        print(json.dumps(data, indent=1))
    else:
        print("\n".join([*_lines(summary), *(f"note: {note}" for note in [*summary.notes, *notes])]))
    return 0


def _luminance(study: Study, args: argparse.Namespace) -> list[str]:
    root = store_directory(args.protocol, args.store)
    if not root.is_dir():
        return []
    # Only now: the formats of clips take longer to import than a protocol takes to check.
    from stimuli.clip import ClipStore
    from studyapp.stored_luminance import stored_luminance_problems

    return stored_luminance_problems(study, ClipStore(root))


def named_reasons(given: list[str]) -> dict[str, str]:
    """['a=b', ...] -> {a: b}. Raises InputError on anything else."""
    found = {}
    for value in given:
        name, equals, text = value.partition("=")
        if not (name and equals and text.strip()):
            raise InputError(problem("--override", "value", repr(value), "CHECK=REASON"))
        found[name] = text
    return found


def find_scene(source: str, beside: Path) -> Path | str | None:
    """Where a scene comes from: a procedural name as it is; a file beside the protocol, in the current folder or
    (anywhere below) $STUDYAPP_ASSETS; None where it is nowhere."""
    if not source.endswith(SCENE_SUFFIXES):
        return source if source in SCENES else None
    try:
        for folder in (beside, Path.cwd()):
            if (folder / source).is_file():
                return folder / source
        assets = os.environ.get("STUDYAPP_ASSETS")
        found = sorted(Path(assets).rglob(Path(source).name)) if assets else []
    except (OSError, ValueError):  # a name that the file system does not take
        return None
    return found[0] if found else None


def missing_scenes(protocol: str) -> tuple[list[str], list[str]]:
    """Scenes that are nowhere, a line each at its place; and notes on those for which another stands in. From the file
    as written, so that they are found beside other mistakes."""
    root, beside = read_root(protocol), library_path(protocol).parent
    problems: list[Problem] = []
    notes: list[str] = []
    _, scenes = (root.entries or {}).get("scenes", (root.mark, root))
    for name, (_, node) in (scenes.entries or {}).items() if scenes is not root else ():
        said = node.plain() if node.entries is not None else {"scene": node.scalar}
        source, instead = said.get("scene"), said.get("instead")
        if not isinstance(source, str) or find_scene(source, beside) is not None:
            continue  # what is no name is told by the loader
        if instead is None:
            near = difflib.get_close_matches(source[:64], list(SCENES), n=1)
            wanted = (f"{near[0]!r} (did you mean that?), " if near else "") + "a procedural scene ("
            wanted += " | ".join(SCENES) + ") or an existing file"
            problems.append((("scenes", name, "scene"), f"scenes.{name}", repr(source), wanted))
        else:
            notes.append(f"scene {name}: {source} is not there, {instead} stands in")
    return located(root, problems), notes


def external_problems(study: Study) -> Iterator[Problem]:
    """Techniques named ``module:Class`` that cannot be imported, or whose parameters are refused by their own model."""
    for name, condition in study.conditions.items():
        if not condition.external or condition.technique.startswith("imported:"):
            continue
        loc: Loc = ("conditions", name)
        module, _, attribute = condition.technique.partition(":")
        try:
            technique = getattr(import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            said = str(error) or type(error).__name__
            wanted = f"an importable module:Class ({said})"
            yield (*loc, "technique"), f"conditions.{name}.technique", repr(condition.technique), wanted
            continue
        try:
            technique.Params.model_validate(condition.params)
        except (ValueError, AttributeError) as error:
            wanted = " ".join(str(error).split())[:200]
            yield (*loc, "params"), f"conditions.{name}.params", json.dumps(condition.params), wanted


def _lines(summary: Summary) -> Iterator[str]:
    live = sum(spec.live for spec in summary.clips)
    head = f"{summary.study}: {summary.participants} participants, {summary.trials} trials each"
    yield f"{head}, {summary.minutes:.0f} min"
    for block in summary.blocks:
        extra = [f"{n} {what}" for n, what in ((block.practice, "practice"), (block.catch, "catch")) if n]
        counted = f"{block.trials} trials" + (f" + {' + '.join(extra)}" if extra else "")
        if block.adaptive:
            counted = f"at most {counted}, made as the answers come ({block.adaptive})"
        yield f"  block {block.name} ({block.kind}): {counted}, {block.minutes:.1f} min"
        for what, (least, most) in block.balance.items():
            said = f"{least} each" if least == most else f"{least} to {most}"
            yield f"    {what.replace('_', ' ')}: {said}"
    for row in summary.below_full_rate:
        where = f"{row.size_px[0]}x{row.size_px[1]} px on this display"
        yield f"  {row.condition}: {row.share:.1%} of the pixels below full rate ({where}, gaze at its centre)"
    yield f"clips: {len(summary.clips) - live} to render ({summary.frames} frames), {live} live"
    yield (
        f"disk: at most {_size(summary.store_bytes)} in the store, {_size(summary.play_bytes)} in the play cache; "
        f"largest trial {_size(summary.largest_trial_bytes)}"
    )
    yield f"upload: at most {_size(summary.upload_bytes)} a refresh"


def _size(count: int) -> str:
    for unit in ("B", "KB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count = count / 1000  # type: ignore[assignment]
    return f"{count:.3g} GB"
