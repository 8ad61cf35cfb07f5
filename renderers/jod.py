"""Quality in just-objectionable differences by ColorVideoVDP (Mantiuk et al. 2024), an optional extra.

10 JOD: no visible difference; 1 JOD less: 75 % of observers would choose the other. Needs the package ``cvvdp`` (with
PyTorch), which is not among our requirements.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from fractions import Fraction
from typing import Any

import numpy as np

from stimuli.errors import InputError, problem

_METRE_PER_INCH = 0.0254


def require_jod() -> None:
    """Raise InputError, saying what to install, where ColorVideoVDP is not there."""
    if importlib.util.find_spec("pycvvdp") is None:
        raise InputError(problem("--jod", "ColorVideoVDP", "not installed", "`pip install cvvdp` (it brings PyTorch)"))


def diagonal_inches(size_px: tuple[int, int], ppd: float, distance_m: float = 1.0) -> float:
    """Diagonal of a flat screen of ``size_px`` that shows ``ppd`` pixels a degree in its middle at ``distance_m``."""
    pixel_m = math.pi / 180 * distance_m / ppd
    return math.hypot(*size_px) * pixel_m / _METRE_PER_INCH


class JodMetric:
    """ColorVideoVDP for pictures of one size. Raises InputError where the package is not installed."""

    def __init__(self, size_px: tuple[int, int], ppd: float) -> None:
        require_jod()
        package: Any = importlib.import_module("pycvvdp")
        self._metric = package.cvvdp(display_name="standard_4k", heatmap=None)
        self._metric.set_display_model(
            display_name="standard_4k",
            display_geometry=package.vvdp_display_geometry(
                size_px, distance_m=1.0, diagonal_size_inches=diagonal_inches(size_px, ppd)
            ),
        )

    def of(self, test: np.ndarray, reference: np.ndarray, rate_hz: Fraction) -> float:
        """JOD of display values (n, H, W, 3) in [0, 1] at ``rate_hz``, both as 8-bit codes."""
        codes = [np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8) for values in (test, reference)]
        quality, _ = self._metric.predict(*codes, dim_order="FHWC", frames_per_second=float(rate_hz))
        return float(quality)
