"""Which movers must a ray ask? A small scene of boxes, one a body, each swept over the view's interval.

Bodies keep their own Mitsuba scenes, never rebuilt; only the boxes are rebuilt for each interval. A box is asked when
the ray enters it, or when it leaves it having started inside; the walk ends when the next box is behind the best hit.
Boxes are inflated by slightly different amounts, so that no two faces coincide. Where two faces still lie within one
step of each other on a ray, the second is passed over unseen: so the walk remembers, in 64 bits, which bodies it has
asked, and asks on leaving a box whose entry it never saw (without that, 10 of 518,400 pixels of bart_robots are off).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.space import corners

ASK_ALL = 4
"""Up to so many bodies every ray asks every body: cheaper than walking boxes (environment.md)."""
_INFLATION = 1e-5
_INFLATION_STEP = 5e-6
_INFLATION_CYCLE = 64
STEP = 2e-7
"""How far past a box face the walk goes on, relative to 1 + the distance walked."""

# Two triangles a face; faces in the order -x +x -y +y -z +z; corner k has bit `axis` set where it is high.
BOX_FACES = np.array(
    [[0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]],
    np.uint32,
)  # fmt: skip


def swept_boxes(own_bounds: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """(B, 2, 3) float64 tracer-space boxes of bodies with own-space bounds (B, 2, 3) and poses (B, K, 3, 4).

    Exact for linear blending: a blended corner lies on the segment between the corner's places at two knots.
    """
    boxes = np.empty_like(own_bounds, dtype=np.float64)
    for b, (bounds, poses) in enumerate(zip(own_bounds, matrices, strict=True)):
        places = corners(bounds[0], bounds[1]) @ poses[:, :, :3].transpose(0, 2, 1) + poses[:, None, :, 3]
        boxes[b] = places.min(axis=(0, 1)), places.max(axis=(0, 1))
    inflation = _INFLATION + _INFLATION_STEP * (np.arange(len(boxes)) % _INFLATION_CYCLE)
    inflation = inflation * (1 + np.abs(boxes).max(axis=(1, 2)))
    boxes[:, 0] -= inflation[:, None]
    boxes[:, 1] += inflation[:, None]
    return boxes


def box_vertices(boxes: np.ndarray) -> np.ndarray:
    """(B * 8 * 3,) float32 corner coordinates."""
    picks = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)], bool)
    return np.where(picks[None], boxes[:, None, 1], boxes[:, None, 0]).astype(np.float32).ravel()


def box_faces(count: int) -> np.ndarray:
    """(B * 12, 3) uint32 vertex numbers; a triangle's body is its number // 12."""
    return (BOX_FACES[None] + 8 * np.arange(count, dtype=np.uint32)[:, None, None]).reshape(-1, 3)


def must_ask(bounds: Any, body: Any, face: Any, origin: Any, direction: Any, active: Any) -> Any:
    """Whether a hit on a box's triangle (``face`` 0 to 11) means that its body must be asked.

    On entering the box, or on any face of a box in which the ray starts.
    """
    side = face // 2
    axis, high = side >> 1, (side & 1) == 1
    along = dr.select(axis == 0, direction.x, dr.select(axis == 1, direction.y, direction.z))
    entering = dr.select(high, along < 0, along > 0)
    low = dr.gather(mi.Vector4f, bounds, body * 2, active)
    top = dr.gather(mi.Vector4f, bounds, body * 2 + 1, active)
    inside = (
        (origin.x >= low.x) & (origin.x <= top.x)
        & (origin.y >= low.y) & (origin.y <= top.y)
        & (origin.z >= low.z) & (origin.z <= top.z)
    )  # fmt: skip
    return entering | inside
