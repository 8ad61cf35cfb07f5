"""Debug pictures of the sampler and reconstructor: the figures of Dayal et al. 2005 for the refresh last shown."""

from __future__ import annotations

import numpy as np

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.buffers import Buffers, Settings
from stimuli.encode import display_values


def tile_borders(b: Buffers, s: Settings) -> np.ndarray:
    """(H, W) bool: pixels whose right or lower neighbour lies in another tile."""
    leaf = b.leaf_of.reshape(s.height, s.width)
    border = np.zeros(leaf.shape, bool)
    border[:, :-1] |= leaf[:, :-1] != leaf[:, 1:]
    border[:-1] |= leaf[:-1] != leaf[1:]
    return border


def tiling_over(picture: np.ndarray, b: Buffers, s: Settings) -> np.ndarray:
    """Display values (H, W, 3) of the linear picture with tile borders in white (Fig. 3)."""
    drawn = display_values(np.asarray(picture, np.float32), s.exposure)
    drawn[tile_borders(b, s)] = 1.0
    return drawn


def debug_pictures(
    b: Buffers, s: Settings, samples_per_s: float, picture: np.ndarray, coverage: np.ndarray
) -> dict[str, np.ndarray]:
    """What `--show` knows, (H, W) or (H, W, 3) each.

    ``tiling``: the picture under the tiles' borders (Fig. 3). ``gradients``: red G_x, green G_y, blue G_t of each tile,
    each as a share of its largest (Fig. 4); ``gradient.X``, ``gradient.Y`` in display luma a pixel, ``gradient.T`` a
    second. ``density``: samples a pixel and second that the tiling asks for; ``occlusions``: |O| of the tile a pixel
    (Fig. 7). ``samples``: that reached the pixel. ``age``: s before the newest crosshair of any pixel (inf: no
    crosshair). ``picture`` (H, W, 3) linear and ``coverage`` (W * H,) are the reconstructor's.
    """
    shape = (s.height, s.width)
    sums = b.node_f[b.leaf_of]
    n = b.node_i[b.leaf_of]
    area = (n[:, c.X1] - n[:, c.X0]) * (n[:, c.Y1] - n[:, c.Y0])
    spatial, temporal = np.maximum(sums[:, c.G], 1e-300), np.maximum(sums[:, c.GTW], 1e-300)
    gradients = np.stack([sums[:, c.GGX] / spatial, sums[:, c.GGY] / spatial, sums[:, c.GGT] / temporal], axis=1)
    newest = np.where(b.fill > 0, b.entry_t[b.queue[:, 0]], -np.inf)
    found = {
        "gradient.X": gradients[:, 0],
        "gradient.Y": gradients[:, 1],
        "gradient.T": gradients[:, 2],
        "density": samples_per_s / (float(b.number[c.LEAVES]) * area),
        "samples": coverage,
        "occlusions": sums[:, c.HIDDEN] / area,
        "age": newest.max() - newest,
    }
    maps = {name: np.asarray(values, np.float32).reshape(shape) for name, values in found.items()}
    shares = (gradients / np.maximum(gradients.max(axis=0), 1e-300)).astype(np.float32)
    return {"tiling": tiling_over(picture, b, s), "gradients": shares.reshape(*shape, 3)} | maps
