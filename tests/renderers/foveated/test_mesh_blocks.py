"""Flat blocks: the mesh stays whole whichever blocks are flat, and only what is flat to the tolerance is."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from renderers.backend import activate, mi
from renderers.foveated.mesh_blocks import FLAT_DEPTH, FLAT_PX, SIZES, BlockMesh, blocks_of, flat_blocks
from renderers.foveated.support import SupportGrid

activate()
GRID = SupportGrid(200, 160, 40, 32)  # 41 x 33 cells: no multiple of a block


def some_flat(grid: SupportGrid, share: float, seed: int) -> dict[int, np.ndarray]:
    rng = np.random.default_rng(seed)
    found = {}
    for size in SIZES:
        across, down = blocks_of(grid, size)
        found[size] = (rng.random(across * down) < share).astype(np.uint32)
    return found


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9, 0.98, 1.0])
@pytest.mark.parametrize("grid", [GRID, SupportGrid(5, 5, 1, 1), SupportGrid(90, 30, 19, 6)])
def test_the_mesh_is_whole_and_has_no_t_junction(grid: SupportGrid, share: float) -> None:
    """Every inner edge belongs to two triangles, and the triangles fill the picture once."""
    columns, rows = grid.mesh
    triangles = BlockMesh(grid).indices(some_flat(grid, share, 1)).reshape(-1, 3).astype(int)
    y, x = np.divmod(triangles, columns)
    area = np.abs((x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])) / 2
    assert (area > 0).all()
    assert area.sum() == (columns - 1) * (rows - 1)
    edges = Counter(tuple(sorted((t[i], t[(i + 1) % 3]))) for t in triangles.tolist() for i in range(3))
    for (a, b), count in edges.items():
        (ya, xa), (yb, xb) = divmod(a, columns), divmod(b, columns)
        rim = xa == xb in (0, columns - 1) or ya == yb in (0, rows - 1)
        assert count == (1 if rim else 2)
    if share == 1.0 and grid is GRID:
        assert len(triangles) < 0.2 * 2 * (columns - 1) * (rows - 1)
    if share == 0.0:
        assert len(triangles) == 2 * (columns - 1) * (rows - 1)


def vertices(grid: SupportGrid, depth: np.ndarray, shift_px: np.ndarray) -> mi.Float:
    """As `support.move` makes them: seen at ``depth`` before and now, ``shift_px`` (H, W) further right now."""
    x, y, _ = grid.vertices()
    z = depth.ravel()
    now = (x + shift_px.ravel()) / grid.width * 2 - 1
    at = np.stack([now * z, (y / grid.height * 2 - 1) * z, z - 1e-3, z], -1)
    was = np.stack([x * z, y * z, z, 0 * z], -1)
    return mi.Float(np.concatenate([at, was], -1).astype(np.float32).ravel())


def flat_of(depth: np.ndarray, shift_px: np.ndarray, size: int) -> np.ndarray:
    across, down = blocks_of(GRID, size)
    block = mi.UInt32(np.arange(across * down))
    return flat_blocks(GRID, size, vertices(GRID, depth, shift_px), block).numpy().reshape(down, across)


@pytest.mark.parametrize("size", SIZES)
def test_a_tilted_plane_is_flat_and_a_step_in_it_is_not(size: int) -> None:
    columns, rows = GRID.mesh
    x, y, _ = GRID.vertices()
    depth = (1 / (0.5 + 0.002 * x + 0.001 * y)).reshape(rows, columns)  # 1 / z is linear in the picture
    parallax = 6 / depth
    assert flat_of(depth, parallax, size).all()
    stepped = depth.copy()
    stepped[:, size + size // 4 :] *= 1.2
    found = flat_of(stepped, parallax, size)
    assert not found[:, 1].any()
    assert found[:, [0, *range(2, found.shape[1])]].all()
    behind = depth.copy()
    behind[size // 2, size // 2] = -1.0
    assert not flat_of(behind, parallax, size)[0, 0]


@pytest.mark.parametrize(("off_px", "off_depth"), [(FLAT_PX, 0.0), (0.0, FLAT_DEPTH)])
def test_the_tolerances_are_kept(off_px: float, off_depth: float) -> None:
    columns, rows = GRID.mesh
    for share, wanted in ((0.9, 1), (1.1, 0)):
        depth, shift = np.ones((rows, columns)), np.zeros((rows, columns))
        depth[2, 2] += share * off_depth
        shift[2, 2] += share * off_px
        found = flat_of(depth, shift, 4)
        assert found[0, 0] == wanted
        assert found.sum() == found.size - 1 + wanted
