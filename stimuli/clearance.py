"""How far a place is from the surfaces of a scene, movers included: for camera paths that must not run into anything.

Float64 on the host. Nearest point of a triangle: Ericson, Real-Time Collision Detection (2005), section 5.1.5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stimuli.scene import Mover, Part, Scene


class Triangles(NamedTuple):
    """``corners`` (F, 3, 3) and the boxes round each: ``low``, ``high`` (F, 3), float64 metres."""

    corners: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def near(self, low: np.ndarray, high: np.ndarray) -> Triangles:
        """Those whose boxes touch the box from ``low`` to ``high`` (3,)."""
        on = ((self.low <= high) & (self.high >= low)).all(axis=1)
        return Triangles(self.corners[on], self.low[on], self.high[on])


class Clearance:
    """A scene's surfaces within ``reach_m`` of ``centre`` (3,). Skinned meshes count in their shape at time 0."""

    def __init__(self, scene: Scene, centre: np.ndarray, reach_m: float) -> None:
        self._still = _triangles(scene.static).near(centre - reach_m, centre + reach_m)
        self._movers = [(mover, _triangles(mover.parts)) for mover in scene.movers]

    def at(self, place: np.ndarray, times_s: np.ndarray, reach_m: float) -> float:
        """The least distance (m) of ``place`` (3,) from any surface at any of ``times_s`` (T,), at most ``reach_m``."""
        least = _distance(place, self._still, reach_m)
        for mover, triangles in self._movers:
            for pose in mover.track.pose(times_s[_exists(mover, times_s)]):
                # a pose may stretch: the least stretch turns own lengths into no more than the world's
                stretch = float(np.linalg.svd(pose[:3, :3], compute_uv=False).min())
                if stretch > 0:
                    own = np.linalg.solve(pose, np.append(place, 1.0))[:3]
                    least = min(least, stretch * _distance(own, triangles, reach_m / stretch))
        return least

    def along(self, start: np.ndarray, end: np.ndarray, margin_m: float) -> bool:
        """Whether all of the straight line from ``start`` to ``end`` keeps ``margin_m`` from all that stands still (to
        a tenth of it): each step is as long as the distance found allows."""
        length = float(np.linalg.norm(end - start))
        walked = 0.0
        while walked <= length:
            place = start + (end - start) * (walked / length if length > 0 else 0.0)
            free = _distance(place, self._still, max(8.0 * margin_m, length))
            if free < margin_m:
                return False
            walked += max(free - margin_m, 0.1 * margin_m)
        return True


def _exists(mover: Mover, times_s: np.ndarray) -> np.ndarray:
    there: np.ndarray = (times_s >= mover.visible_s[0]) & (times_s <= mover.visible_s[1])
    return there


def _triangles(parts: tuple[Part, ...]) -> Triangles:
    found = [np.zeros((0, 3, 3))]
    for part in parts:
        positions = part.positions @ part.matrix[:3, :3].T + part.matrix[:3, 3]
        found.append(positions[np.asarray(part.primitive.indices, np.int64)])
    corners = np.concatenate(found)
    return Triangles(corners, corners.min(axis=1), corners.max(axis=1))


def _distance(place: np.ndarray, triangles: Triangles, reach: float) -> float:
    """The least distance of ``place`` from any triangle, at most ``reach``."""
    corners = triangles.near(place - reach, place + reach).corners
    return min(reach, float(np.sqrt(_squared_distances(place, corners).min()))) if len(corners) else reach


def _squared_distances(place: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(F,) squared distances from each triangle: from its face where the foot lies inside, else from its edges."""
    pairs = [(corners[:, k], corners[:, (k + 1) % 3]) for k in range(3)]
    result: np.ndarray = np.min([_from_segments(place, p, q) for p, q in pairs], axis=0)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size2 = np.einsum("ij,ij->i", normal, normal)
    # on the inner side of all three edges: the foot on the plane lies inside
    sides = np.min([np.einsum("ij,ij->i", np.cross(q - p, place - p), normal) for p, q in pairs], axis=0)
    inside = (size2 > 0) & (sides >= 0)
    height = np.einsum("ij,ij->i", place - corners[:, 0], normal)
    result[inside] = np.minimum(result[inside], height[inside] ** 2 / size2[inside])
    return result


def _from_segments(place: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    along = q - p
    length2 = np.einsum("ij,ij->i", along, along)
    share = np.clip(np.einsum("ij,ij->i", place - p, along) / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
    away = place - (p + share[:, None] * along)
    found: np.ndarray = np.einsum("ij,ij->i", away, away)
    return found
