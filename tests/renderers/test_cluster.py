"""A Dask cluster on loopback: the same bytes; killed workers, a killed scheduler, and clusters that cannot be used."""

from __future__ import annotations

import os
import signal
import threading
import time

import pytest

import renderers.units
from renderers.produce import produce
from renderers.worker_pool import ClusterLost
from stimuli.clip import ClipStore
from stimuli.errors import InputError
from tests.renderers.loopback_cluster import LoopbackCluster
from tests.renderers.test_produce import TOY, all_files, jobs

SLOW = "tests.renderers.toy_renderer:Slow"


@pytest.fixture
def small_units(monkeypatch):
    monkeypatch.setattr(renderers.units, "UNIT_SAMPLES", 12 * 8)


def when_parts_are_there(store: ClipStore, count: int, action) -> threading.Thread:
    """Do ``action`` as soon as ``count`` parts were made."""

    def watch() -> None:
        while len(list((store.root / "parts").glob("*/frames-*"))) < count:
            time.sleep(0.01)
        action()

    thread = threading.Thread(target=watch)
    thread.start()
    return thread


def test_cluster_makes_the_same_bytes_though_its_worker_and_its_scheduler_are_killed(tmp_path, small_units):
    work = jobs(tmp_path)
    alone, store = ClipStore(tmp_path / "alone"), ClipStore(tmp_path / "store")
    produce(work, alone, bar=False, renderer=TOY)
    cluster = LoopbackCluster(tmp_path / "dask")
    try:
        thread = when_parts_are_there(store, 2, lambda: os.kill(cluster.scheduler.pid, signal.SIGKILL))
        with pytest.raises(ClusterLost, match="goes on where it was"):
            produce(work, store, cluster=cluster.address, bar=False, renderer=SLOW)
        thread.join()
    finally:
        cluster.close()
    kept = {path.parent.name + path.name for path in (store.root / "parts").glob("*/frames-*")}
    assert len(kept) >= 2
    second = LoopbackCluster(tmp_path / "dask2")
    try:
        thread = when_parts_are_there(store, len(kept) + 2, lambda: os.kill(second.worker_pids()[0], signal.SIGKILL))
        outcome = produce(work, store, cluster=second.address, bar=False, renderer=SLOW)
        thread.join()
    finally:
        second.close()
    assert not outcome.poisoned
    assert all_files(store) == all_files(alone)


def test_clusters_that_cannot_be_used_are_refused(tmp_path, monkeypatch):
    store = ClipStore(tmp_path / "store")
    monkeypatch.setattr("renderers.cluster.CONNECT_S", 0.5)
    with pytest.raises(InputError, match="no answer"):
        produce(jobs(tmp_path), store, cluster="tcp://127.0.0.1:9", bar=False, renderer=TOY)
    monkeypatch.undo()
    cluster = LoopbackCluster(tmp_path / "dask", threads=2)
    try:
        with pytest.raises(InputError, match="2 threads"):
            produce(jobs(tmp_path), store, cluster=cluster.address, bar=False, renderer=TOY)
    finally:
        cluster.close()
