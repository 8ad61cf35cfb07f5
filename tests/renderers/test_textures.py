"""The mip atlas against a float64 trilinear look-up."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.backend import activate, mi
from renderers.frozen import opaque_float
from renderers.textures import (
    CLAMP,
    MIRROR,
    REPEAT,
    TextureSource,
    build_atlas,
    decode_srgb,
    encode_srgb,
    look_up,
    mip_chain,
)


def pictures() -> list[TextureSource]:
    rng = np.random.default_rng(3)
    make = lambda h, w: rng.integers(0, 256, (h, w, 4), dtype=np.uint8)  # noqa: E731
    return [
        TextureSource(make(16, 32), True),
        TextureSource(make(7, 5), False, CLAMP, MIRROR),
        TextureSource(make(1, 1), True, MIRROR, CLAMP),
        TextureSource(make(8, 8), False, REPEAT, REPEAT, nearest=True),
    ]


def fold(c: float, mode: int) -> float:
    if mode == CLAMP:
        return min(max(c, 0.0), 1.0)
    whole = np.floor(c)
    return 1 - (c - whole) if mode == MIRROR and int(whole) % 2 else c - whole


def texel(i: int, n: int, mode: int) -> int:
    return i % n if mode == REPEAT else min(max(i, 0), n - 1)


def level_value(source: TextureSource, image: np.ndarray, u: float, v: float) -> np.ndarray:
    h, w = image.shape[:2]
    linear = image / 255.0
    if source.srgb:
        linear[..., :3] = decode_srgb(linear[..., :3])
    x, y = fold(u, source.wrap_u) * w - 0.5, fold(v, source.wrap_v) * h - 0.5
    if source.nearest:
        x, y = np.floor(x + 0.5), np.floor(y + 0.5)
    i, j = int(np.floor(x)), int(np.floor(y))
    total = np.zeros(4)
    for dj, wy in ((0, 1 - (y - j)), (1, y - j)):
        for di, wx in ((0, 1 - (x - i)), (1, x - i)):
            total += wx * wy * linear[texel(j + dj, h, source.wrap_v), texel(i + di, w, source.wrap_u)]
    return total


def test_look_ups_equal_a_float64_reference_for_all_wraps_and_sizes() -> None:
    activate()
    sources = pictures()
    rng = np.random.default_rng(0)
    count = 400
    number = rng.integers(0, len(sources), count)
    u, v = rng.uniform(-2.3, 2.3, (2, count))
    footprint = np.exp2(rng.uniform(-9, 1, count))
    expected = np.empty((count, 4))
    for k in range(count):
        source = sources[number[k]]
        chain = mip_chain(source)
        size = np.sqrt(source.image.shape[0] * source.image.shape[1])
        level = np.clip(np.log2(footprint[k] * size), 0, len(chain) - 1)
        if source.nearest and level < 0.5:
            level = 0.0
        low = min(int(level), max(len(chain) - 2, 0))
        fine = level_value(source, chain[low], u[k], v[k])
        coarse = level_value(source, chain[min(low + 1, len(chain) - 1)], u[k], v[k])
        expected[k] = fine + (coarse - fine) * (level - low)
    got = look_up(
        build_atlas(sources), mi.UInt32(number.astype(np.uint32)), mi.Point2f(opaque_float(u), opaque_float(v)),
        opaque_float(footprint), mi.Bool(np.ones(count, bool)),
    ).numpy().T  # fmt: skip
    close = np.isclose(got, expected, atol=3e-4).all(axis=1)
    assert close.mean() > 0.995  # a coordinate within rounding of a nearest texel's edge may fall on either side


def test_decoding_is_exact_to_2e_5_at_all_codes() -> None:
    activate()
    ramp = np.zeros((1, 256, 4), np.uint8)
    ramp[0, :, 0] = np.arange(256)
    uv = mi.Point2f(opaque_float((np.arange(256) + 0.5) / 256), mi.Float(0.5))
    got = look_up(build_atlas([TextureSource(ramp, True)]), mi.UInt32(0), uv, mi.Float(0), mi.Bool(True)).numpy()[0]
    np.testing.assert_allclose(got, decode_srgb(np.arange(256) / 255), atol=2.5e-5)
    np.testing.assert_allclose(encode_srgb(decode_srgb(np.arange(256) / 255)), np.arange(256) / 255, atol=1e-6)


@pytest.mark.parametrize("shape", [(8, 8), (7, 5), (1, 9), (13, 1)])
def test_mips_keep_the_mean_of_linear_light(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(1).integers(0, 256, (*shape, 4), dtype=np.uint8)
    chain = mip_chain(TextureSource(image, True))
    assert chain[-1].shape == (1, 1, 4)
    mean = decode_srgb(image[..., :3] / 255).mean(axis=(0, 1))
    np.testing.assert_allclose(decode_srgb(chain[-1][0, 0, :3] / 255), mean, atol=0.01)
