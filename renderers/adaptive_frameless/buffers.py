"""What the sampler remembers, as flat arrays for compiled code: entries, queues, tiles, and the sample stream.

Names in capitals are columns. Pictures are numbered in scanline order, pixel = y * W + x. Times are scene seconds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# entry_f, float32: luma of centre, left, right, up, down; the centre's place in the picture; gradients; hit points.
LUMA, X, Y, GX, GY, GT, POINT = 0, 5, 6, 7, 8, 9, 10
ENTRY_F = 25
# entry_i, int32: movers of the five samples; pixel whose queue holds it (-1: none); its marks.
MOVER, PIXEL, ASKED, OCCLUDED = 0, 5, 6, 7
# node_i, int32: the rectangle [X0, X1) x [Y0, Y1); tree; place in the list of leaves (-1: an inner node).
X0, Y0, X1, Y1, PARENT, LEFT, RIGHT, PLACE = range(8)
# node_f, float64: sums over the entries in the tile; W.. over samples, G.. over crosshairs, all weighted by age.
W, WL, WLL, G, GGX, GGY, GTW, GGT, COUNT, HIDDEN = range(10)
NODE_F = 10
# node_p, float64: the initiating sample that waits for its crosshair.
HAS, PX, PY, PLUMA, PTIME, PPOINT, PMOVER = 0, 1, 2, 3, 4, 5, 8
NODE_P = 9
# number, int64.
LEAVES, FREE, FREE_NODES, ENTRIES, PAIRS, WAIT_FIRST, WAITING, NEXT, KEPT, TARGET, CHUNKS, PUT, TOUCHED = range(13)
# total, float64: W .. GGT of the whole picture stand at their own columns.
EPOCH, TIMES, SUM_V, SUM_U, SUM_O = range(10, 15)
BLOCK = 32
"""Tiles (and pairs of tiles) whose largest (least) error is remembered together."""
# wait, float64: crosshairs to be made anew where one was found hidden: place, the hidden centre's luma and time.
WAIT = 4
# stream_f, float32: linear colour, hit point, place in the picture when it was made.
STREAM_F = 8


class Buffers(NamedTuple):
    """C = W * H * depth entries, M nodes, N samples of the stream.

    ``entry_f`` (C, ENTRY_F), ``entry_t`` (C,), ``entry_i`` (C, 8), ``free`` (C,) a stack; ``queue`` (W * H, depth)
    newest first, ``fill`` and ``leaf_of`` (W * H,); ``node_i`` (M, 8), ``node_f`` (M, NODE_F), ``node_p`` (M, NODE_P),
    ``free_nodes`` (M,); ``leaves``, ``error``, ``pairs`` (M,): tiles, their errors, parents of two leaves;
    ``pair_place`` (M,); ``leaf_best``, ``pair_best`` (M / BLOCK + 1,): the places of the worst tile and the calmest
    pair of each block (-1: none), true where ``leaf_stale``, ``pair_stale`` are not set; ``touched`` (M,): tiles whose
    sums have changed since their error was found, ``is_touched`` (M,) marks them; ``wait`` a ring; ``stream_f``
    (N, STREAM_F), ``stream_i`` (N,) movers, ``stream_t`` (N,) a ring in order of time; ``number`` and ``total`` as the
    columns above say; ``pose`` (2, 3, 4) and ``arm`` (2, 5) are room to work in (compiled code allocates nothing).
    """

    entry_f: np.ndarray
    entry_t: np.ndarray
    entry_i: np.ndarray
    free: np.ndarray
    queue: np.ndarray
    fill: np.ndarray
    leaf_of: np.ndarray
    node_i: np.ndarray
    node_f: np.ndarray
    node_p: np.ndarray
    free_nodes: np.ndarray
    leaves: np.ndarray
    error: np.ndarray
    pairs: np.ndarray
    pair_place: np.ndarray
    leaf_best: np.ndarray
    leaf_stale: np.ndarray
    pair_best: np.ndarray
    pair_stale: np.ndarray
    touched: np.ndarray
    is_touched: np.ndarray
    wait: np.ndarray
    stream_f: np.ndarray
    stream_i: np.ndarray
    stream_t: np.ndarray
    number: np.ndarray
    total: np.ndarray
    pose: np.ndarray
    arm: np.ndarray


class Settings(NamedTuple):
    """Numbers that the compiled code is given; see `renderers.parameters.AdaptiveFrameless`."""

    width: int
    height: int
    depth: int
    reprojected: int
    least_tile_px: int
    least_tiles: int
    most_tiles: int
    moves: int
    chunk: int
    kappa: float
    lam: float
    m: float
    gain: float
    area_power: float
    decay_per_s: float
    exposure: float
    followed: bool


def make_buffers(s: Settings, kept: int) -> Buffers:
    """Empty buffers with one tile that is the whole picture."""
    pixels = s.width * s.height
    entries, nodes = pixels * s.depth, 2 * s.most_tiles + 2
    blocks = nodes // BLOCK + 1
    b = Buffers(
        entry_f=np.empty((entries, ENTRY_F), np.float32),
        entry_t=np.empty(entries, np.float64),
        entry_i=np.zeros((entries, 8), np.int32),
        free=np.arange(entries - 1, -1, -1, dtype=np.int32),
        queue=np.zeros((pixels, s.depth), np.int32),
        fill=np.zeros(pixels, np.int32),
        leaf_of=np.zeros(pixels, np.int32),
        node_i=np.full((nodes, 8), -1, np.int32),
        node_f=np.zeros((nodes, NODE_F)),
        node_p=np.zeros((nodes, NODE_P)),
        free_nodes=np.arange(nodes - 1, -1, -1, dtype=np.int32),
        leaves=np.zeros(nodes, np.int32),
        error=np.zeros(nodes),
        pairs=np.zeros(nodes, np.int32),
        pair_place=np.full(nodes, -1, np.int32),
        leaf_best=np.full(blocks, -1, np.int32),
        leaf_stale=np.ones(blocks, np.bool_),
        pair_best=np.full(blocks, -1, np.int32),
        pair_stale=np.ones(blocks, np.bool_),
        touched=np.zeros(nodes, np.int32),
        is_touched=np.zeros(nodes, np.bool_),
        wait=np.zeros((max(64, pixels // 16), WAIT)),
        stream_f=np.empty((kept, STREAM_F), np.float32),
        stream_i=np.zeros(kept, np.int32),
        stream_t=np.zeros(kept),
        number=np.zeros(16, np.int64),
        total=np.zeros(16),
        pose=np.zeros((2, 3, 4)),
        arm=np.zeros((2, 5)),
    )
    b.node_i[0] = (0, 0, s.width, s.height, -1, -1, -1, 0)
    b.number[LEAVES], b.number[FREE], b.number[FREE_NODES] = 1, entries, nodes - 1
    b.number[TARGET] = s.least_tiles
    return b
