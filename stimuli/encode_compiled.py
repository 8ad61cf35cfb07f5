"""The two loops of `stimuli.encode`, compiled: linear light as float32 or half -> display codes by table."""

from __future__ import annotations

import numba
import numpy as np

_SMALLEST_NORMAL_HALF = np.float32(2.0**-14)


@numba.njit(cache=True, nogil=True)
def encode_float(linear, bits, codes, out):  # pragma: no cover  (compiled)
    """(N, 3) float32 and their bits -> (N, 4) codes: round to half by integer arithmetic, look up."""
    for i in range(linear.shape[0]):
        for c in range(3):
            value = linear[i, c]
            u = bits[i, c]
            if value >= _SMALLEST_NORMAL_HALF and value < np.float32(65504.0):
                # normal halves: drop 13 bits of mantissa to nearest even, rebias the exponent
                index = ((u + np.uint32(0xFFF) + ((u >> np.uint32(13)) & np.uint32(1))) >> np.uint32(13)) - np.uint32(
                    112 << 10
                )
            elif value >= np.float32(65504.0):
                index = np.uint32(0x7BFF)  # the largest half, as stored clips hold it
            elif value > np.float32(0.0):
                index = np.uint32(np.rint(value * np.float32(16777216.0)))  # subnormal halves: multiples of 2^-24
            else:
                index = np.uint32(0)  # zero, negative, nan
            out[i, c] = codes[index]
        out[i, 3] = np.uint8(255)


@numba.njit(cache=True, nogil=True)
def encode_half(bits, codes, out):  # pragma: no cover  (compiled)
    """(N, 3) half bit patterns -> (N, 4) codes."""
    for i in range(bits.shape[0]):
        for c in range(3):
            out[i, c] = codes[bits[i, c]]
        out[i, 3] = np.uint8(255)
