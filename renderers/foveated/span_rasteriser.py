"""The depth mesh drawn row by row on the CPU, in numba: what `renderers.gl.context.MeshRasteriser` does by moderngl.

`make_rasteriser` chooses. At 1182x1464, 39,000 triangles of tunnel_geom, on two cores: llvmpipe takes 14 ms (13.6 with
a constant fragment shader, 10 with a target of half the size) and 3 ms to read the two pictures back, this 6 ms and
nothing; llvmpipe's triangles, not their pixels' shader, are what costs. Places agree to 6e-5 px (median).

The rule of coverage is OpenGL's: a pixel belongs to the triangle in which its centre lies; where an edge crosses a
pixel row is computed from the edge's ends alone, so that triangles with a common edge leave no gap and no overlap.
"""

from __future__ import annotations

from typing import Any, Literal, Protocol

import numpy as np
from numba import get_num_threads, njit, prange

from renderers.backend import cores_for_numba, mi
from renderers.frozen import aligned
from renderers.gl.context import FLOATS_A_VERTEX, NEAR, MeshRasteriser, Stage, unmeasured

BAND_ROWS = 64
"""Rows that a thread draws at a time: their pixels stay in its cache."""
_X, _Y, _IW = 0, 1, 2  # place in the picture, 1 / w
_VALUES = 6  # of a vertex in the picture: the above, then x / w, y / w, depth / w of the last picture


@njit(cache=True, parallel=True)
def _place_vertices(vertices: np.ndarray, width: int, height: int, near: float, out: np.ndarray) -> None:
    """``out`` (V, 6) float64 of ``vertices`` (V, 8); 1 / w is 0 for those nearer than ``near``."""
    for v in prange(len(vertices)):
        w = np.float64(vertices[v, 3])
        iw = 1.0 / w if w >= near else 0.0
        out[v, _X], out[v, _Y] = (vertices[v, 0] * iw + 1) * 0.5 * width, (vertices[v, 1] * iw + 1) * 0.5 * height
        out[v, _IW] = iw
        for k in range(3):
            out[v, 3 + k] = vertices[v, 4 + k] * iw


@njit(cache=True)
def _clipped(
    vertices: np.ndarray, indices: np.ndarray, placed: np.ndarray, width: int, height: int, near: float
) -> np.ndarray:
    """(3 N, 6) float64: what is left of the triangles that cross the near plane, each in one or two parts."""
    count = 0
    for t in range(len(indices)):
        ahead = 0
        for k in range(3):
            ahead += placed[indices[t, k], _IW] > 0
        count += 0 if ahead == 3 else ahead  # one vertex ahead leaves one triangle, two leave two
    parts = np.empty((3 * count, _VALUES))
    n = 0
    corners = np.empty((4, _VALUES))
    for t in range(len(indices)):
        ahead = 0
        for k in range(3):
            ahead += placed[indices[t, k], _IW] > 0
        if ahead == 0 or ahead == 3:
            continue
        m = 0
        for k in range(3):
            a, b = indices[t, k], indices[t, (k + 1) % 3]
            if placed[a, _IW] > 0:
                corners[m] = placed[a]
                m += 1
            if (placed[a, _IW] > 0) != (placed[b, _IW] > 0):
                if placed[a, _IW] == 0:  # from the end that is ahead, so that both sides of an edge agree
                    a, b = b, a
                p, q = vertices[a].astype(np.float64), vertices[b].astype(np.float64)
                at = p + (q - p) * ((near - p[3]) / (q[3] - p[3]))
                corners[m, _X], corners[m, _Y] = (at[0] / near + 1) * 0.5 * width, (at[1] / near + 1) * 0.5 * height
                corners[m, _IW] = 1 / near
                corners[m, 3:] = at[4:7] / near
                m += 1
        for k in range(1, m - 1):
            parts[n], parts[n + 1], parts[n + 2] = corners[0], corners[k], corners[k + 1]
            n += 3
    return parts


