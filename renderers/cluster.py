"""Units of work on a Dask cluster that the user started (`dask scheduler`, `dask worker --nthreads 1`, dask-jobqueue).

Scheduler, workers and this process share the store's directory and the scene files. Nothing but a unit's name and its
result's name travels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from pathlib import Path

from distributed import Client, KilledWorker, as_completed, get_worker
from distributed.comm.core import CommClosedError

from renderers.render_unit import do_unit, renderer_class
from renderers.worker_pool import EXPECTED_ERRORS, ClusterLost, Event, Task
from stimuli.clip import ClipStore
from stimuli.errors import InputError, problem

CONNECT_S = 5
WAIT_FOR_WORKERS_S = 60
"""A batch system may take its time to start the first worker."""


def do_task(root: str, task: Task, renderer: str) -> str:
    """On a worker: do one unit; '' or the reason why it cannot be done. The renderer lives as long as the worker."""
    worker = get_worker()
    makers = worker.__dict__.setdefault("studyapp_renderers", {})
    maker = makers.setdefault(renderer, None) or renderer_class(renderer)(1)
    makers[renderer] = maker
    try:
        for _ in do_unit(ClipStore(Path(root)), task.job, task.unit, maker):
            pass
    except EXPECTED_ERRORS as error:
        return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
    return ""


def _sees(path: str) -> bool:
    return Path(path).is_file()


def _check_workers(client: Client, store: ClipStore, address: str) -> None:
    """Every worker has one thread and sees this store; InputError otherwise."""
    try:
        client.wait_for_workers(1, timeout=WAIT_FOR_WORKERS_S)
    except TimeoutError as error:
        got = f"no workers within {WAIT_FOR_WORKERS_S} s"
        raise InputError(problem(address, "cluster", got, "dask worker ADDRESS --nthreads 1")) from error
    workers = client.scheduler_info(n_workers=-1)["workers"]
    many = [name for name, about in workers.items() if about["nthreads"] != 1]
    if many:
        got = f"{workers[many[0]]['nthreads']} threads in {many[0]}"
        raise InputError(problem(address, "cluster", got, "dask worker --nthreads 1"))
    probe = store.new_building() / "probe"
    probe.touch()
    try:
        blind = [name for name, sees in client.run(_sees, str(probe.resolve())).items() if not sees]
    finally:
        probe.unlink()
        probe.parent.rmdir()
    if blind:
        raise InputError(
            problem(blind[0], "store", "not the same directory", f"{store.root.resolve()} on every machine")
        )


def run_cluster(store: ClipStore, tasks: Sequence[Task], renderer: str, address: str) -> Iterator[Event]:
    """All tasks on the cluster at ``address``; Dask tries a unit again whose worker died (``allowed-failures``).

    Raises InputError where the cluster cannot be used, ClusterLost where it goes away.
    """
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError(
            problem(address, "cluster", f"no answer ({type(error).__name__})", "a Dask scheduler")
        ) from error
    try:
        _check_workers(client, store, address)
        root = str(store.root.resolve())
        longest_first = sorted(tasks, key=lambda task: -task.samples)
        futures = {client.submit(do_task, root, task, renderer, pure=False): task for task in longest_first}
        for future in as_completed(list(futures)):
            task = futures[future]
            try:
                text = future.result()
            except KilledWorker as error:
                text = f"its workers died: {error}"
            except CancelledError as error:
                raise ClusterLost(f"{address}: the scheduler is gone; the same command goes on where it was") from error
            if text:
                yield Event("failed", task, text=text)
            else:
                yield Event("samples", task, task.samples)
                yield Event("made", task)
    except (CommClosedError, TimeoutError) as error:
        raise ClusterLost(f"{address}: the scheduler is gone; the same command goes on where it was") from error
    finally:
        client.close()
