"""Debug pictures of the sampler and reconstructor: the figures of Dayal et al. 2005 for the refresh last shown."""

from __future__ import annotations

import numpy as np

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers, Settings


def tile_borders(b: Buffers, s: Settings) -> np.ndarray:
    """(H, W) bool: pixels whose right or lower neighbour lies in another tile (Fig. 3)."""
    leaf = b.leaf_of.reshape(s.height, s.width)
    border = np.zeros(leaf.shape, bool)
    border[:, :-1] |= leaf[:, :-1] != leaf[:, 1:]
    border[:-1] |= leaf[:-1] != leaf[1:]
    return border


def debug_pictures(b: Buffers, s: Settings, samples_per_s: float, coverage: np.ndarray) -> dict[str, np.ndarray]:
    """(H, W) each: ``tiling`` (1 on borders; Fig. 3), ``gradient.X``, ``gradient.Y`` (display luma a pixel) and
    ``gradient.T`` (a second) of each tile (Fig. 4), ``density`` (samples a pixel and second that the tiling asks for;
    Fig. 7 left), ``samples`` (that reached the pixel), ``occlusions`` (|O| of its tile a pixel; Fig. 7 right),
    ``age`` (s before the newest crosshair of any pixel; inf where the queue is empty)."""
    shape = (s.height, s.width)
    sums = b.node_f[b.leaf_of]
    n = b.node_i[b.leaf_of]
    area = (n[:, c.X1] - n[:, c.X0]) * (n[:, c.Y1] - n[:, c.Y0])
    spatial, temporal = np.maximum(sums[:, c.G], 1e-300), np.maximum(sums[:, c.GTW], 1e-300)
    filled = b.fill > 0
    newest = np.where(filled, b.entry_t[b.queue[:, 0]], -np.inf)
    found = {
        "tiling": tile_borders(b, s).astype(np.float32).ravel(),
        "gradient.X": sums[:, c.GGX] / spatial,
        "gradient.Y": sums[:, c.GGY] / spatial,
        "gradient.T": sums[:, c.GGT] / temporal,
        "density": samples_per_s / (float(b.number[c.LEAVES]) * area),
        "samples": coverage,
        "occlusions": sums[:, c.HIDDEN] / area,
        "age": newest.max() - newest,
    }
    return {name: np.asarray(values, np.float32).reshape(shape) for name, values in found.items()}


def tiling_over(picture: np.ndarray, b: Buffers, s: Settings) -> np.ndarray:
    """A copy of the (H, W, 3) picture with tile borders in white."""
    drawn = np.array(picture, np.float32)
    drawn[tile_borders(b, s)] = 1.0
    return drawn