@njit(cache=True, inline="always")
def _first_centre(x: float) -> int:
    """The first pixel whose centre is at ``x`` or beyond."""
    return int(np.ceil(x - 0.5))


@njit(cache=True, inline="always")
def _below(v: np.ndarray, a: int, b: int) -> bool:
    """Whether vertex ``a`` comes after ``b``, row by row."""
    return v[a, _Y] > v[b, _Y] or (v[a, _Y] == v[b, _Y] and v[a, _X] > v[b, _X])


@njit(cache=True, inline="always")
def _slopes(v: np.ndarray, a: int, b: int, c: int, k: int, over_area: float) -> tuple[float, float]:
    """How value ``k`` of the vertices, a plane over the picture, changes to the right and down."""
    ab, ac = v[b, k] - v[a, k], v[c, k] - v[a, k]
    right = (ab * (v[c, _Y] - v[a, _Y]) - ac * (v[b, _Y] - v[a, _Y])) * over_area
    return right, (ac * (v[b, _X] - v[a, _X]) - ab * (v[c, _X] - v[a, _X])) * over_area


@njit(cache=True, error_model="numpy")
def _triangle(
    v: np.ndarray, a: int, b: int, c: int, first: int, after: int, near: float, place: np.ndarray, depth: np.ndarray
) -> None:
    """Draw what one triangle has in the rows ``first`` to ``after`` - 1, where it is nearer than what is there.

    Vertices are read by number: a view of a row of ``v`` each would take longer than the triangle.
    """
    if _below(v, a, b):
        a, b = b, a
    if _below(v, b, c):
        b, c = c, b
    if _below(v, a, b):
        a, b = b, a
    ax, ay, bx, by = v[a, _X], v[a, _Y], v[b, _X], v[b, _Y]
    area = (bx - ax) * (v[c, _Y] - ay) - (v[c, _X] - ax) * (by - ay)
    top, middle, bottom = _first_centre(ay), _first_centre(by), _first_centre(v[c, _Y])
    top, bottom = max(first, top), min(after, bottom)
    if area == 0 or top >= bottom:
        return
    # 1 / w and the three values over w are planes over the picture.
    over_area = 1 / area
    iw_right, iw_down = _slopes(v, a, b, c, _IW, over_area)
    px_right, px_down = _slopes(v, a, b, c, 3, over_area)
    py_right, py_down = _slopes(v, a, b, c, 4, over_area)
    pz_right, pz_down = _slopes(v, a, b, c, 5, over_area)
    # Edges go down from their upper end, whichever triangle they are of. An edge of no height crosses no row.
    long = (v[c, _X] - ax) / (v[c, _Y] - ay)
    upper, lower = (bx - ax) / (by - ay), (v[c, _X] - bx) / (v[c, _Y] - by)
    width = depth.shape[1]
    for row in range(top, bottom):
        y = row + 0.5
        one = ax + (y - ay) * long
        other = ax + (y - ay) * upper if row < middle else bx + (y - by) * lower
        left, end = max(0, _first_centre(min(one, other))), min(width, _first_centre(max(one, other)))
        dx, dy = left + 0.5 - ax, y - ay
        iw = v[a, _IW] + iw_right * dx + iw_down * dy
        px = v[a, 3] + px_right * dx + px_down * dy
        py = v[a, 4] + py_right * dx + py_down * dy
        pz = v[a, 5] + pz_right * dx + pz_down * dy
        for x in range(left, end):
            z = np.float32(1.0 - near * iw)
            if z < depth[row, x]:
                depth[row, x] = z
                share = 1.0 / pz
                place[row, x, 0], place[row, x, 1] = px * share, py * share
            iw += iw_right
            px += px_right
            py += py_right
            pz += pz_right


