"""ClipRequests -> clips: what the store lacks (or holds damaged) is divided into units, made, and joined.

The result does not depend on who made what: one process, N local workers or a Dask cluster give the same bytes. What
is finished survives any interruption; the same call goes on from there.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from tqdm import tqdm

from renderers.catalogue import CATALOGUE
from renderers.render_unit import RENDERER, command_for, merge_blocks
from renderers.units import Unit, plan_units, units_by_frames
from renderers.worker_pool import Event, Task, run_here, run_local
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob, write_job
from stimuli.clip_parts import DamagedPart, assemble, has_part, part_directory
from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError, problem


@dataclass(frozen=True)
class Poisoned:
    """A unit that could not be made: why, and the command that shows it again."""

    identity: str
    label: str
    unit: Unit
    reason: str
    command: str


@dataclass(frozen=True)
class Outcome:
    """Identities of clips that were made, that were whole already, and that were damaged and made again; and the units
    that failed (their clips are not there)."""

    made: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    remade: tuple[str, ...] = ()
    poisoned: tuple[Poisoned, ...] = ()


def samples_per_pixel(request: ClipRequest) -> int | None:
    """``spp`` of a technique that averages, None for all others."""
    entry = CATALOGUE.get(request.technique)
    return int(request.params["spp"]) if entry is not None and entry.averages else None


def units_of(request: ClipRequest) -> tuple[Unit, ...]:
    """The units of a clip, as the catalogue's entry of its technique allows."""
    entry = CATALOGUE.get(request.technique)
    return plan_units(request, entry is not None and entry.stateless, samples_per_pixel(request))


def _samples(request: ClipRequest, unit: Unit) -> int:
    from renderers.units import block_sizes

    spp = samples_per_pixel(request)
    sizes = block_sizes(spp) if spp else (1,)
    low, high = unit.blocks or (0, len(sizes))
    return request.size_px[0] * request.size_px[1] * (unit.stop - unit.first) * sum(sizes[low:high])


