"""The default exposure of a scene: one number for a whole study, made from the reference, never adapted over time."""

from __future__ import annotations

import math

import numpy as np

LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)
"""Rec.709 luminance of linear R, G, B."""
MIDDLE_GREY = 0.18
PROBE_SIZE_PX = (64, 64)
PROBE_SEED = 0


def luminance(linear: np.ndarray) -> np.ndarray:
    """(..., 3) linear Rec.709 -> (...) relative luminance, float64."""
    return np.asarray(linear, np.float64) @ np.asarray(LUMINANCE_WEIGHTS)


def default_exposure(picture: np.ndarray) -> float:
    """0.18 / log-average luminance of ``picture`` (H, W, 3) linear, rounded to 1/8 stop (a power of 2^(1/8)).

    The average (the key of Reinhard et al. 2002) is over the pixels that have light, so a black background does not
    brighten a scene; 1.0 for an all-black picture. ``picture``: the reference at the clip's start, `PROBE_SIZE_PX`.
    """
    light = luminance(picture)
    lit = light[np.isfinite(light) & (light > 0)]
    if lit.size == 0:
        return 1.0
    stops = math.log2(MIDDLE_GREY) - float(np.mean(np.log2(lit)))
    return 2.0 ** (round(8.0 * stops) / 8.0)