@njit(cache=True, parallel=True)
def _draw(
    placed: np.ndarray, indices: np.ndarray, parts: np.ndarray, near: float, workers: int, place: np.ndarray,
    depth: np.ndarray,
) -> None:  # fmt: skip
    """Clear and draw: every worker takes each ``workers``-th band of rows, and all triangles in order."""
    height = depth.shape[0]
    count = len(indices)
    rows = np.empty((count, 2), np.int32)  # first row and the one after the last
    for t in prange(count):
        low, high, ahead = np.inf, -np.inf, True
        for k in range(3):
            v = indices[t, k]
            ahead &= placed[v, _IW] > 0
            low, high = min(low, placed[v, _Y]), max(high, placed[v, _Y])
        rows[t, 0] = _first_centre(min(max(low, 0.0), height)) if ahead else height
        rows[t, 1] = _first_centre(max(min(high, height), 0.0)) if ahead else 0
    for worker in prange(workers):
        for band in range(worker, -(-height // BAND_ROWS), workers):
            first, after = band * BAND_ROWS, min(height, (band + 1) * BAND_ROWS)
            place[first:after] = np.nan
            depth[first:after] = 1.0
            for t in range(count):
                if rows[t, 0] < after and rows[t, 1] > first:
                    a, b, c = int(indices[t, 0]), int(indices[t, 1]), int(indices[t, 2])
                    _triangle(placed, a, b, c, first, after, near, place, depth)
            for t in range(len(parts) // 3):
                _triangle(parts, 3 * t, 3 * t + 1, 3 * t + 2, first, after, near, place, depth)


class Rasteriser(Protocol):
    """Draws a grid mesh; `close` frees what it holds."""

    def draw(self, vertices: Any, indices: np.ndarray) -> tuple[Any, Any]:
        """(place, depth): see `gl.context.MeshRasteriser.draw`."""
        ...

    def close(self) -> None:
        """Free what is held outside Python."""
        ...


class SpanRasteriser:
    """Draws a grid mesh of ``columns`` x ``rows`` vertices into ``size_px``; see `gl.context.MeshRasteriser`."""

    def __init__(self, size_px: tuple[int, int], columns: int, rows: int, stage: Stage = unmeasured) -> None:
        self.size_px, self._stage = size_px, stage
        width, height = size_px
        self._placed = np.zeros((columns * rows, _VALUES))
        self._place_px = aligned(np.zeros(width * height * 2), np.float32)
        self._depth_values = aligned(np.zeros(width * height), np.float32)

    def draw(self, vertices: Any, indices: np.ndarray) -> tuple[Any, Any]:
        """(place, depth) of ``vertices`` as the triangles of ``indices``, as `gl.context.MeshRasteriser.draw`."""
        with self._stage("raster"):
            return self._draw(vertices, indices)

    def _draw(self, vertices: Any, indices: np.ndarray) -> tuple[Any, Any]:
        width, height = self.size_px
        host = vertices.numpy().reshape(-1, FLOATS_A_VERTEX)
        triangles = indices.reshape(-1, 3)
        place = self._place_px.reshape(height, width, 2)
        depth = self._depth_values.reshape(height, width)
        with cores_for_numba():  # kernels that read the last result are done before it is written over
            _place_vertices(host, width, height, NEAR, self._placed)
            parts = _clipped(host, triangles, self._placed, width, height, NEAR)
            _draw(self._placed, triangles, parts, NEAR, 2 * get_num_threads(), place, depth)
        return mi.Float(self._place_px), mi.Float(self._depth_values)

    def close(self) -> None:
        """Nothing is held outside Python."""


Choice = Literal["auto", "numba", "moderngl"]


def make_rasteriser(
    choice: Choice, on_gpu: bool, size_px: tuple[int, int], columns: int, rows: int, stage: Stage = unmeasured
) -> Rasteriser:
    """``choice`` 'auto' is moderngl where rays are traced on a GPU (``on_gpu``), else numba. ``stage`` measures drawing
    as 'raster' and what moderngl's data costs on its way as 'crossing'.

    Raises InputError where moderngl is chosen and there is no OpenGL without a window.
    """
    if choice == "numba" or (choice == "auto" and not on_gpu):
        return SpanRasteriser(size_px, columns, rows, stage)
    return MeshRasteriser(size_px, columns, rows, stage)
