"""Quality in just-objectionable differences by ColorVideoVDP (Mantiuk et al. 2024) and, for an eye that looks at one
place, FovVideoVDP (Mantiuk et al. 2021): optional extras.

10 JOD: no visible difference; 1 JOD less: 75 % of observers would choose the other. Need the packages ``cvvdp`` and
``pyfvvdp`` (with PyTorch; the second is for research only, CC BY-NC), which are not among our requirements.
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


_EXTRAS = {"--jod": ("pycvvdp", "cvvdp", "ColorVideoVDP"), "--jod-gaze": ("pyfvvdp", "pyfvvdp", "FovVideoVDP")}


def require_jod(option: str = "--jod") -> None:
    """Raise InputError, saying what to install, where the metric of ``option`` (--jod | --jod-gaze) is not there."""
    module, package, metric = _EXTRAS[option]
    if importlib.util.find_spec(module) is None:
        raise InputError(problem(option, metric, "not installed", f"`pip install {package}` (it brings PyTorch)"))


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
        quality, _ = self._metric.predict(*_codes(test, reference), dim_order="FHWC", frames_per_second=float(rate_hz))
        return float(quality)


class GazeJodMetric:
    """FovVideoVDP for pictures of one size, looked at in one place: ``gaze_px`` (x, y) from the top left, pixel centres
    at .5; it may lie outside the picture. Raises InputError where the package is not installed."""

    def __init__(self, size_px: tuple[int, int], ppd: float, gaze_px: tuple[float, float]) -> None:
        require_jod("--jod-gaze")
        package: Any = importlib.import_module("pyfvvdp")
        geometry = package.fvvdp_display_geometry(
            size_px, distance_m=1.0, diagonal_size_inches=diagonal_inches(size_px, ppd)
        )
        self._metric = package.fvvdp(
            display_name="standard_4k", display_geometry=geometry, foveated=True, heatmap=None, quiet=True
        )
        self._fixation = np.array(gaze_px, np.float64) - 0.5  # it counts from the first pixel's centre

    def of(self, test: np.ndarray, reference: np.ndarray, rate_hz: Fraction) -> float:
        """JOD of display values (n, H, W, 3) in [0, 1] at ``rate_hz``, both as 8-bit codes."""
        quality, _ = self._metric.predict(
            *_codes(test, reference), dim_order="FHWC", frames_per_second=float(rate_hz), fixation_point=self._fixation
        )
        return float(quality)


def _codes(*values: np.ndarray) -> list[np.ndarray]:
    return [np.rint(np.clip(value, 0, 1) * 255).astype(np.uint8) for value in values]
