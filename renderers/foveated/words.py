"""Colours and cache info of pixels and samples as 64-bit words: what a frame's taps gather with the fewest loads.

On two cores with AVX-512, four gathers around each of 1.73 million pixels take 5 ms by 64-bit words, 4 by 32-bit ones
and 12.5 by packets of four floats; two packets a pixel take 14 ms to scatter (7.8 where Dr.Jit is told that no two
lanes conflict), eight planes that a kernel returns 4. Hence planes of words, written as a kernel's own results.

A number of 16 or 21 bits has no sign, 6 bits of exponent (2^-32 to 2^31) and 10 or 15 of mantissa: a relative error of
1/2048 or 1/65536 down to 2^-32, and 0. Shifted into place it is a float 2^94 times too small: sums are scaled once.
"""

from __future__ import annotations

from typing import Any, Literal

from renderers.backend import dr, mi

Layout = Literal["shown", "light", "grey"]
"""``shown``: one colour of 21 bits a channel. ``light``: surface colour, albedo and light of 16 bits a channel;
``grey``: the same where light has no colour (ambient occlusion)."""
COLORS: dict[Layout, tuple[str, ...]] = {
    "shown": ("shown",), "light": ("surface", "albedo", "light"), "grey": ("surface", "albedo", "light"),
}  # fmt: skip
LEAST = 2.0**-32
SCALE = 2.0**94
"""What `gathered_small` has to be multiplied by."""
_OFFSET = 94 << 23


def encoded(value: Any, bits: int) -> Any:
    """The ``bits`` (16 or 21; UInt32) that stand for a Float below 2^31; 0 for what is below `LEAST`."""
    spare = 29 - bits
    own = dr.reinterpret_array(mi.UInt32, value) - (_OFFSET - (1 << (spare - 1)))
    return dr.select(value < LEAST, 0, own >> spare)


def decoded(code: Any, bits: int) -> Any:
    """The Float of a code."""
    return dr.reinterpret_array(mi.Float, code << (29 - bits)) * SCALE


def pair(low: Any, high: Any) -> Any:
    """Two UInt32 as one UInt64."""
    return mi.UInt64(low) | (mi.UInt64(high) << 32)


def halves(word: Any) -> tuple[Any, Any]:
    """The two UInt32 of a UInt64."""
    return mi.UInt32(word), mi.UInt32(word >> 32)


def float_pair(low: Any, high: Any) -> Any:
    """Two Floats, as they are, as one UInt64."""
    return pair(*(dr.reinterpret_array(mi.UInt32, mi.Float(value)) for value in (low, high)))


def floats(word: Any) -> tuple[Any, Any]:
    """The two Floats of a UInt64."""
    low, high = halves(word)
    return dr.reinterpret_array(mi.Float, low), dr.reinterpret_array(mi.Float, high)


def packed(layout: Layout, values: dict[str, Any]) -> tuple[Any, ...]:
    """The words of the layout's `COLORS` (Color3f each)."""
    if layout == "shown":
        r, g, b = (encoded(channel, 21) for channel in values["shown"])
        # bits 0 to 20, 21 to 41 and 43 to 63
        return (pair(r | (g << 21), (g >> 11) | (b << 11)),)
    light = [values["light"].x] if layout == "grey" else list(values["light"])
    codes = [encoded(channel, 16) for channel in (*values["surface"], *values["albedo"], *light)]
    codes += [mi.UInt32(0)] * (8 - len(codes))
    twos = [codes[k] | (codes[k + 1] << 16) for k in range(0, 8, 2)]
    return (pair(*twos[:2]), pair(*twos[2:]), *codes[8:])


def _small(layout: Layout, words: list[Any]) -> list[Any]:
    """The numbers of a layout's words, each a `SCALE`-th of what it stands for."""
    if layout == "shown":
        low, high = halves(words[0])
        fields, bits = [low << 8, (low >> 13) | (high << 19), high >> 3], 21
    else:
        both, bits = [two for word in words[:2] for two in halves(word)], 16
        fields = [field for two in both for field in (two << 13, two >> 3)]
        fields = fields[:7] if layout == "grey" else [*fields, words[2] << 13]
    mask = ((1 << bits) - 1) << (29 - bits)
    return [dr.reinterpret_array(mi.Float, field & mask) for field in fields]


def gathered_small(layout: Layout, planes: tuple[Any, ...], index: Any, active: Any = True) -> dict[str, Any]:
    """`COLORS` of a layout at ``index``, each a `SCALE`-th of what it is; 0 where not active."""
    values = _small(layout, [dr.gather(type(plane), plane, index, active) for plane in planes])
    values += values[6:] * 2 if layout == "grey" else []
    return {name: mi.Color3f(*values[3 * k : 3 * k + 3]) for k, name in enumerate(COLORS[layout])}


def gathered(layout: Layout, planes: tuple[Any, ...], index: Any, active: Any = True) -> dict[str, Any]:
    """`COLORS` of a layout at ``index``; 0 where not active."""
    return {name: value * SCALE for name, value in gathered_small(layout, planes, index, active).items()}
