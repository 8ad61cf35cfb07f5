"""Units of work on processes of this machine. A worker that dies costs its unit one more try.

Workers are spawned (no lock or thread of ours is copied), do one unit at a time and send a message a frame. Whatever
kills one (an exception, a signal, a crash inside a library) ends its process; its last words are kept in a log file.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Literal

import OpenEXR

from renderers.render_unit import do_unit, renderer_class
from renderers.units import Unit
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob
from stimuli.errors import InputError

ATTEMPTS = 3
"""How often a unit whose worker died is tried before it is given up."""
EXPECTED_ERRORS = (
    ArithmeticError, AssertionError, AttributeError, ImportError, LookupError, MemoryError, NameError, OSError,
    RuntimeError, TypeError, ValueError,
)  # fmt: skip
"""What a failing technique may raise: the unit is then named, and the others go on."""


class ClusterLost(RuntimeError):
    """A cluster went away; what was made is kept, and the same command goes on."""


@dataclass(frozen=True)
class Task:
    """One unit of one clip; ``samples``: its primary rays, for the order of work and the progress bar."""

    job: ClipJob
    unit: Unit
    samples: int


@dataclass(frozen=True)
class Event:
    """What happened to a task: ``samples`` more rays of it are done, it was made, it has to start again (its rays count
    no more), or it was given up for the reason in ``text``."""

    kind: Literal["samples", "made", "again", "failed"]
    task: Task
    samples: int = 0
    text: str = ""


def run_here(store: ClipStore, tasks: Sequence[Task], renderer: str) -> Iterator[Event]:
    """All tasks in this process, one after the other; an error of one does not stop the others."""
    maker = renderer_class(renderer)(None)
    for task in tasks:
        try:
            for samples in do_unit(store, task.job, task.unit, maker):
                yield Event("samples", task, samples)
            yield Event("made", task)
        except EXPECTED_ERRORS as error:
            text = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
            yield Event("failed", task, text=text)


def _work(connection: Connection, root: str, renderer: str, log: str) -> None:
    """A worker's life: take a task, report each frame, say 'made'. Ends when the other side is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    words = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    os.dup2(words, 2)  # tracebacks and what libraries print when they abort
    OpenEXR.set_global_thread_count(0)  # frames are written by this thread alone
    store = ClipStore(Path(root))
    maker = renderer_class(renderer)(1)
    try:
        while True:
            task: Task = connection.recv()
            try:
                for samples in do_unit(store, task.job, task.unit, maker):
                    connection.send(("samples", samples, ""))
                connection.send(("made", 0, ""))
            except InputError as error:
                connection.send(("failed", 0, str(error)))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


class _Worker:
    """One process, its end of the pipe, and what it is doing."""

    def __init__(self, store: ClipStore, renderer: str, log: Path) -> None:
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.log = log
        self.task: Task | None = None
        self.before: Task | None = None
        self.process = context.Process(
            target=_work, args=(theirs, str(store.root), renderer, str(log)), daemon=True, name=log.stem
        )
        self.process.start()
        theirs.close()

    def give(self, task: Task) -> bool:
        """Hand a task over; False where the worker is gone."""
        self.task = self.before = task
        try:
            self.connection.send(task)
        except (BrokenPipeError, ConnectionResetError, OSError):
            return False
        return True

    def last_words(self) -> str:
        """How the process ended, and the last line it printed."""
        self.process.join(timeout=10)
        code = self.process.exitcode
        if code is not None and code < 0:
            how = f"killed by signal {-code} ({signal.Signals(-code).name})"
        else:
            how = f"ended with exit code {code}"
        printed = self.log.read_text(errors="replace").strip().splitlines() if self.log.is_file() else []
        return f"{how}: {printed[-1].strip()}" if printed else how

    def end(self) -> None:
        """Stop the process now."""
        self.connection.close()
        if self.process.is_alive():
            self.process.terminate()
            self.process.join(timeout=2)
            if self.process.is_alive():
                self.process.kill()
        self.process.join()


def _next_for(waiting: list[Task], before: Task | None) -> Task:
    """The next task of the same clip, else of the same scene (which the worker has at hand), else the longest."""
    if before is not None:
        for task in waiting:
            if task.job.request.identity == before.job.request.identity:
                return task
        for task in waiting:
            if task.job.scene_file == before.job.scene_file:
                return task
    return waiting[0]


def run_local(store: ClipStore, tasks: Sequence[Task], renderer: str, workers: int) -> Iterator[Event]:
    """All tasks on ``workers`` processes; events as they come. Closing the iterator ends the processes."""
    logs = store.new_building()
    waiting = sorted(tasks, key=lambda task: -task.samples)
    attempts: dict[tuple[str, Unit], int] = {}
    pool: list[_Worker] = []
    started = 0

    def start() -> _Worker:
        nonlocal started
        started += 1
        return _Worker(store, renderer, logs / f"worker-{started}.log")

    try:
        pool += [start() for _ in range(min(workers, len(tasks)))]
        while waiting or any(worker.task is not None for worker in pool):
            for worker in pool:
                if worker.task is None and waiting:
                    task = _next_for(waiting, worker.before)
                    waiting.remove(task)
                    worker.give(task)  # a dead worker is noticed below, by the end of its pipe
            ready = wait([worker.connection for worker in pool if worker.task is not None])
            for worker in [w for w in pool if w.connection in ready]:
                assert worker.task is not None
                task = worker.task
                try:
                    kind, samples, text = worker.connection.recv()
                except (EOFError, ConnectionResetError):
                    words = worker.last_words()
                    worker.end()
                    pool[pool.index(worker)] = start()
                    key = task.job.request.identity, task.unit
                    attempts[key] = attempts.get(key, 0) + 1
                    if attempts[key] < ATTEMPTS:
                        waiting.insert(0, task)
                        yield Event("again", task, text=words)
                    else:
                        yield Event("failed", task, text=f"{attempts[key]} times: {words}")
                    continue
                if kind != "samples":
                    worker.task = None
                yield Event(kind, task, samples, text)
    finally:
        for worker in pool:
            worker.end()
        for path in logs.iterdir():
            path.unlink()
        logs.rmdir()
