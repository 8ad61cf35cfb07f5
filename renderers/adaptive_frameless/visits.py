"""Visits of the sampler: where each one's samples go, and what is learnt from them (Dayal et al. 2005, Fig. 5).

The visits of a launch are planned (tiles drawn, crosshairs completed and begun, others chosen for reprojection),
traced together, and taken in one after another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless import rays
from renderers.adaptive_frameless.buffers import Buffers, Settings
from renderers.adaptive_frameless.compiled import inlined, uncounted
from renderers.adaptive_frameless.crosshair import (
    ARMS,
    blended,
    moved,
    moved_gradients,
    projected,
    spatial_gradients,
    temporal_gradient,
)
from renderers.adaptive_frameless.deep_buffer import (
    make_room,
    new_entry,
    push_back,
    push_front,
    put_in_stream,
    remove,
    take_out,
)

SAMPLES_PER_VISIT = 6
"""Five that complete a crosshair and one that begins the next (section 4.1)."""
# job_f, a visit's plan: centre; the earlier sample's luma and time (NaN: none); the place of the begun crosshair.
JX, JY, JLUMA, JTIME, JNEW_X, JNEW_Y, JHIDDEN = range(7)
JOB_F = 7
_OUTSIDE = 1 << 30  # added to a job's entry whose centre has left the picture


class Poses(NamedTuple):
    """`rays.HostPoses` for compiled code, with scene seconds of t1."""

    camera: np.ndarray
    movers: np.ndarray
    window: np.ndarray
    lens: np.ndarray
    t1_s: float


@inlined
def _world(p: Poses, mover: int, x: float, y: float, z: float, time_s: float, pose: np.ndarray) -> tuple:
    if mover == 0:
        return x, y, z
    blended(p.movers[mover], p.lens[0], time_s, pose)
    return moved(pose, x, y, z)


@uncounted
def plan(
    b: Buffers, s: Settings, p: Poses, times_s: np.ndarray, chance: np.ndarray, rows: np.ndarray, job_f: np.ndarray,
    job_i: np.ndarray,
) -> None:  # fmt: skip
    """Choose what ``len(times_s)`` visits sample: fills ``rows`` (6 n, rays.IN), ``job_f``, ``job_i`` (n, r).

    ``times_s``: seconds after t1. ``chance`` (n, 5 + 2 r): uniform numbers in [0, 1).
    """
    camera, pose = b.pose[0], b.pose[1]
    for lane in range(len(rows)):
        rows[lane, 7] = 0.0
    replaced = 0
    for k in range(len(times_s)):
        time_s = times_s[k]
        blended(p.camera, p.lens[0], time_s, camera)
        job = job_f[k]
        job[JLUMA], job[JTIME], job[JHIDDEN] = np.nan, np.nan, 0.0
        if b.number[c.WAITING] > 0 and 2 * replaced < len(times_s):
            # a crosshair found hidden is made anew where it was
            w = b.wait[b.number[c.WAIT_FIRST]]
            job[JX], job[JY], job[JLUMA], job[JTIME], job[JHIDDEN] = w[0], w[1], w[2], w[3], 1.0
            b.number[c.WAIT_FIRST] = (b.number[c.WAIT_FIRST] + 1) % len(b.wait)
            b.number[c.WAITING] -= 1
            replaced += 1
            leaf = b.leaf_of[int(job[JY]) * s.width + int(job[JX])]
        else:
            # a tile drawn at random
            leaf = b.leaves[int(chance[k, 0] * b.number[c.LEAVES])]
            n = b.node_i[leaf]
            job[JX] = n[c.X0] + chance[k, 1] * (n[c.X1] - n[c.X0])
            job[JY] = n[c.Y0] + chance[k, 2] * (n[c.Y1] - n[c.Y0])
            begun = b.node_p[leaf]
            if begun[c.HAS] > 0:
                begun[c.HAS] = 0.0
                x, y = begun[c.PX], begun[c.PY]
                if s.followed:
                    wx, wy, wz = _world(
                        p, int(begun[c.PMOVER]), begun[c.PPOINT], begun[c.PPOINT + 1], begun[c.PPOINT + 2], time_s, pose
                    )
                    x, y, depth = projected(camera, p.lens, wx, wy, wz)
                    if depth <= 0:
                        x = -1.0
                if n[c.X0] <= x < n[c.X1] and n[c.Y0] <= y < n[c.Y1]:
                    job[JX], job[JY], job[JLUMA], job[JTIME] = x, y, begun[c.PLUMA], begun[c.PTIME]
        n = b.node_i[leaf]
        job[JNEW_X] = n[c.X0] + chance[k, 3] * (n[c.X1] - n[c.X0])
        job[JNEW_Y] = n[c.Y0] + chance[k, 4] * (n[c.Y1] - n[c.Y0])
        # six samples
        for j in range(SAMPLES_PER_VISIT):
            row = rows[k * SAMPLES_PER_VISIT + j]
            row[0], row[1], row[2] = job[JX], job[JY], time_s
            if 0 < j < 5:
                row[0] += ARMS[j - 1][0]
                row[1] += ARMS[j - 1][1]
            elif j == 5:
                row[0], row[1] = job[JNEW_X], job[JNEW_Y]
        # crosshairs of this tile to reproject, with a ray each to see whether they are hidden
        for j in range(s.reprojected):
            job_i[k, j] = -1
            x = n[c.X0] + int(chance[k, 5 + 2 * j] * (n[c.X1] - n[c.X0]))
            y = n[c.Y0] + int(chance[k, 6 + 2 * j] * (n[c.Y1] - n[c.Y0]))
            pixel = y * s.width + x
            if b.fill[pixel] == 0:
                continue
            entry = b.queue[pixel, 0]
            if b.entry_i[entry, c.ASKED]:
                continue
            b.entry_i[entry, c.ASKED] = 1
            e = b.entry_f[entry]
            mover = b.entry_i[entry, c.MOVER]
            wx, wy, wz = _world(p, mover, e[c.POINT], e[c.POINT + 1], e[c.POINT + 2], time_s, pose)
            px, py, depth = projected(camera, p.lens, wx, wy, wz)
            gone = not p.window[mover, 0] <= time_s <= p.window[mover, 1]
            if gone or depth <= 0 or not (0 <= px < s.width and 0 <= py < s.height):
                job_i[k, j] = entry + _OUTSIDE
                continue
            job_i[k, j] = entry
            if k * s.reprojected + j < len(rows):
                row = rows[k * s.reprojected + j]
                row[3], row[4], row[5], row[6], row[7] = wx, wy, wz, time_s, 1.0


@inlined
def hit(found: np.ndarray, sample: int) -> tuple:
    """A result row's place in its mover's space, and the mover."""
    f = found[sample]
    return f[rays.LOCAL_X], f[rays.LOCAL_Y], f[rays.LOCAL_Z], int(f[rays.MOVER])


@uncounted
def take_in(
    b: Buffers, s: Settings, p: Poses, begin: int, end: int, times_s: np.ndarray, rows: np.ndarray, found: np.ndarray,
    job_f: np.ndarray, job_i: np.ndarray,
) -> int:  # fmt: skip
    """Put the traced visits ``begin`` .. ``end`` - 1 of a launch into deep buffer, tiles and stream; returns how many
    visibility rays were traced for them."""
    asked = 0
    for k in range(begin, end):
        time_s = p.t1_s + times_s[k]
        first, job = k * SAMPLES_PER_VISIT, job_f[k]
        # every sample goes to the reconstructor at once
        for j in range(SAMPLES_PER_VISIT):
            x, y, z, mover = hit(found, first + j)
            f = found[first + j]
            put_in_stream(
                b, time_s, f[rays.RED], f[rays.GREEN], f[rays.BLUE], x, y, z, mover,
                rows[first + j, 0], rows[first + j, 1],
            )  # fmt: skip
        _complete(b, s, found, first, job, time_s)
        asked += _reproject(b, s, p, times_s[k], found, k, job_i)
        _begin(b, s, found, first + 5, job, time_s)
    return asked


@uncounted
def _complete(b: Buffers, s: Settings, found: np.ndarray, first: int, job: np.ndarray, time_s: float) -> None:
    """A finished crosshair into the front of its pixel's queue."""
    px = min(max(int(job[JX]), 0), s.width - 1)
    py = min(max(int(job[JY]), 0), s.height - 1)
    make_room(b, s, py * s.width + px)
    entry = new_entry(b)
    e = b.entry_f[entry]
    for j in range(5):
        f = found[first + j]
        e[c.LUMA + j] = f[rays.LUMA]
        x, y, z, mover = hit(found, first + j)
        e[c.POINT + 3 * j], e[c.POINT + 3 * j + 1], e[c.POINT + 3 * j + 2] = x, y, z
        b.entry_i[entry, c.MOVER + j] = mover
    e[c.X], e[c.Y] = job[JX], job[JY]
    b.entry_t[entry] = time_s
    b.entry_i[entry, c.OCCLUDED] = int(job[JHIDDEN])
    spatial_gradients(b, entry)
    e[c.GT] = -1.0
    if job[JTIME] == job[JTIME]:
        e[c.GT] = temporal_gradient(e[c.LUMA], time_s, job[JLUMA], job[JTIME])
    push_front(b, s, entry, py * s.width + px)


