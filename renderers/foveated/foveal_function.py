"""How likely a pixel is traced, from its eccentricity (Weier et al. 2016, 3.1 and Fig. 3): numpy, float64."""

from __future__ import annotations

import numpy as np

from renderers.eccentricity import eye_plane, picture_eccentricity_deg
from renderers.parameters import Foveated
from renderers.technique import Gaze, ViewGeometry


def sampling_probability(eccentricity_deg: np.ndarray, params: Foveated) -> np.ndarray:
    """1 up to r0, then falling linearly towards ``p_min`` at r1, ``p_min`` beyond; r0 = r1 is a step."""
    r0, r1, p_min = params.region
    e = np.asarray(eccentricity_deg, np.float64)
    if np.isinf(r0):
        return np.ones_like(e)
    fall = (e - r0) / (r1 - r0) if r1 > r0 else np.ones_like(e)
    return np.where(e <= r0, 1.0, np.where(e >= r1, p_min, 1 - (1 - p_min) * np.clip(fall, 0, 1)))


def picture_probability(
    params: Foveated, size_px: tuple[int, int], yfov_rad: float, geometry: ViewGeometry | None = None,
    gaze: Gaze | None = None,
) -> np.ndarray:  # fmt: skip
    """(H, W) probabilities of a picture's pixels."""
    plane = eye_plane(size_px, yfov_rad, geometry, gaze)
    return sampling_probability(picture_eccentricity_deg(plane, size_px), params)
