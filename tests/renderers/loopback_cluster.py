"""A Dask scheduler and workers on loopback, as processes of their own (tests and `tests.prove.kill_workers`)."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]


class LoopbackCluster:
    """`dask scheduler` and `dask worker --nthreads 1` (each with its nanny, which replaces a worker that dies)."""

    def __init__(self, folder: Path, workers: int = 1, threads: int = 1, port: int = 0) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "5s"}
        self._log = open(folder / "cluster.log", "ab")  # noqa: SIM115  (open as long as the processes are)
        self.children: list[subprocess.Popen[bytes]] = []
        found = folder / "scheduler.json"
        found.unlink(missing_ok=True)
        self.scheduler = self._start(
            "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--scheduler-file", str(found)
        )
        self.address = str(self._wait_for(found)["address"])
        for _ in range(workers):
            self._start("worker", self.address, "--nthreads", str(threads), "--no-dashboard", "--host", "127.0.0.1",
                        "--local-directory", str(folder))  # fmt: skip

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:]]
        child = subprocess.Popen(
            command, stdout=self._log, stderr=self._log, env=self._environment, cwd=ROOT, start_new_session=True
        )
        self.children.append(child)
        return child

    def _wait_for(self, path: Path) -> dict[str, object]:
        for _ in range(600):
            try:
                found: dict[str, object] = json.loads(path.read_text())
                return found
            except (OSError, ValueError):
                time.sleep(0.05)
        raise TimeoutError("the Dask scheduler did not start")

    def worker_pids(self) -> list[int]:
        """The processes that do the work (children of the nannies)."""
        import psutil

        nannies = [psutil.Process(child.pid) for child in self.children[1:] if child.poll() is None]
        return [
            p.pid for nanny in nannies for p in nanny.children(recursive=True) if "spawn_main" in " ".join(p.cmdline())
        ]

    def close(self) -> None:
        """End every process of the cluster."""
        for child in self.children:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()
        self._log.close()
