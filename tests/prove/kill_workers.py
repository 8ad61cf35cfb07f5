"""Workers, the Dask scheduler, Dask workers and the producing process itself, killed (-9) at random moments.

Whatever is killed, the store in the end holds the bytes of an undisturbed run, and nothing half-made was ever seen in
it as a clip. ``python -m tests.prove.kill_workers [--kills 200] [--seed 0]`` writes evidence/kill_workers.json.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import psutil

from renderers.produce import produce
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob
from tests.evidence import write_evidence
from tests.renderers.loopback_cluster import ROOT, LoopbackCluster
from tests.renderers.test_produce import all_files
from tests.stimuli.test_clip import request

SLOW, TOY = "tests.renderers.toy_renderer:Slow", "tests.renderers.toy_renderer:Toy"
PRODUCER = """
import sys
import renderers.units
renderers.units.UNIT_SAMPLES = 2 * 12 * 8
from renderers.produce import produce
from renderers.worker_pool import ClusterLost
from stimuli.clip import ClipStore
from tests.prove.kill_workers import SLOW, work
try:
    outcome = produce(work(), ClipStore(sys.argv[1]), int(sys.argv[2]), sys.argv[3] or None, bar=False, renderer=SLOW)
except ClusterLost:
    sys.exit(3)
sys.exit(1 if outcome.poisoned else 0)
"""


def work() -> list[ClipJob]:
    """Four clips of twelve frames, two of them averaged from sample blocks."""
    plain = [ClipJob(request(12, seed=seed), "") for seed in range(2)]
    reference = {"technique": "reference", "params": {"spp": 150}}
    return plain + [ClipJob(request(12, seed=seed, **reference), "") for seed in range(2)]


def start(store: ClipStore, workers: int, address: str) -> subprocess.Popen[bytes]:
    """The producing process."""
    command = [sys.executable, "-c", PRODUCER, str(store.root), str(workers), address]
    return subprocess.Popen(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, stderr=subprocess.DEVNULL)


def kill(pid: int) -> bool:
    """kill -9; False where the process was gone already."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def half_made(store: ClipStore) -> list[str]:
    """Problems of anything that the store shows as a clip at this moment."""
    return [line for identity in store.identities() for line in store.problems_of(identity)]


def one_run(folder: Path, kind: str, rng: np.random.Generator) -> tuple[dict[str, int], list[str], ClipStore]:
    """Produce until done; kill somebody every 0.2 to 4 s on the way. (who was killed how often, problems seen)."""
    store = ClipStore(folder / "store")
    cluster = LoopbackCluster(folder / "dask", 2) if kind == "cluster" else None
    killed = {"worker": 0, "client": 0, "scheduler": 0}
    seen: list[str] = []
    client = start(store, 2, cluster.address if cluster else "")
    deadline = 60
    try:
        while True:
            try:
                code = client.wait(timeout=float(rng.uniform(0.2, 4.0)))
            except subprocess.TimeoutExpired:
                code = None
            seen += half_made(store)
            if code == 0:
                return killed, seen, store
            if code is not None:  # lost its cluster, was killed, or gave a unit up: the same command again
                deadline -= 1
                if not deadline:
                    return killed, [*seen, "did not finish in 60 starts"], store
                if cluster is not None and cluster.scheduler.poll() is not None:
                    cluster.close()
                    cluster = LoopbackCluster(folder / "dask", 2)
                client = start(store, 2, cluster.address if cluster else "")
                continue
            who = str(rng.choice(["worker", "client", "scheduler"] if cluster else ["worker", "client"]))
            if who == "client":
                killed[who] += kill(client.pid)
            elif who == "scheduler" and cluster is not None:
                killed[who] += kill(cluster.scheduler.pid)
            else:
                pids = cluster.worker_pids() if cluster else _children(client.pid)
                if pids:
                    killed["worker"] += kill(int(rng.choice(pids)))
    finally:
        if client.poll() is None:
            client.kill()
        client.wait()
        if cluster is not None:
            cluster.close()


def _children(pid: int) -> list[int]:
    try:
        return [p.pid for p in psutil.Process(pid).children() if "spawn_main" in " ".join(p.cmdline())]
    except psutil.NoSuchProcess:
        return []


def prove(kills: int, seed: int) -> dict[str, Any]:
    """Runs of both kinds until ``kills`` processes were killed."""
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
    totals = {"worker": 0, "client": 0, "scheduler": 0}
    runs, wrong, seen = 0, 0, []
    began = time.monotonic()
    with TemporaryDirectory() as folder:
        quiet = ClipStore(Path(folder) / "undisturbed")
        produce(work(), quiet, bar=False, renderer=TOY)
        wanted = all_files(quiet)
        while sum(totals.values()) < kills:
            kind = "cluster" if runs % 2 else "local"
            killed, problems, store = one_run(Path(folder) / f"run-{runs}", kind, rng)
            totals = {who: totals[who] + count for who, count in killed.items()}
            seen += problems
            wrong += all_files(store) != wanted
            runs += 1
    return {
        "killed": totals,
        "runs": runs,
        "runs_with_other_bytes": wrong,
        "damaged_clips_seen_on_the_way": len(seen),
        "examples": seen[:3],
        "seconds": round(time.monotonic() - began, 1),
        "passed": wrong == 0 and not seen,
    }


def main(arguments: list[str] | None = None) -> int:
    """Kill, compare, write the evidence; exit code 1 where a byte differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="evidence/kill_workers.json")
    args = parser.parse_args(arguments)
    result = prove(args.kills, args.seed)
    write_evidence("kill_workers", result, args.out)
    print(json.dumps(result, indent=2))
    return 0 if result["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
