"""Where the texels of a polar buffer look: eccentricity along x, the angle about the gaze along y (HERR, 3.1 and 3.2).

All on the host, float64; the same formulas inside kernels are in `renderers.polar.resolve`. Eye space: x right, y up,
-z forward (`renderers.eccentricity`). The texel (i, j) of a W x H buffer is at share (i + .5) / W of the radius and
turned by 360 (j + .5) / H degrees counter-clockwise from the right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from renderers.eccentricity import EyePlane
from renderers.parameters import PolarMapping
from stimuli.errors import InputError, problem

SAMPLES_PER_LOG = 200.0
"""f(e) = 200 / (e + 1) pixels per degree (HERR, equation 1)."""
FULL_PPD = 60.0
FULL_WIDTH = 1024
FULL_HALF_HEIGHT = 512
PAPER_DEG = 45.0
SIDE = 0.999  # the gaze looks along the right vector: the basis is then taken from `up`
_SERIES_BELOW = 0.1


def samples_to(eccentricity_deg: float) -> float:
    """Integral of f from the gaze: 200 ln(e + 1); 765.73 samples reach 45 degrees."""
    return SAMPLES_PER_LOG * math.log1p(eccentricity_deg)


def _growth(t: np.ndarray) -> np.ndarray:
    """ln(1 + t) + 1 / (1 + t) - 1, whose slope is t / (1 + t)^2; its series where it would cancel."""
    t = np.asarray(t, np.float64)
    series = sum((-1) ** n * (n - 1) / n * t**n for n in range(2, 10))
    return np.where(t < _SERIES_BELOW, series, np.log1p(t) - t / (1 + t))


@dataclass(frozen=True)
class RadialMap:
    """How the radius of the buffer grows with eccentricity, up to ``most_deg``.

    'acuity': samples per degree proportional to 1 / (e + 1) along the radius, as HERR has it. 'equal_density': the
    density of samples per square degree proportional to acuity squared everywhere, acuity = 1 / (slope e + foveal);
    small angles (Koskela et al. 2019 cut HERR's surplus at the gaze in the same spirit).
    """

    kind: PolarMapping
    most_deg: float
    mar_slope: float = 0.022
    mar_foveal_deg: float = 1 / 48

    def share(self, eccentricity_deg: np.ndarray | float) -> np.ndarray:
        """Share of the radius, 0 at the gaze and 1 at ``most_deg``."""
        e = np.asarray(eccentricity_deg, np.float64)
        if self.kind == "acuity":
            return np.log1p(e) / math.log1p(self.most_deg)
        ratio = self.mar_slope / self.mar_foveal_deg
        return _growth(ratio * e) / float(_growth(np.array(ratio * self.most_deg)))

    def eccentricity_deg(self, share: np.ndarray | float) -> np.ndarray:
        """The inverse of `share`, for shares in [0, 1]."""
        share = np.asarray(share, np.float64)
        if self.kind == "acuity":
            return np.expm1(share * math.log1p(self.most_deg))
        low, high = np.zeros_like(share), np.full_like(share, self.most_deg)
        for _ in range(60):  # bisection: 60 halvings are below float64's own steps
            middle = (low + high) / 2
            above = self.share(middle) > share
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return (low + high) / 2

    def centres_deg(self, width: int) -> np.ndarray:
        """(W,) eccentricities of the texels' centres."""
        return self.eccentricity_deg((np.arange(width) + 0.5) / width)

    def density(self, eccentricity_deg: np.ndarray, width: int, height: int) -> np.ndarray:
        """Samples per square degree at ``eccentricity_deg`` (> 0) of a ``width`` x ``height`` buffer."""
        e = np.asarray(eccentricity_deg, np.float64)
        if self.kind == "acuity":
            slope = 1 / ((e + 1) * math.log1p(self.most_deg))
        else:
            ratio = self.mar_slope / self.mar_foveal_deg
            t = ratio * e
            slope = ratio * t / (1 + t) ** 2 / float(_growth(np.array(ratio * self.most_deg)))
        return width * height / 360 * slope / np.sin(np.radians(e))


def gaze_basis(gaze: tuple[float, float, float]) -> np.ndarray:
    """(3, 3) rows right, up and gaze of the polar angle: the eye's right, made orthogonal to the gaze."""
    g = np.asarray(gaze, np.float64)
    g = g / np.linalg.norm(g)
    right, up = np.eye(3)[:2]
    if abs(right @ g) > SIDE:
        u = up - g * (up @ g)
        u /= np.linalg.norm(u)
        return np.stack([np.cross(g, u), u, g])
    r = right - g * (right @ g)
    r /= np.linalg.norm(r)
    return np.stack([r, np.cross(r, g), g])


def direction(basis: np.ndarray, theta_deg: np.ndarray, phi_rad: np.ndarray) -> np.ndarray:
    """(..., 3) unit eye directions at eccentricity theta and turn phi about the gaze."""
    theta = np.radians(np.asarray(theta_deg, np.float64))[..., None]
    phi = np.asarray(phi_rad, np.float64)[..., None]
    return np.cos(theta) * basis[2] + np.sin(theta) * (np.cos(phi) * basis[0] + np.sin(phi) * basis[1])


def polar_of(basis: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(theta in degrees, phi in [0, 2 pi)) of (..., 3) directions of any length."""
    across, above, along = (d @ row for row in basis)
    theta = np.degrees(np.arctan2(np.hypot(across, above), along))
    return theta, np.mod(np.arctan2(above, across), 2 * np.pi)


def farthest_deg(plane: EyePlane, size_px: tuple[int, int], gaze: np.ndarray) -> float:
    """Largest eccentricity of a picture. Corners decide up to 90 degrees; beyond, its edges and its inside too."""
    width, height = size_px
    corner, across, down = (np.asarray(v, np.float64) for v in (plane.corner, plane.step_x, plane.step_y))
    along = np.linspace(0.0, 1.0, 129)
    sides = [(along * width, 0.0 * along), (along * width, 0.0 * along + height)]
    sides += [(0.0 * along, along * height), (0.0 * along + width, along * height)]
    x, y = (np.concatenate(values) for values in zip(*sides, strict=True))
    points = corner + x[:, None] * across + y[:, None] * down
    cosine = points @ gaze / np.linalg.norm(points, axis=1)
    most = math.degrees(math.acos(float(np.clip(cosine.min(), -1, 1))))
    if most <= 90:
        return most
    # The direction opposite to the gaze may meet the picture itself.
    columns = np.stack([across, down, gaze], axis=1)
    if abs(np.linalg.det(columns)) > 1e-12 * np.linalg.norm(across) * np.linalg.norm(down):
        px, py, minus_t = np.linalg.solve(columns, -corner)
        if minus_t > 0 and 0 <= px <= width and 0 <= py <= height:
            return 180.0
    return min(180.0, most + 0.5)  # the edges were looked at in steps


def buffer_size(
    ppd: float, most_deg: float, width: int | None, height: int | None, pixels: float = math.inf
) -> tuple[int, int]:
    """(W, H) of the buffer of a display of ``ppd`` pixels per degree: HERR's 1024 x 1024 to 45 degrees stand for 60.

    Narrow fields, where that is more than the ``pixels`` it serves, get as many texels as pixels. ``width`` and
    ``height`` (even: the opposite row must exist) override. Raises InputError for an odd height.
    """
    if height is not None and height % 2:
        raise InputError(problem("polar: height", "odd height", height, "an even number: the gaze needs opposite rows"))
    scale = ppd / FULL_PPD
    wide = math.ceil(FULL_WIDTH * scale * samples_to(most_deg) / samples_to(PAPER_DEG))
    high = 2 * math.ceil(FULL_HALF_HEIGHT * scale)
    if wide * high > pixels:
        wide = math.floor(max(wide * math.sqrt(pixels / (wide * high)), math.sqrt(pixels) / 2))
        high = 2 * math.floor(pixels / max(wide, 1) / 2)
    return max(2, wide if width is None else width), max(4, high if height is None else height)


def width_in_use(width: int, speed_deg_s: float, slope_s_per_deg: float, least_share: float) -> int:
    """W * clamp(1 - slope * speed, least share, 1), at least 2 (HERR, 3.2: the width follows the pose change)."""
    return max(2, math.ceil(width * min(1.0, max(least_share, 1 - slope_s_per_deg * speed_deg_s))))
