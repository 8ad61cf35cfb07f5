"""How much light a clip asks of the display: mean, percentiles and clipped share, merged exactly from its frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from stimuli.exr import to_half

BINS = 65536
PERCENTILES = (1, 5, 25, 50, 75, 95, 99)


@dataclass(frozen=True)
class Light:
    """The displayed light of a run of frames. One entry a frame: ``totals`` (sum of relative luminance, peak = 1) and
    ``clipped`` (pixels with a channel above the display's range); ``histogram`` counts the pixels of all frames in
    `BINS` equal steps of luminance (uint64); every frame has ``pixels`` pixels."""

    totals: tuple[float, ...]
    clipped: tuple[int, ...]
    pixels: int
    histogram: np.ndarray


@numba.njit(cache=True, nogil=True)
def _measure(linear, exposure, histogram):  # pragma: no cover  (compiled)
    """(N, 3) float32 -> (sum of displayed luminance, pixels with a channel above 1); fills the histogram."""
    total = 0.0
    clipped = 0
    for i in range(linear.shape[0]):
        over = False
        light = 0.0
        for c in range(3):
            value = exposure * linear[i, c]
            if value > 1.0:
                over = True
                value = 1.0
            if not value > 0.0:  # negative or nan
                value = 0.0
            light += value * (0.2126 if c == 0 else 0.7152 if c == 1 else 0.0722)
        clipped += over
        total += light
        histogram[min(int(light * BINS), BINS - 1)] += 1
    return total, clipped


def measure_light(linear: np.ndarray, exposure: float, histogram: np.ndarray) -> tuple[float, int]:
    """(sum of luminance, clipped pixels) of one (H, W, 3) linear picture, as stored (rounded to half), before display
    codes; its pixels are added to ``histogram`` (`BINS`,) uint64."""
    values = np.ascontiguousarray(to_half(linear), np.float32).reshape(-1, 3)
    total, clipped = _measure(values, float(exposure), histogram)
    return float(total), int(clipped)


def join(runs: Sequence[Light]) -> Light:
    """The light of consecutive runs of frames; exact, so it does not matter how a clip was divided."""
    totals = tuple(total for run in runs for total in run.totals)
    clipped = tuple(count for run in runs for count in run.clipped)
    histogram = np.asarray(np.sum([run.histogram for run in runs], axis=0, dtype=np.uint64))
    return Light(totals, clipped, runs[0].pixels, histogram)


def summarise(light: Light) -> dict[str, object]:
    """``mean``, ``percentiles`` {"50": ...}, ``clipped_share``, ``frame_mean_low`` and ``_high`` (>= 1 frame)."""
    pixels = light.pixels * len(light.totals)
    cumulative = np.cumsum(light.histogram)
    ranks = [int(np.searchsorted(cumulative, math.ceil(p / 100 * pixels), side="left")) for p in PERCENTILES]
    return {
        "mean": math.fsum(light.totals) / pixels,
        "percentiles": {str(p): (rank + 0.5) / BINS for p, rank in zip(PERCENTILES, ranks, strict=True)},
        "clipped_share": sum(light.clipped) / pixels,
        "frame_mean_low": min(light.totals) / light.pixels,
        "frame_mean_high": max(light.totals) / light.pixels,
    }
