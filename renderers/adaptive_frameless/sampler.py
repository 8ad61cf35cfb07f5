"""The sampler's loop: a launch of visits is planned, traced by its owner, and taken in chunk by chunk; after each chunk
the tiling is adjusted.

Compiled code; a change in a module it calls needs a new compilation here (see `compiled`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless import rays
from renderers.adaptive_frameless.balance import adjust
from renderers.adaptive_frameless.buffers import Buffers, Settings, make_buffers
from renderers.adaptive_frameless.compiled import uncounted
from renderers.adaptive_frameless.crosshair import ARMS, spatial_gradients
from renderers.adaptive_frameless.deep_buffer import new_entry, push_front, put_in_stream
from renderers.adaptive_frameless.tiling import even_tiling, sum_errors
from renderers.adaptive_frameless.visits import JOB_F, SAMPLES_PER_VISIT, Poses, hit, plan, take_in

__all__ = ["SAMPLES_PER_VISIT", "Chunk", "Poses", "Sampler"]


class Chunk(NamedTuple):
    """Visits that are planned: ``times_s`` (n,) seconds after t1, ``rows`` (6 n, rays.IN) for `FramelessRays.trace`,
    ``job_f`` and ``job_i`` as `visits` fills them."""

    times_s: np.ndarray
    rows: np.ndarray
    job_f: np.ndarray
    job_i: np.ndarray


@uncounted
def _first_fill(b: Buffers, s: Settings, time_s: float, found: np.ndarray) -> None:
    """One crosshair a pixel from a grid of samples (W * H, scanline order); at an edge an arm is the pixel itself."""
    for y in range(s.height):
        for x in range(s.width):
            pixel = y * s.width + x
            entry = new_entry(b)
            e = b.entry_f[entry]
            for j in range(5):
                dx, dy = (0, 0) if j == 0 else (int(ARMS[j - 1][0]), int(ARMS[j - 1][1]))
                at = min(max(y + dy, 0), s.height - 1) * s.width + min(max(x + dx, 0), s.width - 1)
                f = found[at]
                e[c.LUMA + j] = f[rays.LUMA]
                px, py, pz, mover = hit(found, at)
                e[c.POINT + 3 * j], e[c.POINT + 3 * j + 1], e[c.POINT + 3 * j + 2] = px, py, pz
                b.entry_i[entry, c.MOVER + j] = mover
            e[c.X], e[c.Y] = x + 0.5, y + 0.5
            b.entry_t[entry] = time_s
            spatial_gradients(b, entry)
            e[c.GT] = -1.0
            push_front(b, s, entry, pixel)
            f = found[pixel]
            px, py, pz, mover = hit(found, pixel)
            put_in_stream(b, time_s, f[rays.RED], f[rays.GREEN], f[rays.BLUE], px, py, pz, mover, x + 0.5, y + 0.5)
    sum_errors(b, s)


@uncounted
def _turn(
    b: Buffers, s: Settings, p: Poses, done: Chunk, found: np.ndarray, totals: np.ndarray, following: Chunk,
    chance: np.ndarray,
) -> int:  # fmt: skip
    """All that lies between two launches, in one call. The tiling is adjusted after each chunk of the launch."""
    asked, visits = 0, len(done.times_s)
    for begin in range(0, visits, s.chunk):
        end = min(begin + s.chunk, visits)
        asked += take_in(b, s, p, begin, end, done.times_s, done.rows, found, done.job_f, done.job_i)
        adjust(b, s, p.t1_s + done.times_s[end - 1])
    for lane in range(len(found)):
        for column in range(len(totals)):
            totals[column] += found[lane, column]
    plan(b, s, p, following.times_s, chance, following.rows, following.job_f, following.job_i)
    return asked


class Sampler:
    """The controller with its deep buffer. It draws from ``rng`` and asks its owner for rays."""

    def __init__(self, settings: Settings, kept: int, rng: np.random.Generator) -> None:
        self.settings, self._rng = settings, rng
        self.buffers = make_buffers(settings, kept)

    def first_fill(self, time_s: float, found: np.ndarray) -> None:
        """Fill the deep buffer evenly; ``found`` (W * H, rays.OUT) in scanline order, sampled at ``time_s``."""
        self.buffers.total[c.EPOCH] = time_s
        even_tiling(self.buffers, self.settings)
        _first_fill(self.buffers, self.settings, time_s, found)

    def _room(self, times_s: np.ndarray) -> tuple[Chunk, np.ndarray]:
        """An unplanned chunk and its random numbers."""
        visits, r = len(times_s), self.settings.reprojected
        rows = np.empty((visits * SAMPLES_PER_VISIT, rays.IN), np.float32)
        chunk = Chunk(times_s, rows, np.empty((visits, JOB_F)), np.empty((visits, max(r, 1)), np.int64))
        return chunk, self._rng.random((visits, 5 + 2 * r))

    def plan(self, poses: Poses, times_s: np.ndarray) -> Chunk:
        """What the visits at ``times_s`` (seconds after t1) sample."""
        chunk, chance = self._room(times_s)
        plan(self.buffers, self.settings, poses, times_s, chance, chunk.rows, chunk.job_f, chunk.job_i)
        return chunk

    def turn(
        self, poses: Poses, done: Chunk, found: np.ndarray, totals: np.ndarray, times_s: np.ndarray
    ) -> tuple[Chunk, int]:
        """Take in what was ``found`` for ``done``, adjust the tiling, and plan the visits at ``times_s`` (may be none).

        Adds the result columns to ``totals`` (rays.OUT,); returns the next chunk and the visibility rays traced.
        """
        following, chance = self._room(times_s)
        asked = _turn(self.buffers, self.settings, poses, done, found, totals, following, chance)
        return following, int(asked)

    def take_in(self, poses: Poses, done: Chunk, found: np.ndarray) -> int:
        """What was found goes into deep buffer, tiles and stream; returns the visibility rays traced."""
        visits = len(done.times_s)
        return int(take_in(self.buffers, self.settings, poses, 0, visits, *done[:2], found, *done[2:]))

    def adjust(self, now_s: float) -> None:
        """Adjust the tiling after a chunk."""
        adjust(self.buffers, self.settings, now_s)
