"""Rays as numpy arrays in, what they hit as numpy arrays out: the plain call for everyone who writes no kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from renderers.backend import mi
from renderers.frozen import frozen, opaque_float
from renderers.poses import Poses
from renderers.surface import surface_at
from stimuli.errors import InputError, problem

if TYPE_CHECKING:
    from renderers.tracer import SceneArrays, Tracer

_MOMENTS = 32  # distinct ray times of one launch


@dataclass(frozen=True)
class Hits:
    """What N rays hit. ``t`` (N,) world units (inf: a miss), ``point``, ``normal`` (shading), ``geometric_normal``
    (N, 3) world (normals face the ray's origin; nan for a miss), ``uv`` (N, 2), ``material`` (N,) int32 index into
    `Tracer.materials` (-1: a miss), ``mover`` (N,) int32 index into the scene's movers (-1: static or a miss).
    """

    t: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    geometric_normal: np.ndarray
    uv: np.ndarray
    material: np.ndarray
    mover: np.ndarray


def _lanes(value: Any, count: int) -> np.ndarray:
    """A kernel's result as numpy with ``count`` lanes (constants come back with one)."""
    array = value.numpy()
    return np.broadcast_to(array, (*array.shape[:-1], count))


def checked_rays(
    origin: np.ndarray, direction: np.ndarray, time_s: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 3) origins, (N, 3) unit directions and (N,) times in float64. Raises InputError, see `Tracer.trace`."""
    origin, direction, times_s = (np.asarray(values, np.float64) for values in (origin, direction, time_s))
    origin = origin.reshape(-1, 3) if not origin.size else origin
    direction = direction.reshape(origin.shape) if not direction.size and not origin.size else direction
    if origin.ndim != 2 or origin.shape[1] != 3 or direction.shape != origin.shape:
        raise InputError(problem("trace", "shapes", f"{origin.shape} and {direction.shape}", "(N, 3) and (N, 3)"))
    if times_s.shape not in ((), (1,), (len(origin),)):
        raise InputError(problem("trace", "times", f"{times_s.shape}", f"one or ({len(origin)},)"))
    times_s = np.broadcast_to(times_s, len(origin))
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    if not (
        np.isfinite(origin).all() and np.isfinite(length).all() and (length > 0).all() and np.isfinite(times_s).all()
    ):
        raise InputError(problem("trace", "rays", "values that are not finite or a direction of length 0", "finite"))
    return origin, direction / length, times_s


class PlainRays:
    """The kernel of `Tracer.trace`, and the poses that each of its launches needs."""

    def __init__(self, tracer: Tracer) -> None:
        self.tracer = tracer
        self.kernel = frozen(self._hits, max_recordings=64)

    def trace(self, origin: np.ndarray, direction: np.ndarray, time_s: float | np.ndarray) -> Hits:
        """See `Tracer.trace`."""
        tracer = self.tracer
        origin, direction, times_s = checked_rays(origin, direction, time_s)
        count = len(origin)
        out = {
            name: np.full((count, width), np.nan)
            for name, width in (("point", 3), ("normal", 3), ("geometric", 3), ("uv", 2))
        }
        t, material, mover = np.full(count, np.inf), np.full(count, -1, np.int32), np.full(count, -1, np.int32)
        moments, which = np.zeros(1), np.zeros(count, int)
        if tracer.scene.movers or tracer.scene.skins:
            moments, which = np.unique(times_s, return_inverse=True)
        together = 1 if tracer.scene.skins else _MOMENTS  # a skinned mesh has one shape at a time
        for first in range(0, len(moments) if count else 0, together):
            rows = np.flatnonzero((which >= first) & (which < first + together))
            poses, now_s = self._moment_poses(moments[first : first + together], which[rows] - first)
            tracer.deform(float(moments[first]), float(moments[first]))
            o = tracer.space.points(origin[rows]).astype(np.float32)
            d = direction[rows].astype(np.float32)
            found = self.kernel(
                len(rows),
                tracer.arrays,
                poses,
                mi.Point3f(*(opaque_float(column) for column in o.T)),
                mi.Vector3f(*(opaque_float(column) for column in d.T)),
                opaque_float(now_s),
            )
            hit_t, p, n, g, uv, m, body = (_lanes(value, len(rows)) for value in found)
            seen = np.isfinite(hit_t)
            here = rows[seen]
            t[here] = hit_t[seen].astype(np.float64) / tracer.space.scale
            out["point"][here] = tracer.space.world_points(p.T[seen])
            out["normal"][here], out["geometric"][here], out["uv"][here] = n.T[seen], g.T[seen], uv.T[seen]
            material[here] = m[seen]
            mover[here] = body[seen].astype(np.int32) - 1
        return Hits(t, out["point"], out["normal"], out["geometric"], out["uv"], material, mover)

    def _moment_poses(self, moments: np.ndarray, which: np.ndarray) -> tuple[Poses, np.ndarray]:
        """Poses whose knots are these moments themselves, and each ray's kernel time that falls on its knot."""
        knots = 2 if len(moments) <= 2 else _MOMENTS
        padded = np.append(moments, np.repeat(moments[-1], knots - len(moments)))
        poses = self.tracer.poses(padded, hide=True)
        windows = np.tile([-np.inf, np.inf], len(self.tracer.scene.movers) + 1)
        even = Poses(opaque_float(1.0 - knots), poses.forward, opaque_float(windows), knots)
        return even, (which - (knots - 1.0)).astype(np.float32)

    def _hits(self, arrays: SceneArrays, poses: Poses, o: Any, d: Any, time_s: Any) -> tuple[Any, ...]:
        hit = self.tracer.nearest(arrays, poses, o, d, time_s, True, coherent=False)
        s = surface_at(self.tracer, arrays, poses, hit, d, time_s, hit.valid)
        return hit.t, s.point, s.normal, s.geometric, s.uv, s.material, hit.mover
