"""The support grid: which pixels are its texels, and its mesh (Weier et al. 2016, 3.2): vertices and their movement.

Texel (i, j) of w x h samples the pixel floor((i + .5) W / w), floor((j + .5) H / h). The mesh has a vertex at the
centre of each such pixel and a ring of vertices at the picture's edge with the depth of their neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.camera import forward_axis
from renderers.engine import Engine, EngineState
from renderers.gl.context import NEAR
from renderers.poses import pose_at

NO_MOVER = 0xFFFFFFFF
FAR = 1e3
"""How far away (tracer units) the background's vertices are drawn."""
IS_TEXEL = 1 << 31


@dataclass(frozen=True)
class SupportGrid:
    """Sizes in pixels: of the picture and of its support image."""

    width: int
    height: int
    columns: int
    rows: int

    @staticmethod
    def of(size_px: tuple[int, int], divisor: float) -> SupportGrid:
        """The grid of ``size_px``: max(1, floor(W / divisor)) by the same of H."""
        width, height = size_px
        return SupportGrid(width, height, max(1, int(width / divisor)), max(1, int(height / divisor)))

    @property
    def texels(self) -> int:
        """Number of texels."""
        return self.columns * self.rows

    @property
    def mesh(self) -> tuple[int, int]:
        """Columns and rows of the mesh's vertices, the ring included."""
        return self.columns + 2, self.rows + 2

    def texel_of_pixels(self) -> np.ndarray:
        """(H * W,) uint32: the texel whose block a pixel lies in, and `IS_TEXEL` where the pixel is its sample."""
        x, y = np.arange(self.width, dtype=np.int64), np.arange(self.height, dtype=np.int64)
        i, j = x * self.columns // self.width, y * self.rows // self.height
        own = (self.centre(i, self.columns, self.width) == x) & (self.centre(j, self.rows, self.height) == y)[:, None]
        flags = np.where(own, IS_TEXEL, 0)
        return (j[:, None] * self.columns + i + flags).astype(np.uint32).ravel()

    @staticmethod
    def centre(index: np.ndarray, count: int, size: int) -> np.ndarray:
        """The pixel of texel ``index`` of ``count`` along an axis of ``size`` pixels."""
        return (2 * index + 1) * size // (2 * count)

    def texel_pixels(self) -> np.ndarray:
        """(texels,) uint32: each texel's pixel number."""
        i, j = np.arange(self.columns), np.arange(self.rows)
        rows = self.centre(j, self.rows, self.height)[:, None] * self.width
        return (rows + self.centre(i, self.columns, self.width)).astype(np.uint32).ravel()

    def vertices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each mesh vertex: x and y (float32) in the picture and its texel (uint32)."""
        x = np.r_[0, self.centre(np.arange(self.columns), self.columns, self.width) + 0.5, self.width]
        y = np.r_[0, self.centre(np.arange(self.rows), self.rows, self.height) + 0.5, self.height]
        i = np.clip(np.arange(self.columns + 2) - 1, 0, self.columns - 1)
        j = np.clip(np.arange(self.rows + 2) - 1, 0, self.rows - 1)
        xs, ys = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
        return xs.ravel(), ys.ravel(), (j[:, None] * self.columns + i).astype(np.uint32).ravel()


def extract(
    engine: Engine, follow: bool, state: EngineState, x_px: Any, y_px: Any, lane: Any, z: Any, normal: Any, mover: Any
) -> tuple[Any, Any, Any, Any]:
    """The mesh's vertices as this frame sees them: (local point or direction, local normal, depth, mover).

    ``z`` (world units, inf: background), ``normal`` (tracer space) and ``mover`` are the samples' G-buffer, ``lane``
    the sample of each vertex; ``follow`` False puts everything into the static scene. Depth is in tracer units.
    """
    depth = dr.gather(mi.Float, z, lane) / state.to_world
    seen = depth < dr.inf
    body = dr.gather(mi.UInt32, mover, lane) if follow else mi.UInt32(0)
    ray = engine.camera_ray(state, x_px, y_px)
    along = dr.dot(ray.d, forward_axis(state.camera, 0.0))
    point = mi.Point3f(dr.fma(ray.d, dr.select(seen, depth, 0) / along, ray.o))
    facing = mi.Normal3f(*(dr.gather(mi.Float, component, lane) for component in normal))
    if follow and engine.tracer.bodies:
        own = pose_at(state.poses, dr.select(seen, body, 0), 0.0).inverse()
        point, facing = own.point(point), own.normal(facing)
    place = dr.select(seen, mi.Vector3f(point), mi.Vector3f(ray.d))
    return place, mi.Vector3f(facing), dr.select(seen, depth, FAR * along), dr.select(seen, body, NO_MOVER)


def move(
    engine: Engine, state: EngineState, x_px: Any, y_px: Any, place: Any, normal: Any, depth: Any, mover: Any
) -> tuple[Any, Any]:
    """(Vertices for the rasteriser, max(n.d, 0) of each): the mesh of the last frame as the eye sees it now.

    d is the direction from the surface to the eye; background has 1.
    """
    seen = mover != NO_MOVER
    point, facing = mi.Point3f(place), mi.Normal3f(normal)
    if engine.tracer.bodies:
        pose = pose_at(state.poses, dr.select(seen, mover, 0), 0.0)
        point, facing = pose.point(point), pose.normal(facing)
    camera = state.camera
    rows = pose_at(camera.poses, mi.UInt32(0), 0.0).rows
    away = dr.select(seen, mi.Vector3f(*(point[k] - row.w for k, row in enumerate(rows))), place * FAR)
    own = [sum(rows[k][axis] * away[k] for k in range(3)) for axis in range(3)]
    w = -own[2]
    # y grows downwards, so that row 0 of the target is the picture's top; depth in the window is 1 - near / w
    at = mi.Vector4f(
        own[0] / (camera.pixel * camera.center_x_px), -own[1] / (camera.pixel * camera.center_y_px), w - 2 * NEAR, w
    )
    was = mi.Vector4f(x_px * depth, y_px * depth, depth, 0)
    index = dr.arange(mi.UInt32, dr.width(mover))
    vertices = dr.empty(mi.Float, dr.width(mover) * 8)
    dr.scatter(vertices, at, index * 2)
    dr.scatter(vertices, was, index * 2 + 1)
    edge = dr.maximum(dr.dot(dr.normalize(mi.Vector3f(facing)), -dr.normalize(away)), 0)
    return vertices, dr.select(seen & (dr.squared_norm(away) > 0), edge, 1)
