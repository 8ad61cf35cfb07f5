"""Renderers for tests of `produce`: pictures from a formula, and ones that fail, die or wait on purpose."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from renderers.render_unit import RenderedFrame
from renderers.units import Unit, block_sizes
from stimuli.clip_job import ClipJob
from stimuli.clip_parts import FrameCost
from stimuli.errors import InputError


def picture(seed: int, index: int, block: int, size_px: tuple[int, int]) -> np.ndarray:
    width, height = size_px
    return np.random.default_rng([seed, index, block]).random((height, width, 3)).astype(np.float32)


class Toy:
    """Frame ``k``, block ``b`` is random numbers seeded by (seed, k, b); the reference averages its blocks."""

    def __init__(self, threads: int | None) -> None:
        self.threads = threads

    def frames(self, job: ClipJob, unit: Unit) -> Iterator[RenderedFrame]:
        request = job.request
        sizes = block_sizes(int(request.params["spp"])) if request.technique == "reference" else (1,)
        low, high = unit.blocks or (0, len(sizes))
        for k in range(unit.first, unit.stop):
            self.before(job, k)
            blocks = tuple(picture(request.seed, k, b, request.size_px) for b in range(low, high))
            cost = FrameCost({"total": 0.001}, {"primary": sum(sizes[low:high])})
            yield RenderedFrame(k, blocks, sizes[low:high], {}, cost)

    def before(self, job: ClipJob, k: int) -> None:
        """What happens before frame ``k``."""


class FailsAtFrame3(Toy):
    def before(self, job: ClipJob, k: int) -> None:
        if k == 3 and job.request.seed == 1:
            raise RuntimeError("the kernel of frame 3 is broken")


class RefusesTheScene(Toy):
    def before(self, job: ClipJob, k: int) -> None:
        raise InputError("toy: scene: got nonsense, wanted sense")


class DiesAtFrame3(Toy):
    def before(self, job: ClipJob, k: int) -> None:
        if k == 3 and job.request.seed == 1:
            os.kill(os.getpid(), signal.SIGKILL)


class DiesOnce(Toy):
    """Kills itself at frames 1 and 4 the first time each is met (marks are left beside ``scene_file``)."""

    def before(self, job: ClipJob, k: int) -> None:
        mark = Path(job.scene_file).with_name(f"died-{job.request.seed}-{k}")
        if k in (1, 4) and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)


class Slow(Toy):
    """50 ms a frame, so that there is time to kill somebody."""

    def before(self, job: ClipJob, k: int) -> None:
        time.sleep(0.05)
