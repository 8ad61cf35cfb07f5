"""All textures of a scene with their mip-maps in one flat RGBA8 array, and trilinear look-ups into it.

Dr.Jit's own textures have no mip-maps; one array with a table of levels lets a kernel look up whatever texture each
lane's material names. Levels are box-filtered in linear light and stored with the encoding of the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.frozen import opaque_uint

REPEAT, CLAMP, MIRROR = 10497, 33071, 33648  # OpenGL's numbers, as glTF writes them
_CLAMP_U, _CLAMP_V, _MIRROR_U, _MIRROR_V, _IS_NEAREST, _IS_SRGB = (1 << k for k in range(6))
# ((x + 0.055) / 1.055) ** 2.4 on [0.04045, 1] as a polynomial; largest error 1.8e-5 (tested at all 256 codes)
_DECODE = (
    0.0009452595063925706,
    0.03244320945231714,
    0.5164861754272161,
    0.7008476456125746,
    -0.4090554939214983,
    0.20728500975583236,
    -0.04896065955873247,
)


@dataclass
class TextureArrays:
    """A PyTree. ``texels``: RGBA8 packed into uint32; ``levels``: (L, 4) offset, width, height, 0; ``table``: (T, 4)
    first level, number of levels, flags, 0."""

    texels: Any
    levels: Any
    table: Any


@dataclass(frozen=True)
class TextureSource:
    """One image as a material uses it: (H, W, 4) uint8, whether colours are sRGB-encoded, wrap modes, nearest texel."""

    image: np.ndarray
    srgb: bool
    wrap_u: int = REPEAT
    wrap_v: int = REPEAT
    nearest: bool = False


def rgba8(image: np.ndarray) -> np.ndarray:
    """(H, W, 4) uint8 of a grey, grey-alpha, RGB or RGBA image (uint8, or floats in [0, 1])."""
    image = np.asarray(image)
    if image.dtype.kind == "f":
        image = np.rint(np.clip(image, 0, 1) * 255)
    image = image[..., None] if image.ndim == 2 else image
    channels = image.shape[2]
    out = np.full((*image.shape[:2], 4), 255, np.uint8)
    if channels <= 2:
        out[..., :3] = image[..., :1]
        if channels == 2:
            out[..., 3] = image[..., 1]
    else:
        out[..., :channels] = image
    return out


def source_of(texture: Any, srgb: bool) -> TextureSource:
    """The `TextureSource` of a pyrender texture."""
    sampler = texture.sampler
    wrap_u = int(getattr(sampler, "wrapS", None) or REPEAT)
    wrap_v = int(getattr(sampler, "wrapT", None) or REPEAT)
    return TextureSource(rgba8(texture.source), srgb, wrap_u, wrap_v, getattr(sampler, "magFilter", None) == 9728)


def decode_srgb(code: np.ndarray) -> np.ndarray:
    """sRGB in [0, 1] to linear, float64 (IEC 61966-2-1)."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear in [0, 1] to sRGB, float64."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)


def _halve(image: np.ndarray, axis: int) -> np.ndarray:
    """Box filter to half the size (rounded down, at least 1) along ``axis``; odd sizes by exact overlap."""
    size = image.shape[axis]
    if size == 1:
        return image
    moved = np.moveaxis(image, axis, 0)
    if size % 2 == 0:
        return np.moveaxis((moved[0::2] + moved[1::2]) / 2, 0, axis)
    half = size // 2
    edges = np.arange(half + 1) * size / half
    weights = np.clip(
        np.minimum(edges[1:, None], np.arange(1, size + 1)) - np.maximum(edges[:-1, None], np.arange(size)), 0, 1
    )
    return np.moveaxis(np.tensordot(weights * half / size, moved, axes=1), 0, axis)


def mip_chain(source: TextureSource) -> list[np.ndarray]:
    """(H, W, 4) uint8 levels from the image down to 1x1, averaged in linear light."""
    levels = [source.image]
    linear = source.image.astype(np.float32) / 255
    if source.srgb:
        linear[..., :3] = decode_srgb(np.arange(256) / 255).astype(np.float32)[source.image[..., :3]]
    while max(linear.shape[:2]) > 1:
        linear = _halve(_halve(linear, 0), 1).astype(np.float32)
        coded = linear.copy()
        if source.srgb:
            coded[..., :3] = encode_srgb(linear[..., :3])
        levels.append(np.rint(coded * 255).astype(np.uint8))
    return levels


