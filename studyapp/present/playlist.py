"""Which source frame belongs to which refresh. The content clock is the refresh index, never wall time."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction

import numpy as np

from stimuli.errors import InputError, problem


def check_rate(where: str, rate_hz: Fraction, refresh_hz: Fraction, modes_hz: Iterable[Fraction] = ()) -> int:
    """Refreshes a source frame stays on the screen: ``refresh / rate``, a whole number.

    Raises InputError where ``rate_hz`` is no integer divisor of the refresh, naming the display modes that would serve.
    """
    if rate_hz > 0:
        held = refresh_hz / rate_hz
        if held.denominator == 1:
            return int(held)
    serving = sorted({mode for mode in modes_hz if rate_hz > 0 and (mode / rate_hz).denominator == 1})
    if serving:
        wanted = "a display mode of " + ", ".join(f"{float(mode):g}" for mode in serving) + " Hz"
    else:
        divisors = ", ".join(f"{float(refresh_hz / n):g}" for n in range(1, 9))
        wanted = f"an integer divisor of {float(refresh_hz):g} Hz ({divisors}, ...)"
    raise InputError(problem(where, "rate does not divide the refresh", f"{float(rate_hz):g} Hz", wanted))


def refresh_count(duration_s: float | Fraction, refresh_hz: Fraction) -> int:
    """round(duration * refresh): how many refreshes a stimulus lasts."""
    return round(Fraction(duration_s) * refresh_hz)


def source_frames(
    refresh_indices: np.ndarray, rate_hz: Fraction, refresh_hz: Fraction, frame_count: int, looped: bool = False
) -> np.ndarray:
    """Source frame floor(k * rate / refresh) of each refresh k since onset (int64), in exact integer arithmetic.

    Past the clip's end the last frame stays, or with ``looped`` it begins anew. Shape as ``refresh_indices``, int32.
    """
    ratio = rate_hz / refresh_hz
    frames = np.asarray(refresh_indices, np.int64) * ratio.numerator // ratio.denominator
    frames = frames % frame_count if looped else np.minimum(frames, frame_count - 1)
    return frames.astype(np.int32)
