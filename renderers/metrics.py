"""How far a sequence is from the gold standard, as a still and as a tracking eye sees it.

All pictures are display values in [0, 1] before rounding (`stimuli.encode.display_values`), (H, W, 3). An eye
integrates four refreshes at 240 Hz: the still eye at fixed pixels, the tracking eye along the reference's motion.
Sources: RMSE and flicker as in the project's decisions; FLIP: Andersson et al. 2020, by `flip-evaluator`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import map_coordinates

from renderers.technique import ViewGeometry

INTEGRATED_REFRESHES = 4


@dataclass(frozen=True)
class SequenceError:
    """Errors of one sequence. RMSE and flicker are in display values (x 255 for codes); FLIP in [0, 1]; PSNR in dB."""

    refreshes: int
    rmse: float
    psnr_db: float
    rmse_still: float
    rmse_tracking: float
    flip_still: float
    flip_tracking: float
    flicker: float
    rmse_by_refresh: tuple[float, ...]


def rmse(test: np.ndarray, reference: np.ndarray) -> float:
    """Root mean squared difference over pixels and channels."""
    difference = np.asarray(test, np.float64) - np.asarray(reference, np.float64)
    return float(np.sqrt(np.mean(difference * difference)))


def psnr_db(error: float) -> float:
    """Peak signal to noise ratio of an RMSE against a peak of 1; inf where there is no error."""
    return math.inf if error == 0 else -20.0 * math.log10(error)


def _flip(test: np.ndarray, reference: np.ndarray, pixels_per_degree: float) -> tuple[np.ndarray, float]:
    """The map and the mean of LDR-FLIP (Andersson et al. 2020) of two sRGB pictures."""
    import flip_evaluator  # compiled, only needed here

    found, mean, _ = flip_evaluator.evaluate(
        np.ascontiguousarray(reference, np.float32),
        np.ascontiguousarray(test, np.float32),
        "LDR",
        inputsRGB=True,
        applyMagma=False,
        computeMeanError=True,
        parameters={"ppd": float(pixels_per_degree)},
    )
    return np.asarray(found).reshape(test.shape[:2]), float(mean)


def flip_map(test: np.ndarray, reference: np.ndarray, pixels_per_degree: float) -> np.ndarray:
    """(H, W) LDR-FLIP of two sRGB pictures, in [0, 1] (Andersson et al. 2020)."""
    return _flip(test, reference, pixels_per_degree)[0]


def flip(test: np.ndarray, reference: np.ndarray, pixels_per_degree: float) -> float:
    """Mean LDR-FLIP of two sRGB pictures (Andersson et al. 2020)."""
    return _flip(test, reference, pixels_per_degree)[1]


def pixels_per_degree(width_px: int, height_px: int, yfov_rad: float, geometry: ViewGeometry | None) -> float:
    """pi / 180 * distance * pixels / width of a flat screen; where none is given, W / the camera's horizontal field."""
    if geometry is not None:
        return math.pi / 180 * geometry.distance_m * width_px / geometry.width_m
    horizontal_deg = 2 * math.degrees(math.atan(math.tan(yfov_rad / 2) * width_px / height_px))
    return width_px / horizontal_deg


def flicker(errors: np.ndarray) -> float:
    """RMS over pixels, channels and k of (e[k] - 2 e[k+1] + e[k+2]) / 4; errors (n, H, W, 3); 0 below 3 refreshes."""
    if len(errors) < 3:
        return 0.0
    second = (errors[:-2] - 2 * errors[1:-1] + errors[2:]) / 4
    return float(np.sqrt(np.mean(second.astype(np.float64) ** 2)))


def _sample(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear, clamped to the edge; x, y in array indices."""
    return np.stack(
        [map_coordinates(picture[..., c], (y, x), order=1, mode="nearest") for c in range(picture.shape[2])], 2
    )


def tracked_mean(pictures: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The mean of n pictures along the motion that ends at each pixel of the last one.

    Args:
        pictures: (n, H, W, 3).
        motion: (n, H, W, 2) pixels a refresh, x right and y down, now - before; entry 0 is not used.
    """
    n, height, width, _ = pictures.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    total = pictures[-1].astype(np.float64)
    for k in range(n - 1, 0, -1):
        step = _sample(motion[k].astype(np.float64), x, y)
        x, y = x - step[..., 0], y - step[..., 1]
        total = total + _sample(pictures[k - 1].astype(np.float64), x, y)
    return total / n


def sequence_error(
    test: Sequence[np.ndarray] | np.ndarray,
    reference: Sequence[np.ndarray] | np.ndarray,
    motion: Sequence[np.ndarray] | np.ndarray,
    ppd: float,
    flip_windows: int = 4,
) -> SequenceError:
    """Every error of a sequence of display-referred refreshes (n, H, W, 3) against the reference's.

    ``motion``: the reference's, (n, H, W, 2). Windows of four refreshes are integrated; RMSE uses all of them, FLIP
    ``flip_windows`` of them, evenly spread. Raises ValueError where the lengths differ or nothing is there.
    """
    n = len(test)
    if n == 0 or len(reference) != n or len(motion) != n:
        raise ValueError(f"sequences of {n}, {len(reference)} and {len(motion)} refreshes cannot be compared")
    tests, references = np.asarray(test, np.float32), np.asarray(reference, np.float32)
    motions = np.asarray(motion, np.float32)
    errors = tests - references
    by_refresh = np.sqrt(np.mean(errors.astype(np.float64) ** 2, axis=(1, 2, 3)))
    length = min(INTEGRATED_REFRESHES, n)
    starts = list(range(0, n - length + 1, length))
    shown = {starts[i] for i in np.linspace(0, len(starts) - 1, min(flip_windows, len(starts))).round().astype(int)}
    squares: dict[str, list[float]] = {"still": [], "tracking": []}
    flips: dict[str, list[float]] = {"still": [], "tracking": []}
    for start in starts:
        window = slice(start, start + length)
        means = {
            "still": (tests[window].mean(0), references[window].mean(0)),
            "tracking": (
                tracked_mean(tests[window], motions[window]),
                tracked_mean(references[window], motions[window]),
            ),
        }
        for eye, (seen, wanted) in means.items():
            squares[eye].append(rmse(seen, wanted) ** 2)
            if start in shown:
                flips[eye].append(flip(seen, wanted, ppd))
    overall = float(np.sqrt(np.mean(by_refresh**2)))
    return SequenceError(
        refreshes=n,
        rmse=overall,
        psnr_db=psnr_db(overall),
        rmse_still=math.sqrt(np.mean(squares["still"])),
        rmse_tracking=math.sqrt(np.mean(squares["tracking"])),
        flip_still=float(np.mean(flips["still"])),
        flip_tracking=float(np.mean(flips["tracking"])),
        flicker=flicker(errors),
        rmse_by_refresh=tuple(float(value) for value in by_refresh),
    )


def ring_rmse(
    test: np.ndarray, reference: np.ndarray, eccentricity_deg: np.ndarray, edges_deg: Sequence[float]
) -> list[float]:
    """RMSE in each ring edges[i] <= eccentricity < edges[i + 1]; nan for a ring without pixels."""
    squared = np.mean((np.asarray(test, np.float64) - np.asarray(reference, np.float64)) ** 2, axis=2)
    rings = []
    for low, high in pairwise(edges_deg):
        inside = (eccentricity_deg >= low) & (eccentricity_deg < high)
        rings.append(float(np.sqrt(squared[inside].mean())) if inside.any() else math.nan)
    return rings
