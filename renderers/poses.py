"""Where movers are at each ray's own time: poses at knots of the view's interval, blended linearly between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.frozen import opaque_float
from renderers.space import BodySpace, TracerSpace
from stimuli.many_poses import mover_poses
from stimuli.scene import Mover

KNOT_STEP_S = Fraction(8, 1000)
_LEAST_VOLUME = 1e-12
_FAR_AWAY = 1e4  # in tracer units: where a body of no size is put


def knot_count(interval_s: Fraction) -> int:
    """Knots of an interval: 2 at 120 Hz and above, else so many that they are at most 8 ms apart (decisions.md)."""
    return 2 if interval_s <= Fraction(1, 120) else math.ceil(interval_s / KNOT_STEP_S) + 1


def knot_times(t0: Fraction, t1: Fraction) -> np.ndarray:
    """(K,) float64 scene seconds from t0 to t1."""
    count = knot_count(t1 - t0)
    return np.array([float(t0 + (t1 - t0) * k / (count - 1)) for k in range(count)])


@dataclass
class Poses:
    """A PyTree of what moves. ``span_s`` is t0 - t1 (negative); times in kernels are seconds relative to t1.

    ``forward``: (M + 1, K, 3, 4) float32, flat: own space -> tracer space; entry 0 is the static scene's identity.
    ``window``: (M + 1, 2) float32, flat: the seconds (relative to t1) in which each mover exists.
    """

    span_s: Any
    forward: Any
    window: Any
    knots: int


def pose_matrices(
    movers: tuple[Mover, ...],
    spaces: tuple[BodySpace, ...],
    space: TracerSpace,
    times_s: np.ndarray,
    hide: bool = False,
) -> np.ndarray:
    """(M + 1, K, 3, 4) float64 own-to-tracer matrices at ``times_s``; a body of no size is moved out of sight.

    ``hide``: so is one at the times at which it does not exist.
    """
    out = np.zeros((len(movers) + 1, len(times_s), 3, 4))
    out[:, :, :, :3] = np.eye(3)
    world = mover_poses([mover.track for mover in movers], times_s)
    for m, own in enumerate(spaces):
        poses = own.pose(world[m], space)
        flat = np.abs(np.linalg.det(poses[..., :3])) < _LEAST_VOLUME
        if hide:
            flat |= (times_s < movers[m].visible_s[0]) | (times_s > movers[m].visible_s[1])
        out[m + 1] = np.where(flat[:, None, None], np.c_[np.eye(3), np.full(3, _FAR_AWAY)], poses)
    return out


def poses_of(matrices: np.ndarray, movers: tuple[Mover, ...], times_s: np.ndarray) -> Poses:
    """The device's `Poses` of these knots."""
    window = np.full((len(movers) + 1, 2), [-np.inf, np.inf])
    for m, mover in enumerate(movers):
        window[m + 1] = np.asarray(mover.visible_s) - times_s[-1]
    return Poses(
        span_s=opaque_float(float(times_s[0] - times_s[-1])),
        forward=opaque_float(matrices),
        window=opaque_float(window),
        knots=len(times_s),
    )


@dataclass
class Pose:
    """Rows of a 3x4 affine matrix, one a lane: ``row . (x, y, z, 1)``."""

    rows: tuple[Any, Any, Any]

    def point(self, p: Any) -> Any:
        """Where the point ``p`` of own space is in tracer space."""
        return mi.Point3f(*(dr.fma(r.x, p.x, dr.fma(r.y, p.y, dr.fma(r.z, p.z, r.w))) for r in self.rows))

    def vector(self, v: Any) -> Any:
        """The direction ``v`` of own space in tracer space (its length changes with the pose's scale)."""
        return mi.Vector3f(*(dr.fma(r.x, v.x, dr.fma(r.y, v.y, r.z * v.z)) for r in self.rows))

    def inverse(self) -> Pose:
        """Tracer space -> own space."""
        r0, r1, r2 = (mi.Vector3f(r.x, r.y, r.z) for r in self.rows)
        c0, c1, c2 = dr.cross(r1, r2), dr.cross(r2, r0), dr.cross(r0, r1)  # columns of the adjugate
        scale = dr.rcp(dr.dot(r0, c0))
        shift = mi.Vector3f(*(r.w for r in self.rows))
        rows = []
        for k in range(3):
            row = mi.Vector3f(c0[k], c1[k], c2[k]) * scale
            rows.append(mi.Vector4f(row.x, row.y, row.z, -dr.dot(row, shift)))
        return Pose(tuple(rows))

    def normal(self, n: Any) -> Any:
        """The normal ``n`` of own space in tracer space, of any length: the cofactor matrix (inverse transpose)."""
        r0, r1, r2 = (mi.Vector3f(r.x, r.y, r.z) for r in self.rows)
        c0, c1, c2 = dr.cross(r1, r2), dr.cross(r2, r0), dr.cross(r0, r1)
        sign = dr.select(dr.dot(r0, c0) < 0, -1.0, 1.0)
        return mi.Normal3f(dr.dot(c0, n), dr.dot(c1, n), dr.dot(c2, n)) * sign


def pose_at(poses: Poses, mover: Any, time_s: Any, active: Any = True) -> Pose:
    """The pose of ``mover`` (UInt32; 0: identity) at ``time_s`` relative to t1. ``time_s`` 0.0 (a number): at t1."""
    base = mover * poses.knots

    def knot(index: Any) -> list[Any]:
        start = (base + index) * 3
        return [dr.gather(mi.Vector4f, poses.forward, start + row, active) for row in range(3)]

    if isinstance(time_s, (int, float)):
        if time_s != 0:
            raise TypeError("a time that is not 0 must be a device array, or it becomes part of the recording")
        return Pose(tuple(knot(poses.knots - 1)))
    place = dr.clip((time_s / poses.span_s), 0, 1) * (-(poses.knots - 1)) + (poses.knots - 1)
    low = dr.minimum(mi.UInt32(place), poses.knots - 2)
    share = place - mi.Float(low)
    return Pose(tuple(dr.lerp(a, b, share) for a, b in zip(knot(low), knot(low + 1), strict=True)))


def pose_at_start(poses: Poses, mover: Any, active: Any = True) -> Pose:
    """The pose of ``mover`` at t0."""
    start = mover * (poses.knots * 3)
    return Pose(tuple(dr.gather(mi.Vector4f, poses.forward, start + row, active) for row in range(3)))


def exists_at(poses: Poses, mover: Any, time_s: Any, active: Any = True) -> Any:
    """Whether ``mover`` is there at ``time_s`` (relative to t1)."""
    window = dr.gather(mi.Vector2f, poses.window, mover, active)
    return (time_s >= window.x) & (time_s <= window.y)
