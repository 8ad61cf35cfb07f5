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

import numba
import numpy as np

from renderers.acuity import GazeError
from renderers.technique import ViewGeometry

INTEGRATED_REFRESHES = 4


@dataclass(frozen=True)
class SequenceError:
    """Errors of one sequence. RMSE and flicker are in display values (x 255 for codes); FLIP in [0, 1]; PSNR in dB;
    ``rmse_gaze``: of both eyes, as far as the eye resolves it (None where no gaze was given)."""

    refreshes: int
    rmse: float
    psnr_db: float
    rmse_still: float
    rmse_tracking: float
    flip_still: float
    flip_tracking: float
    flicker: float
    rmse_by_refresh: tuple[float, ...]
    rmse_gaze: float | None = None


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
    return float(np.sqrt(np.mean(second * second, dtype=np.float64)))


@numba.njit(cache=True, nogil=True)
def _followed(pictures, motion, total):  # pragma: no cover  (compiled)
    """Add to ``total`` (H, W, 3) every picture but the last along the motion that ends at each pixel of the last."""
    n, height, width = pictures.shape[0], pictures.shape[1], pictures.shape[2]
    for row in range(height):
        for column in range(width):
            x, y = float(column), float(row)
            for k in range(n - 1, 0, -1):
                # bilinear, clamped to the edge: first the motion here, then the picture there
                for fetched in range(2):
                    cx, cy = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
                    x0, y0 = int(cx), int(cy)
                    x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
                    fx, fy = cx - x0, cy - y0
                    a, b, c, d = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
                    if fetched == 0:
                        m = motion[k]
                        x -= a * m[y0, x0, 0] + b * m[y0, x1, 0] + c * m[y1, x0, 0] + d * m[y1, x1, 0]
                        y -= a * m[y0, x0, 1] + b * m[y0, x1, 1] + c * m[y1, x0, 1] + d * m[y1, x1, 1]
                    else:
                        p = pictures[k - 1]
                        for j in range(total.shape[2]):
                            seen = a * p[y0, x0, j] + b * p[y0, x1, j] + c * p[y1, x0, j] + d * p[y1, x1, j]
                            total[row, column, j] += seen


def tracked_mean(pictures: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The mean of n pictures along the motion that ends at each pixel of the last one.

    Args:
        pictures: (n, H, W, 3).
        motion: (n, H, W, 2) pixels a refresh, x right and y down, now - before; entry 0 is not used.
    """
    total = np.array(pictures[-1], np.float64)
    _followed(np.ascontiguousarray(pictures, np.float32), np.ascontiguousarray(motion, np.float32), total)
    return total / len(pictures)


@dataclass(frozen=True)
class _Window:
    """Four refreshes as one eye sees them: which, the reference's mean, and whether FLIP is taken."""

    refreshes: slice
    eye: str
    wanted: np.ndarray
    flip: bool


class Comparison:
    """The reference's half of every comparison with one sequence, made once for all that is compared with it.

    Args:
        reference: display-referred refreshes (n, H, W, 3).
        motion: the reference's, (n, H, W, 2).
        ppd: pixels per degree, for FLIP.
        flip_windows: windows of four refreshes are integrated; RMSE uses all of them, FLIP (and the gaze's RMSE) so
            many, evenly spread.
        gaze: what the eye resolves of an error, for ``rmse_gaze``.

    Raises ValueError where the lengths differ or nothing is there.
    """

    def __init__(
        self,
        reference: Sequence[np.ndarray] | np.ndarray,
        motion: Sequence[np.ndarray] | np.ndarray,
        ppd: float,
        flip_windows: int = 4,
        gaze: GazeError | None = None,
    ) -> None:
        n = len(reference)
        if n == 0 or len(motion) != n:
            raise ValueError(f"sequences of {n} refreshes and {len(motion)} motions cannot be compared")
        self._reference, self._motion = np.asarray(reference, np.float32), np.asarray(motion, np.float32)
        self._ppd, self._gaze = ppd, gaze
        length = min(INTEGRATED_REFRESHES, n)
        starts = list(range(0, n - length + 1, length))
        chosen = np.linspace(0, len(starts) - 1, min(flip_windows, len(starts))).round().astype(int)
        shown = {starts[i] for i in chosen}
        self._windows = [
            _Window(refreshes, eye, self._seen(self._reference, refreshes, eye), refreshes.start in shown)
            for refreshes in (slice(start, start + length) for start in starts)
            for eye in ("still", "tracking")
        ]

    def _seen(self, pictures: np.ndarray, refreshes: slice, eye: str) -> np.ndarray:
        """What an eye integrates."""
        if eye == "still":
            return pictures[refreshes].mean(0)
        return tracked_mean(pictures[refreshes], self._motion[refreshes])

    def error(self, test: Sequence[np.ndarray] | np.ndarray) -> SequenceError:
        """Every error of ``test`` (n, H, W, 3). Raises ValueError where it has another length."""
        if len(test) != len(self._reference):
            raise ValueError(f"sequences of {len(test)} and {len(self._reference)} refreshes cannot be compared")
        tests = np.asarray(test, np.float32)
        errors = tests - self._reference
        by_refresh = np.sqrt(np.mean(errors * errors, axis=(1, 2, 3), dtype=np.float64))
        squares: dict[str, list[float]] = {"still": [], "tracking": []}
        flips: dict[str, list[float]] = {"still": [], "tracking": []}
        resolved: list[float] = []
        for window in self._windows:
            seen = self._seen(tests, window.refreshes, window.eye)
            squares[window.eye].append(rmse(seen, window.wanted) ** 2)
            if window.flip:
                flips[window.eye].append(flip(seen, window.wanted, self._ppd))
                if self._gaze is not None:
                    resolved.append(self._gaze.rmse(seen, window.wanted) ** 2)
        overall = float(np.sqrt(np.mean(by_refresh**2)))
        return SequenceError(
            refreshes=len(tests),
            rmse=overall,
            psnr_db=psnr_db(overall),
            rmse_still=math.sqrt(np.mean(squares["still"])),
            rmse_tracking=math.sqrt(np.mean(squares["tracking"])),
            flip_still=float(np.mean(flips["still"])),
            flip_tracking=float(np.mean(flips["tracking"])),
            flicker=flicker(errors),
            rmse_by_refresh=tuple(float(value) for value in by_refresh),
            rmse_gaze=None if self._gaze is None else math.sqrt(np.mean(resolved)),
        )


def sequence_error(
    test: Sequence[np.ndarray] | np.ndarray,
    reference: Sequence[np.ndarray] | np.ndarray,
    motion: Sequence[np.ndarray] | np.ndarray,
    ppd: float,
    flip_windows: int = 4,
) -> SequenceError:
    """Every error of one sequence of display-referred refreshes (n, H, W, 3): a `Comparison` that is used once."""
    return Comparison(reference, motion, ppd, flip_windows).error(test)


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
