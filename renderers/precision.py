"""What the precision of storing costs: half-float clips and the 8-bit play cache against the float picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stimuli.encode import display_values, encode


@dataclass(frozen=True)
class PrecisionError:
    """What storing adds, in display values: RMS and largest difference from the float picture (before any rounding),
    and how much the RMSE against the gold standard grows."""

    rmse_added: float
    most_added: float
    rmse_growth: float


def precision_errors(colors: Sequence[np.ndarray], gold: np.ndarray, exposure: float) -> dict[str, PrecisionError]:
    """The errors of ``half`` (stored clips: OpenEXR half floats) and ``codes8`` (the play cache: RGBA8 codes, made from
    those halves) against single precision.

    Args:
        colors: linear pictures (H, W, 3), float32.
        gold: their gold standard in display values, (n, H, W, 3).
    """
    # What storing may hold is few: 65,536 halves and 256 codes; their display values are looked up.
    with np.errstate(invalid="ignore"):  # signalling nans among the bit patterns
        halves = np.arange(65536, dtype=np.uint16).view(np.float16).astype(np.float64)
    of_half, of_code = display_values(halves, exposure), np.arange(256) / 255.0
    squares = {kind: np.zeros(2) for kind in ("half", "codes8")}
    most = dict.fromkeys(squares, 0.0)
    plain = 0.0
    for color, wanted in zip(colors, gold, strict=True):
        exact = display_values(color, exposure)
        plain += float(np.mean((exact - wanted) ** 2))
        stored = {
            "half": of_half[color.astype(np.float16).view(np.uint16)],
            "codes8": of_code[encode(color, exposure)[..., :3]],
        }
        for kind, values in stored.items():
            added = values - exact
            squares[kind] += [np.mean(added * added), np.mean((values - wanted) ** 2)]
            most[kind] = max(most[kind], float(np.abs(added).max()))
    count = max(1, len(colors))
    root = math.sqrt(plain / count)
    return {
        kind: PrecisionError(math.sqrt(added / count), most[kind], math.sqrt(against / count) - root)
        for kind, (added, against) in squares.items()
    }
