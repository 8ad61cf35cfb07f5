"""Errors as an eye that looks at one place can resolve them: finest there, coarser with eccentricity.

The smallest angle that is resolved grows linearly with eccentricity (Weymouth 1958; slope 0.022 and 1/48 degree in the
fovea: Guenter et al. 2012). Finer detail of the error is blurred away before it is squared, and a pixel counts for as
many as it holds of what the eye resolves there. No metric of a paper: a plain companion of RMSE for techniques that
follow the gaze; FovVideoVDP (an optional extra) models more.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter

SLOPE = 0.022
FOVEAL_DEG = 1 / 48
_SIGMAS_PX = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)


def resolved_px(eccentricity_deg: np.ndarray, pixels_per_degree: float) -> np.ndarray:
    """The smallest resolved distance in pixels at each eccentricity; at least 1: a display has no finer detail."""
    return np.maximum(1.0, (SLOPE * np.asarray(eccentricity_deg, np.float64) + FOVEAL_DEG) * pixels_per_degree)


class GazeError:
    """RMSE of pictures of one size seen by one gaze.

    Args:
        eccentricity_deg: (H, W) of every pixel.
        pixels_per_degree: of the picture's middle.
    """

    def __init__(self, eccentricity_deg: np.ndarray, pixels_per_degree: float) -> None:
        resolved = resolved_px(eccentricity_deg, pixels_per_degree)
        self._weights = 1 / resolved**2
        self._weights /= self._weights.sum()
        # a Gaussian of half the resolved distance; a picture pixel is already as wide as one
        sigma = 0.5 * np.sqrt(resolved**2 - 1)
        levels = [s for s in _SIGMAS_PX if s < sigma.max()]
        self._levels = [*levels, next((s for s in _SIGMAS_PX if s >= sigma.max()), _SIGMAS_PX[-1])]
        place = np.interp(sigma, self._levels, np.arange(len(self._levels))) if len(self._levels) > 1 else 0 * sigma
        # each pixel blends its two nearest blurs
        self._shares = [np.maximum(0, 1 - np.abs(place - k)).astype(np.float32) for k in range(len(self._levels))]

    def rmse(self, test: np.ndarray, reference: np.ndarray) -> float:
        """Root mean square over channels, and over pixels by weight, of the blurred difference of two (H, W, 3)."""
        difference = np.asarray(test - reference, np.float32)
        seen = np.zeros_like(difference)
        for sigma, share in zip(self._levels, self._shares, strict=True):
            blurred = difference if sigma == 0 else gaussian_filter(difference, (sigma, sigma, 0), truncate=3.0)
            seen += share[..., None] * blurred
        return math.sqrt(float(np.sum(self._weights[..., None] * seen.astype(np.float64) ** 2)) / 3)
