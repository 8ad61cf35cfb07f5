"""The cache of a pixel where light is sampled: three colours and what is known of them, in half a cache line.

Eight UInt32 a pixel: nine values of 16 bits (surface colour, albedo, light), then rho, age and rho of the light as they
are. As three pictures of 16 bytes and two of cache info a frame's `compose` took 1.1 times as long. A value of 16 bits
has no sign, 6 bits of exponent (2^-32 to 2^31) and 10 of mantissa: a relative error of 1/2048, and never below 2^-32.
"""

from __future__ import annotations

from typing import Any

from renderers.backend import dr, mi

WORDS = 8
RHO, AGE, RHO_LIGHT = 5, 6, 7
"""Words of a pixel that hold floats."""
COLORS = ("surface", "albedo", "light")
LEAST = 2.0**-32
_LEAST = (127 - 32) << 23
_ROUND = 1 << 12


def encoded(value: Any) -> Any:
    """16 bits (UInt32) for a Float below 2^31; what is below `LEAST` becomes that."""
    bits = dr.reinterpret_array(mi.UInt32, value)
    return (dr.maximum(bits, _LEAST) - (_LEAST - _ROUND)) >> 13


def decoded(bits: Any) -> Any:
    """The Float of 16 bits; `LEAST` for 0."""
    return dr.reinterpret_array(mi.Float, (bits << 13) + _LEAST)


def write(cache: Any, pixel: Any, values: dict[str, Any]) -> None:
    """Store `COLORS` (Color3f) and rho, age, rho_light (Float) of ``pixel``."""
    halves = [encoded(values[name][k]) for name in COLORS for k in range(3)]
    words = [halves[2 * k] | (halves[2 * k + 1] << 16) for k in range(4)]
    info = [dr.reinterpret_array(mi.UInt32, mi.Float(values[name])) for name in ("rho", "age", "rho_light")]
    dr.scatter(cache, mi.Vector4u(*words), pixel * 2)
    dr.scatter(cache, mi.Vector4u(halves[8], *info), pixel * 2 + 1)


def colors(cache: Any, pixel: Any, active: Any = True) -> dict[str, Any]:
    """`COLORS` (Color3f) of ``pixel``; 0 where not active."""
    words = dr.gather(mi.Vector4u, cache, pixel * 2, active)
    last = dr.gather(mi.UInt32, cache, pixel * WORDS + 4, active)
    halves = [half for word in words for half in (word & 0xFFFF, word >> 16)]
    values = [decoded(bits) for bits in (*halves, last)]
    return {name: mi.Color3f(*values[3 * k : 3 * k + 3]) for k, name in enumerate(COLORS)}


def info(cache: Any, pixel: Any, active: Any = True) -> dict[str, Any]:
    """rho, age and rho_light (Float) of ``pixel``; 0 where not active."""
    words = dr.gather(mi.Vector4u, cache, pixel * 2 + 1, active)
    values = [dr.reinterpret_array(mi.Float, word) for word in (words.y, words.z, words.w)]
    return dict(zip(("rho", "age", "rho_light"), values, strict=True))