def build_atlas(sources: list[TextureSource]) -> TextureArrays:
    """The device's arrays for ``sources``; a texture's number is its place in the list."""
    texels: list[np.ndarray] = []
    levels: list[tuple[int, int, int, int]] = []
    table: list[tuple[int, int, int, int]] = []
    offset = 0
    for source in sources:
        chain = mip_chain(source)
        flags = (source.wrap_u == CLAMP) * _CLAMP_U + (source.wrap_v == CLAMP) * _CLAMP_V
        flags += (source.wrap_u == MIRROR) * _MIRROR_U + (source.wrap_v == MIRROR) * _MIRROR_V
        flags += source.nearest * _IS_NEAREST + source.srgb * _IS_SRGB
        table.append((len(levels), len(chain), flags, 0))
        for image in chain:
            levels.append((offset, image.shape[1], image.shape[0], 0))
            texels.append(np.ascontiguousarray(image).view(np.uint32).ravel())
            offset += image.shape[0] * image.shape[1]
    return TextureArrays(
        texels=opaque_uint(np.concatenate(texels) if texels else [0]),
        levels=opaque_uint(levels or [(0, 1, 1, 0)]),
        table=opaque_uint(table or [(0, 1, 0, 0)]),
    )


def _decode(c: Any) -> Any:
    """sRGB to linear in a kernel."""
    value = mi.Float(_DECODE[-1])
    for coefficient in _DECODE[-2::-1]:
        value = dr.fma(value, c, coefficient)
    return dr.select(c <= 0.04045, c * (1 / 12.92), value)


def _wrapped(coordinate: Any, mirrored: Any, clamped: Any) -> Any:
    """A texture coordinate folded into [0, 1]."""
    fraction = coordinate - dr.floor(coordinate)
    odd = (mi.Int32(dr.floor(coordinate)) & 1) == 1
    folded = dr.select(mirrored & odd, 1 - fraction, fraction)
    return dr.select(clamped, dr.clip(coordinate, 0, 1), folded)


def _neighbours(coordinate: Any, size: Any, nearest: Any, repeats: Any) -> tuple[Any, Any, Any]:
    """The two texels around a folded coordinate and the second one's share."""
    place = coordinate * mi.Float(size) - 0.5
    place = dr.select(nearest, dr.floor(place + 0.5), place)
    low = dr.floor(place)
    share = place - low
    first, last = mi.Int32(low), mi.Int32(size) - 1
    second = first + 1
    first = dr.select(first < 0, dr.select(repeats, last, 0), dr.minimum(first, last))
    second = dr.select(second > last, dr.select(repeats, 0, last), second)
    return mi.UInt32(first), mi.UInt32(second), share


def _bilinear(arrays: TextureArrays, level: Any, u: Any, v: Any, flags: Any, active: Any) -> Any:
    """Four decoded texels of one level, blended."""
    nearest = (flags & _IS_NEAREST) != 0
    entry = dr.gather(mi.Vector4u, arrays.levels, level, active)
    x0, x1, fx = _neighbours(u, entry.y, nearest, (flags & (_CLAMP_U | _MIRROR_U)) == 0)
    y0, y1, fy = _neighbours(v, entry.z, nearest, (flags & (_CLAMP_V | _MIRROR_V)) == 0)

    def texel(x: Any, y: Any) -> Any:
        packed = dr.gather(mi.UInt32, arrays.texels, entry.x + y * entry.y + x, active)
        channels = [mi.Float((packed >> shift) & 255) * (1 / 255) for shift in (0, 8, 16, 24)]
        srgb = (flags & _IS_SRGB) != 0
        return mi.Vector4f(*(dr.select(srgb, _decode(c), c) for c in channels[:3]), channels[3])

    return dr.lerp(dr.lerp(texel(x0, y0), texel(x1, y0), fx), dr.lerp(texel(x0, y1), texel(x1, y1), fx), fy)


def look_up(arrays: TextureArrays, texture: Any, uv: Any, footprint: Any, active: Any) -> Any:
    """Linear RGBA (Vector4f) of ``texture`` (UInt32) at ``uv``, filtered over ``footprint``.

    ``footprint``: width of the ray's cone on the surface in texture coordinates. The level is log2 of that width in
    texels (ray cones: Akenine-Moeller et al., Ray Tracing Gems ch. 20, with the geometric mean of the two sizes).
    """
    entry = dr.gather(mi.Vector4u, arrays.table, texture, active)
    base = dr.gather(mi.Vector4u, arrays.levels, entry.x, active)
    flags = entry.z
    texels = footprint * dr.sqrt(mi.Float(base.y) * mi.Float(base.z))
    last = mi.Float(entry.y) - 1
    level = dr.clip(dr.log2(dr.maximum(texels, 1e-8)), 0, last)
    level = dr.select((flags & _IS_NEAREST) != 0, dr.select(level < 0.5, 0, level), level)
    low = dr.minimum(dr.floor(level), dr.maximum(last - 1, 0))
    u = _wrapped(uv.x, (flags & _MIRROR_U) != 0, (flags & _CLAMP_U) != 0)
    v = _wrapped(uv.y, (flags & _MIRROR_V) != 0, (flags & _CLAMP_V) != 0)
    first = entry.x + mi.UInt32(low)
    fine = _bilinear(arrays, first, u, v, flags, active)
    coarse = _bilinear(arrays, dr.minimum(first + 1, entry.x + entry.y - 1), u, v, flags, active)
    return dr.lerp(fine, coarse, level - low)