@contextmanager
def only_producer(store: ClipStore) -> Iterator[None]:
    """Hold the store's lock: two producers at once would only do the same work twice. Gone with its process."""
    store.root.mkdir(parents=True, exist_ok=True)
    handle = os.open(store.root / "render.lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            got = "another studyapp render at work in it"
            raise InputError(problem(store.root, "store", got, "one at a time; wait, or give --store")) from error
        yield
    finally:
        os.close(handle)


def _missing(store: ClipStore, jobs: Sequence[ClipJob]) -> tuple[list[ClipJob], list[str], list[str]]:
    """(jobs to do, identities that are whole, identities that were damaged and are now discarded)."""
    todo, kept, damaged = [], [], []
    for identity, job in {job.request.identity: job for job in jobs}.items():
        if store.directory(identity).exists():
            if not store.problems_of(identity):
                kept.append(identity)
                continue
            store.discard(identity)
            damaged.append(identity)
        todo.append(job)
    return todo, kept, damaged


def produce(
    jobs: Sequence[ClipJob],
    store: ClipStore,
    workers: int = 1,
    cluster: str | None = None,
    bar: bool = True,
    renderer: str = RENDERER,
) -> Outcome:
    """Make every clip of ``jobs`` that is not whole in ``store``.

    ``workers`` 1: in this process with all its threads; more: processes of one thread each; ``cluster``: a Dask
    scheduler's address instead. A failing unit does not stop the others. InputError for wrong input.
    """
    if workers < 1:
        raise InputError(problem("render", "workers", workers, "at least 1"))
    with only_producer(store):
        store.clear_abandoned()
        todo, kept, damaged = _missing(store, jobs)
        plans = {job.request.identity: units_of(job.request) for job in todo}
        for job in todo:
            write_job(store, job)
        made, poisoned = _make(store, todo, plans, workers, cluster, bar, renderer)
    remade = tuple(identity for identity in made if identity in damaged)
    fresh = tuple(identity for identity in made if identity not in damaged)
    return Outcome(fresh, tuple(kept), remade, tuple(poisoned))


def _make(
    store: ClipStore,
    todo: Sequence[ClipJob],
    plans: dict[str, tuple[Unit, ...]],
    workers: int,
    cluster: str | None,
    bar: bool,
    renderer: str,
) -> tuple[list[str], list[Poisoned]]:
    """Run all units and join each clip as soon as its last one is there."""
    missing = {
        job.request.identity: {unit for unit in plans[job.request.identity] if not _is_there(store, job, unit)}
        for job in todo
    }
    made: list[str] = []
    poisoned: list[Poisoned] = []
    total = sum(_samples(job.request, unit) for job in todo for unit in plans[job.request.identity])
    done = total - sum(_samples(job.request, unit) for job in todo for unit in missing[job.request.identity])
    with tqdm(total=total, initial=done, unit="ray", unit_scale=True, disable=not bar, desc="render") as progress:
        pending = list(todo)
        while pending:
            tasks = [
                Task(job, unit, _samples(job.request, unit))
                for job in pending
                for unit in plans[job.request.identity]
                if unit in missing[job.request.identity]
            ]
            ready = [job for job in pending if not missing[job.request.identity]]
            failed: set[str] = set()
            again: list[ClipJob] = []
            counted: dict[tuple[str, Unit], int] = {}

            def finish(job: ClipJob, again: list[ClipJob] = again) -> None:
                identity = job.request.identity
                try:
                    _join(store, job, plans[identity])
                    made.append(identity)
                    progress.set_postfix_str(f"{len(made)}/{len(todo)} clips")
                except DamagedPart as error:
                    missing[identity] = _drop(store, job, plans[identity], error.name)
                    again.append(job)

            for job in ready:
                finish(job)
            for event in _events(store, tasks, workers, cluster, renderer):
                identity, unit = event.task.job.request.identity, event.task.unit
                if event.kind == "samples":
                    counted[identity, unit] = counted.get((identity, unit), 0) + event.samples
                    progress.update(event.samples)
                elif event.kind == "again":
                    progress.update(-counted.pop((identity, unit), 0))
                elif event.kind == "failed":
                    failed.add(identity)
                    label = f"{event.task.job.request.scene} {event.task.job.request.technique}"
                    command = command_for(store, identity, unit, renderer)
                    poisoned.append(Poisoned(identity, label, unit, event.text, command))
                else:
                    missing[identity].discard(unit)
                    if not missing[identity] and identity not in failed:
                        finish(event.task.job)
            pending = again
    return made, poisoned


def _events(
    store: ClipStore, tasks: Sequence[Task], workers: int, cluster: str | None, renderer: str
) -> Iterator[Event]:
    if not tasks:
        return iter(())
    if cluster is not None:
        from renderers.cluster import run_cluster  # distributed is slow to import

        return run_cluster(store, tasks, renderer, cluster)
    return run_here(store, tasks, renderer) if workers == 1 else run_local(store, tasks, renderer, workers)


def _is_there(store: ClipStore, job: ClipJob, unit: Unit) -> bool:
    """Whether the unit's part was made, or (for sample blocks) the frames that it belongs to."""
    identity = job.request.identity
    return has_part(store, identity, unit.name) or (
        unit.blocks is not None and has_part(store, identity, Unit(unit.first, unit.stop).name)
    )


def _join(store: ClipStore, job: ClipJob, units: Sequence[Unit]) -> None:
    """Average sample blocks where there are any, and publish the clip."""
    names = []
    for (first, stop), group in units_by_frames(units).items():
        blocks: Literal[True, False] = group[0].blocks is not None
        names.append(merge_blocks(store, job, group) if blocks else Unit(first, stop).name)
    assemble(store, job.request, names)


def _drop(store: ClipStore, job: ClipJob, units: Sequence[Unit], name: str) -> set[Unit]:
    """Remove a damaged part; the units that have to be made again."""
    import shutil

    bad = Unit.from_name(name)
    shutil.rmtree(part_directory(store, job.request.identity, name), ignore_errors=True)
    return {
        unit
        for unit in units
        if unit == bad or (bad.blocks is None and (unit.first, unit.stop) == (bad.first, bad.stop))
    }
