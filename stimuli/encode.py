"""The only encoder: linear light to display codes, stored or live.

``code = round(255 * sRGB(clip(exposure * linear, 0, 1)))``, or through a display's measured table. Linear values are
first rounded to half floats, as clips store them; so a live frame and the stored one have the same codes, and one
table over all 65,536 halves is exact. nan and negative are 0, +inf is the largest half (65504).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stimuli.errors import InputError, problem

TONES = ("none",)


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """sRGB transfer (IEC 61966-2-1) of values in [0, 1], float64."""
    linear = np.asarray(linear, np.float64)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def linear_from_srgb(code: np.ndarray) -> np.ndarray:
    """The inverse of `srgb_from_linear`, for values in [0, 1], float64."""
    code = np.asarray(code, np.float64)
    return np.where(code <= 0.04045, code / 12.92, ((np.maximum(code, 0.04045) + 0.055) / 1.055) ** 2.4)


def linear_from_pq(code: np.ndarray, white_cd_m2: float = 100.0) -> np.ndarray:
    """Linear light with ``white_cd_m2`` as 1 from perceptual-quantiser values in [0, 1] (SMPTE ST 2084 EOTF)."""
    m1, m2 = 2610 / 16384, 2523 / 4096 * 128
    c1, c2, c3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
    root = np.clip(np.asarray(code, np.float64), 0.0, 1.0) ** (1 / m2)
    return 10000.0 / white_cd_m2 * (np.maximum(root - c1, 0.0) / (c2 - c3 * root)) ** (1 / m1)


@dataclass(frozen=True)
class DisplayTable:
    """A measured display: ``luminance_cd_m2[i]`` is shown for code i (256 rising values).

    A linear value v in [0, 1] asks for v times the peak; the code is that whose (linearly interpolated) luminance it
    is, rounded; what is darker than the black level gets code 0.
    """

    luminance_cd_m2: tuple[float, ...]

    def __post_init__(self) -> None:
        levels = np.asarray(self.luminance_cd_m2, np.float64)
        if levels.shape != (256,):
            raise InputError(problem("display table", "levels", len(self.luminance_cd_m2), "256, one a code"))
        if not (np.isfinite(levels).all() and levels[0] >= 0 and (np.diff(levels) > 0).all()):
            raise InputError(problem("display table", "luminances", "values that do not rise", "finite, rising, >= 0"))

    def codes(self, linear: np.ndarray) -> np.ndarray:
        """Unrounded codes in [0, 255] for linear values in [0, 1]."""
        levels = np.asarray(self.luminance_cd_m2, np.float64)
        return np.interp(np.asarray(linear, np.float64) * levels[-1], levels, np.arange(256.0))


def table_from_samples(codes: Sequence[float], luminance_cd_m2: Sequence[float]) -> DisplayTable:
    """A `DisplayTable` from at least two measured (code, luminance) pairs, code 0 and 255 among them."""
    order = np.argsort(np.asarray(codes, np.float64))
    at, level = np.asarray(codes, np.float64)[order], np.asarray(luminance_cd_m2, np.float64)[order]
    if len(at) < 2 or len(at) != len(level) or at[0] != 0 or at[-1] != 255:
        raise InputError(problem("display table", "measured codes", list(at), "at least 0 and 255, one luminance each"))
    return DisplayTable(tuple(float(value) for value in np.interp(np.arange(256.0), at, level)))


def _check(exposure: float, tone: str) -> None:
    if tone not in TONES:
        raise InputError(problem("encoder", "tone", repr(tone), " | ".join(TONES)))
    if not (np.isfinite(exposure) and exposure > 0):
        raise InputError(problem("encoder", "exposure", exposure, "a finite number above 0"))


def display_linear(linear: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """clip(exposure * linear, 0, 1) in float64, nan as 0: the light that the display is asked for."""
    with np.errstate(over="ignore", invalid="ignore"):
        exposed = np.asarray(linear, np.float64) * float(exposure)
    return np.clip(np.nan_to_num(exposed, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)


def display_values(linear: np.ndarray, exposure: float = 1.0, tone: str = "none") -> np.ndarray:
    """sRGB values in [0, 1] before rounding, float64: what error metrics compare. Not rounded to half."""
    _check(exposure, tone)
    return srgb_from_linear(display_linear(linear, exposure))


@lru_cache(maxsize=64)
def code_table(exposure: float = 1.0, tone: str = "none", table: DisplayTable | None = None) -> np.ndarray:
    """(65536,) uint8, read-only: the display code of every half float, by its bit pattern."""
    _check(exposure, tone)
    with np.errstate(invalid="ignore"):  # signalling nans among the bit patterns
        halves = np.arange(65536, dtype=np.uint16).view(np.float16).astype(np.float64)
    light = display_linear(np.minimum(halves, 65504.0), exposure)
    unrounded = 255.0 * srgb_from_linear(light) if table is None else table.codes(light)
    codes = np.rint(unrounded).astype(np.uint8)
    codes.flags.writeable = False
    return codes


def encode(
    linear: np.ndarray,
    exposure: float = 1.0,
    tone: str = "none",
    table: DisplayTable | None = None,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """(H, W, 3) linear float16 or float32 -> (H, W, 4) uint8 RGBA codes, alpha 255; into ``out`` where given.

    Other float types are first made float32. InputError for an unknown tone, a useless exposure or a wrong shape.
    """
    if linear.ndim != 3 or linear.shape[2] != 3:
        raise InputError(problem("encoder", "picture shape", linear.shape, "(height, width, 3)"))
    codes = code_table(float(exposure), tone, table)
    if out is None:
        out = np.empty((*linear.shape[:2], 4), np.uint8)
    if out.shape != (*linear.shape[:2], 4) or out.dtype != np.uint8 or not out.flags.c_contiguous:
        got = f"{out.shape} {out.dtype}{'' if out.flags.c_contiguous else ', strided'}"
        raise InputError(problem("encoder", "output array", got, f"C-contiguous {(*linear.shape[:2], 4)} uint8"))
    from stimuli import encode_compiled  # the compiler is loaded by who encodes, not by who plays what is encoded

    flat = out.reshape(-1, 4)
    if linear.dtype == np.float16:
        encode_compiled.encode_half(np.ascontiguousarray(linear).view(np.uint16).reshape(-1, 3), codes, flat)
    else:
        values = np.ascontiguousarray(linear, np.float32).reshape(-1, 3)
        encode_compiled.encode_float(values, values.view(np.uint32), codes, flat)
    return out