@uncounted
def _begin(b: Buffers, s: Settings, found: np.ndarray, sample: int, job: np.ndarray, time_s: float) -> None:
    """The initiating sample waits in its tile for the next visit."""
    px = min(max(int(job[JNEW_X]), 0), s.width - 1)
    py = min(max(int(job[JNEW_Y]), 0), s.height - 1)
    begun = b.node_p[b.leaf_of[py * s.width + px]]
    f = found[sample]
    begun[c.HAS], begun[c.PX], begun[c.PY], begun[c.PTIME] = 1.0, job[JNEW_X], job[JNEW_Y], time_s
    begun[c.PLUMA] = f[rays.LUMA]
    x, y, z, mover = hit(found, sample)
    begun[c.PPOINT], begun[c.PPOINT + 1], begun[c.PPOINT + 2], begun[c.PMOVER] = x, y, z, mover


@uncounted
def _reproject(
    b: Buffers, s: Settings, p: Poses, time_s: float, found: np.ndarray, visit: int, job_i: np.ndarray
) -> int:
    """Move the visit's chosen crosshairs to where they are seen now; hidden ones wait to be made anew (section 6.1)."""
    camera, pose = b.pose[0], b.pose[1]
    x, y = b.arm[0], b.arm[1]
    blended(p.camera, p.lens[0], time_s, camera)
    asked = 0
    for j in range(s.reprojected):
        entry = job_i[visit, j]
        if entry < 0:
            continue
        outside = entry >= _OUTSIDE
        entry = entry - _OUTSIDE if outside else entry
        asked += 0 if outside else 1
        if not b.entry_i[entry, c.ASKED]:
            continue  # another visit of this chunk has dropped it
        b.entry_i[entry, c.ASKED] = 0
        if outside:
            remove(b, s, entry)
            continue
        e = b.entry_f[entry]
        for a in range(5):
            at = c.POINT + 3 * a
            wx, wy, wz = _world(p, b.entry_i[entry, c.MOVER + a], e[at], e[at + 1], e[at + 2], time_s, pose)
            x[a], y[a], depth = projected(camera, p.lens, wx, wy, wz)
            if depth <= 0:
                x[a], y[a] = x[0], y[0]
        px, py = min(int(x[0]), s.width - 1), min(int(y[0]), s.height - 1)
        lane = visit * s.reprojected + j
        if lane < len(found) and found[lane, rays.VISIBLE] < 0.5:
            if b.number[c.WAITING] < len(b.wait):
                w = b.wait[(b.number[c.WAIT_FIRST] + b.number[c.WAITING]) % len(b.wait)]
                w[0], w[1], w[2], w[3] = x[0], y[0], e[c.LUMA], b.entry_t[entry]
                b.number[c.WAITING] += 1
            remove(b, s, entry)
            continue
        pixel = py * s.width + px
        stays = pixel == b.entry_i[entry, c.PIXEL]
        if stays and abs(x[0] - e[c.X]) + abs(y[0] - e[c.Y]) < 1e-3:
            continue  # nothing has moved
        take_out(b, s, entry)
        moved_gradients(b, entry, x, y)
        if b.fill[pixel] > 0:
            newest = b.queue[pixel, 0]
            change = temporal_gradient(b.entry_f[newest, c.LUMA], b.entry_t[newest], e[c.LUMA], b.entry_t[entry])
            if change >= 0:
                e[c.GT] = change
        e[c.X], e[c.Y] = x[0], y[0]
        push_back(b, s, entry, pixel)
    return asked
