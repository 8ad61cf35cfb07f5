"""Colours and cache info of pixels and samples as 64-bit words: what a frame's taps gather with the fewest loads.

On two cores with AVX-512, four gathers around each of 1.73 million pixels take 5 ms by 64-bit words, 4 by 32-bit ones
and 12.5 by packets of four floats; two packets a pixel take 14 ms to scatter (7.8 where Dr.Jit is told that no two
lanes conflict), eight planes that a kernel returns 4. Hence planes of words, written as a kernel's own results.

A number of 16 or 21 bits has no sign, 6 bits of exponent (2^-32 to 2^31) and 10 or 15 of mantissa: a relative error of
1/2048 or 1/65536 down to 2^-32, and 0.
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
_LEAST = (127 - 32) << 23


def encoded(value: Any, bits: int) -> Any:
    """The ``bits`` (16 or 21; UInt32) that stand for a Float below 2^31; what is at most `LEAST` becomes 0."""
    spare = 29 - bits
    own = dr.maximum(dr.reinterpret_array(mi.UInt32, value), _LEAST)
    return (own - (_LEAST - (1 << (spare - 1)))) >> spare


def decoded(code: Any, bits: int) -> Any:
    """The Float of a code; 0 for 0: black stays black."""
    return dr.select(code == 0, 0, dr.reinterpret_array(mi.Float, (code << (29 - bits)) + _LEAST))


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
        # green's bits: eleven in the lower half, ten in the upper one
        return (pair(r | (g << 21), (g >> 11) | (b << 10)),)
    light = [values["light"].x] if layout == "grey" else list(values["light"])
    codes = [encoded(channel, 16) for channel in (*values["surface"], *values["albedo"], *light)]
    codes += [mi.UInt32(0)] * (8 - len(codes))
    twos = [codes[k] | (codes[k + 1] << 16) for k in range(0, 8, 2)]
    return (pair(*twos[:2]), pair(*twos[2:]), *codes[8:])


def unpacked(layout: Layout, words: list[Any]) -> dict[str, Any]:
    """`COLORS` of a layout (Color3f) from their words."""
    if layout == "shown":
        low, high = halves(words[0])
        mask = (1 << 21) - 1
        codes = (low & mask, (low >> 21) | ((high << 11) & mask), high >> 10)
        return {"shown": mi.Color3f(*(decoded(code, 21) for code in codes))}
    both = [two for word in words[:2] for two in halves(word)]
    fields = [code for two in both for code in (two & 0xFFFF, two >> 16)]
    values = [decoded(code, 16) for code in (fields[:7] if layout == "grey" else (*fields, *words[2:]))]
    values += values[6:] * 2 if layout == "grey" else []
    return {name: mi.Color3f(*values[3 * k : 3 * k + 3]) for k, name in enumerate(COLORS[layout])}


def gathered(layout: Layout, planes: tuple[Any, ...], index: Any, active: Any = True) -> dict[str, Any]:
    """`COLORS` of a layout at ``index``; 0 where not active."""
    return unpacked(layout, [dr.gather(type(plane), plane, index, active) for plane in planes])
