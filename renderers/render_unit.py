"""One unit of work: render its frames and publish them as a part. Also by hand, to reproduce a failure:

python -m renderers.render_unit --store DIR IDENTITY UNIT
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from renderers.units import Unit, average_blocks
from stimuli.clip import ClipStore, sha256_of, write_json
from stimuli.clip_job import ClipJob, read_job
from stimuli.clip_parts import DamagedPart, FrameCost, PartWriter, has_part, part_directory, publish_part
from stimuli.encode import display_values
from stimuli.errors import InputError

RENDERER = "renderers.clip_renderer:ClipRenderer"
_BLOCKS = "blocks.json"


@dataclass(frozen=True)
class RenderedFrame:
    """One frame of a clip. ``blocks``: (H, W, 3) float32 means of ``sizes`` samples each, in order (one for techniques
    that do not average); ``twin``: an independent picture of the same samples, where the error is to be measured."""

    index: int
    blocks: tuple[np.ndarray, ...]
    sizes: tuple[int, ...] = (1,)
    channels: Mapping[str, np.ndarray] = field(default_factory=dict)
    cost: FrameCost = field(default_factory=FrameCost)
    twin: np.ndarray | None = None


class UnitRenderer(Protocol):
    """Makes frames; keeps scenes and kernels between units. ``threads``: how many it may use (None: all)."""

    def __init__(self, threads: int | None) -> None: ...

    def frames(self, job: ClipJob, unit: Unit) -> Iterator[RenderedFrame]:
        """The frames of ``unit`` in order."""
        ...


def renderer_class(name: str) -> type[UnitRenderer]:
    """The class behind ``module:Class``."""
    module, _, attribute = name.partition(":")
    found: type[UnitRenderer] = getattr(import_module(module), attribute)
    return found


def standard_error(frame: RenderedFrame, exposure: float) -> float | None:
    """RMS standard error of a frame's display values (in [0, 1]) from independent halves of its samples; None where
    nothing was rendered twice. Even and odd blocks: half their RMS difference; a twin: the difference / sqrt(2)."""
    if len(frame.blocks) > 1:
        halves = [average_blocks(frame.blocks[i::2], frame.sizes[i::2]) for i in (0, 1)]
        scale = 0.5
    elif frame.twin is not None:
        halves, scale = [frame.blocks[0], frame.twin], 0.5**0.5
    else:
        return None
    difference = display_values(halves[0], exposure) - display_values(halves[1], exposure)
    return float(np.sqrt(np.mean(difference**2)) * scale)


def do_unit(store: ClipStore, job: ClipJob, unit: Unit, renderer: UnitRenderer) -> Iterator[int]:
    """Render ``unit``, yielding the primary samples of each frame as it is done; the part is there when this ends."""
    if has_part(store, job.request.identity, unit.name):
        return
    if unit.blocks is not None:
        yield from _store_blocks(store, job, unit, renderer)
        return
    writer = PartWriter(store, job.request, unit.first)
    try:
        for frame in renderer.frames(job, unit):
            _add(writer, job, frame)
            yield job.request.size_px[0] * job.request.size_px[1] * sum(frame.sizes)
        writer.publish(unit.name)
    finally:
        writer.abandon()


def _add(writer: PartWriter, job: ClipJob, frame: RenderedFrame) -> None:
    error = standard_error(frame, job.request.exposure)
    facts = {} if error is None else {"standard_error": error}
    writer.add(average_blocks(frame.blocks, frame.sizes), frame.channels, frame.cost, facts)


def _store_blocks(store: ClipStore, job: ClipJob, unit: Unit, renderer: UnitRenderer) -> Iterator[int]:
    """Sample blocks of a frame as float32 arrays: nothing is rounded before all blocks are there."""
    building = store.new_building()
    entries: list[dict[str, Any]] = []
    for frame in renderer.frames(job, unit):
        path = building / f"{frame.index:06d}.npz"
        arrays: dict[str, Any] = {"blocks": np.stack(frame.blocks), "sizes": frame.sizes, **frame.channels}
        np.savez(path, **arrays)
        entries.append({"name": path.name, "sha256": sha256_of(path), "cost": asdict(frame.cost)})
        yield job.request.size_px[0] * job.request.size_px[1] * sum(frame.sizes)
    write_json(building / _BLOCKS, {"frames": entries})
    publish_part(store, job.request.identity, unit.name, building)


def merge_blocks(store: ClipStore, job: ClipJob, units: Sequence[Unit]) -> str:
    """Average the sample blocks of ``units`` (the same frames, all blocks in order) into one part; returns its name."""
    whole = Unit(units[0].first, units[0].stop)
    if has_part(store, job.request.identity, whole.name):
        return whole.name
    writer = PartWriter(store, job.request, whole.first)
    try:
        pieces = [_read_blocks(part_directory(store, job.request.identity, unit.name)) for unit in units]
        for frames in zip(*pieces, strict=True):
            costs = [frame.cost for frame in frames]
            merged = RenderedFrame(
                index=frames[0].index,
                blocks=tuple(block for frame in frames for block in frame.blocks),
                sizes=tuple(size for frame in frames for size in frame.sizes),
                channels=frames[0].channels,
                cost=FrameCost(
                    _total([cost.seconds for cost in costs]),
                    {kind: int(n) for kind, n in _total([cost.rays for cost in costs]).items()},
                    sum(cost.clamped for cost in costs),
                ),
            )
            _add(writer, job, merged)
        writer.publish(whole.name)
    finally:
        writer.abandon()
    return whole.name


def _total(counts: Sequence[Mapping[str, float]]) -> dict[str, float]:
    return {key: sum(count.get(key, 0) for count in counts) for key in counts[0]}


def _read_blocks(directory: Path) -> list[RenderedFrame]:
    try:
        entries = json.loads((directory / _BLOCKS).read_text())["frames"]
        frames = []
        for entry in entries:
            if sha256_of(directory / entry["name"]) != entry["sha256"]:
                raise DamagedPart(directory.name, f"other bytes in {entry['name']}")
            with np.load(directory / entry["name"]) as data:
                sizes = tuple(int(size) for size in data["sizes"])
                channels = {name: data[name] for name in data.files if name not in ("blocks", "sizes")}
                index = int(Path(entry["name"]).stem)
                frames.append(RenderedFrame(index, tuple(data["blocks"]), sizes, channels, FrameCost(**entry["cost"])))
        return frames
    except (OSError, ValueError, KeyError, TypeError) as error:
        if isinstance(error, DamagedPart):
            raise
        raise DamagedPart(directory.name, f"unreadable ({type(error).__name__})") from error


def command_for(store: ClipStore, identity: str, unit: Unit, renderer: str = RENDERER) -> str:
    """The command that makes this unit alone, in a process of its own."""
    other = "" if renderer == RENDERER else f"--renderer {renderer} "
    return f"python -m renderers.render_unit {other}--store {store.root} {identity} {unit.name}"


def main(argv: Sequence[str] | None = None) -> int:
    """Make one unit of a clip that `studyapp render` has begun."""
    parser = argparse.ArgumentParser(prog="python -m renderers.render_unit", description=main.__doc__)
    parser.add_argument("--store", required=True, help="the clip store's directory")
    parser.add_argument("--renderer", default=RENDERER, help="module:Class (default: %(default)s)")
    parser.add_argument("identity", help="the clip's name in the store")
    parser.add_argument("unit", help="as in frames-000000-000012")
    arguments = parser.parse_args(argv)
    store = ClipStore(Path(arguments.store))
    try:
        job, unit = read_job(store, arguments.identity), Unit.from_name(arguments.unit)
        for _ in do_unit(store, job, unit, renderer_class(arguments.renderer)(None)):
            pass
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
