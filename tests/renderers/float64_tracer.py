"""The oracle: brute-force ray-triangle intersection in float64 (Moeller and Trumbore 1997), no code of the engine's."""

from __future__ import annotations

import numpy as np

from stimuli.scene import Scene


def world_triangles(scene: Scene, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """(F, 3, 3) float64 world triangles at ``time_s`` and (F,) each one's mover (-1: static)."""
    groups = [(np.eye(4), scene.static, -1)]
    groups += [(m.track.pose(np.array([time_s]))[0], m.parts, k) for k, m in enumerate(scene.movers)]
    triangles, owners = [], []
    for matrix, parts, owner in groups:
        for part in parts:
            full = matrix @ part.matrix
            points = part.positions @ full[:3, :3].T + full[:3, 3]
            faces = np.asarray(part.primitive.indices).reshape(-1, 3).astype(int)
            triangles.append(points[faces])
            owners.append(np.full(len(faces), owner))
    return np.concatenate(triangles), np.concatenate(owners)


def nearest(triangles: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[float, int]:
    """Distance along a unit ``direction`` of the nearest hit and its triangle; (inf, -1) for a miss."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    e1, e2, away = b - a, c - a, origin - a
    p = np.cross(direction, e2)
    with np.errstate(all="ignore"):
        inverse = 1 / np.einsum("ij,ij->i", e1, p)
        u = np.einsum("ij,ij->i", away, p) * inverse
        q = np.cross(away, e1)
        v = (q @ direction) * inverse
        t = np.einsum("ij,ij->i", e2, q) * inverse
        t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
    face = int(np.argmin(t))
    return float(t[face]), face if np.isfinite(t[face]) else -1
