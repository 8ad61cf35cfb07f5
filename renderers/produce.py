"""ClipRequests -> clips: what the store lacks (or holds damaged) is divided into units, made, and joined.

The result does not depend on who made what: one process, N local workers or a Dask cluster give the same bytes. What
is finished survives any interruption; the same call goes on from there.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any

from tqdm import tqdm

from renderers.admission import admit, free_bytes
from renderers.catalogue import CATALOGUE
from renderers.render_unit import RENDERER, command_for, merge_blocks
from renderers.units import Unit, block_sizes, plan_units, units_by_frames
from renderers.worker_pool import Event, Task, run_here, run_local
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob, write_job
from stimuli.clip_parts import DamagedPart, assemble, has_part, part_directory
from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError, problem

MAX_DAMAGED_PARTS = 100
"""So many parts of one clip may be found damaged and made again before the store itself is given up."""


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
    """The units of a clip, as the catalogue's entry of its technique allows.

    Light probes remember frames, so only what averages (and lets them settle for each frame) is divided with them.
    """
    entry = CATALOGUE.get(request.technique)
    divided = entry is not None and entry.stateless and (entry.averages or request.lighting != "probes")
    return plan_units(request, divided, samples_per_pixel(request))


def _samples(request: ClipRequest, unit: Unit) -> int:
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


def _admit(jobs: Sequence[ClipJob], workers: int) -> None:
    """InputError, a line each, for clips whose pictures do not fit into the memory that ``workers`` share."""
    problems: dict[str, None] = {}
    for job in jobs:
        try:
            admit(job.request.technique, job.request.size_px, free_bytes() // workers)
        except InputError as error:
            problems |= dict.fromkeys(error.problems)
    if problems:
        raise InputError(*problems)


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
    scheduler's address instead. A failing unit does not stop the others. InputError for wrong input, and
    (before anything is made) for pictures that do not fit into memory.
    """
    if workers < 1:
        raise InputError(problem("render", "workers", workers, "at least 1"))
    with only_producer(store):
        store.clear_abandoned()
        todo, kept, damaged = _missing(store, jobs)
        if cluster is None:  # what a cluster's machines have is theirs to know
            _admit(todo, min(workers, max(len(todo), 1)))
        for job in todo:
            write_job(store, job)
        work = _Work(store, todo, {"workers": workers, "cluster": cluster is not None})
        with tqdm(total=work.total, initial=work.done, unit="sample", unit_scale=True, disable=not bar) as progress:
            while work.pending:
                for identity in work.ready():
                    work.finish(identity)
                tasks = work.tasks()
                with closing(_events(store, tasks, workers, cluster, renderer)) as events:
                    for event in events:
                        progress.update(work.take(event, renderer))
                        progress.set_postfix_str(f"{len(work.made)}/{len(todo)} clips", refresh=False)
    return Outcome(
        made=tuple(identity for identity in work.made if identity not in damaged),
        kept=tuple(kept),
        remade=tuple(identity for identity in work.made if identity in damaged),
        poisoned=tuple(work.poisoned),
    )


class _Work:
    """What is still to be done: each clip's missing units, and what came out so far."""

    def __init__(self, store: ClipStore, jobs: Sequence[ClipJob], about: dict[str, Any]) -> None:
        self._store, self._about = store, about
        self._jobs = {job.request.identity: job for job in jobs}
        self._plans = {identity: units_of(job.request) for identity, job in self._jobs.items()}
        self._missing = {
            identity: {unit for unit in self._plans[identity] if not _is_there(store, identity, unit)}
            for identity in self._jobs
        }
        self._counted: dict[tuple[str, Unit], int] = {}
        self._damaged: dict[str, int] = {}
        self.pending = set(self._jobs)
        self.made: list[str] = []
        self.poisoned: list[Poisoned] = []
        self.total = sum(_samples(job.request, unit) for name, job in self._jobs.items() for unit in self._plans[name])
        self.done = self.total - sum(task.samples for task in self.tasks())

    def ready(self) -> list[str]:
        """Clips whose units are all there."""
        return [identity for identity in self._jobs if identity in self.pending and not self._missing[identity]]

    def tasks(self) -> list[Task]:
        """All missing units, in the order of the clips and their frames."""
        return [
            Task(job, unit, _samples(job.request, unit))
            for identity, job in self._jobs.items()
            if identity in self.pending
            for unit in self._plans[identity]
            if unit in self._missing[identity]
        ]

    def finish(self, identity: str) -> None:
        """Average sample blocks where there are any, and publish the clip; a damaged part has to be made again."""
        job, units = self._jobs[identity], self._plans[identity]
        try:
            names = [
                Unit(first, stop).name if group[0].blocks is None else merge_blocks(self._store, job, group)
                for (first, stop), group in units_by_frames(units).items()
            ]
            assemble(self._store, job.request, names, cost=self._about)
        except DamagedPart as error:
            self._damaged[identity] = self._damaged.get(identity, 0) + 1
            if self._damaged[identity] > MAX_DAMAGED_PARTS:
                raise  # a failing disk: nothing that is written can be read back
            shutil.rmtree(part_directory(self._store, identity, error.name))
            bad = Unit.from_name(error.name)
            self._missing[identity] = {
                unit for unit in units if (unit.first, unit.stop) == (bad.first, bad.stop)
                and not _is_there(self._store, identity, unit)
            }  # fmt: skip
        else:
            self.pending.discard(identity)
            self.made.append(identity)

    def take(self, event: Event, renderer: str) -> int:
        """Note an event; by how many rays the progress bar moves."""
        request, unit = event.task.job.request, event.task.unit
        identity, key = request.identity, (request.identity, unit)
        if event.kind == "samples":
            self._counted[key] = self._counted.get(key, 0) + event.samples
            return event.samples
        if event.kind == "made":
            self._missing[identity].discard(unit)
            if not self._missing[identity]:
                self.finish(identity)
            return event.task.samples - self._counted.pop(key, 0)
        if event.kind == "failed":
            self.pending.discard(identity)
            command = command_for(self._store, identity, unit, renderer)
            label = f"{request.scene} {request.technique}"
            self.poisoned.append(Poisoned(identity, label, unit, event.text, command))
        return -self._counted.pop(key, 0)


def _events(
    store: ClipStore, tasks: Sequence[Task], workers: int, cluster: str | None, renderer: str
) -> Generator[Event, None, None]:
    if tasks and cluster is not None:
        from renderers.cluster import run_cluster  # distributed is slow to import

        yield from run_cluster(store, tasks, renderer, cluster)
    elif tasks and workers == 1:
        yield from run_here(store, tasks, renderer)
    elif tasks:
        yield from run_local(store, tasks, renderer, workers)


def _is_there(store: ClipStore, identity: str, unit: Unit) -> bool:
    """Whether the unit's part was made, or (for sample blocks) the frames that it belongs to."""
    whole = Unit(unit.first, unit.stop)
    return has_part(store, identity, unit.name) or has_part(store, identity, whole.name)
