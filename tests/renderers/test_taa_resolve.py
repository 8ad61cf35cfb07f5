"""Both temporal antialiasing forms against float64 loops that follow their published descriptions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from renderers.backend import activate, dr, mi
from renderers.frozen import frozen
from renderers.taa_resolve import HALTON_8, resolve
from tests.renderers.temporally_dense.oracle import FROM_YCOCG, TO_YCOCG, longest_of_3x3

activate()


def cubic(f: float) -> list[float]:
    """Keys' cubic with a = -1/2, from its piecewise definition."""

    def kernel(d: float) -> float:
        d = abs(d)
        if d < 1:
            return 1.5 * d**3 - 2.5 * d**2 + 1
        return -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2 if d < 2 else 0.0

    return [kernel(f + 1), kernel(f), kernel(1 - f), kernel(2 - f)]


def history_at(picture: np.ndarray, x: float, y: float) -> np.ndarray:
    height, width, _ = picture.shape
    gx, gy = x - 0.5, y - 0.5
    x0, y0 = math.floor(gx), math.floor(gy)
    total = np.zeros(3)
    for j, wy in enumerate(cubic(gy - y0)):
        for i, wx in enumerate(cubic(gx - x0)):
            total += wx * wy * picture[min(max(y0 + j - 1, 0), height - 1), min(max(x0 + i - 1, 0), width - 1)]
    return np.maximum(total, 0)


def oracle(form: str, current: np.ndarray, motion: np.ndarray, history: np.ndarray, alpha: float) -> np.ndarray:
    height, width, _ = current.shape
    out = np.zeros_like(current)
    for y in range(height):
        for x in range(width):
            m = longest_of_3x3(motion, x, y)
            px, py = x + 0.5 - m[0], y + 0.5 - m[1]
            if not (0 <= px <= width and 0 <= py <= height):
                out[y, x] = current[y, x]
                continue
            h = TO_YCOCG @ history_at(history, px, py)
            near = np.array(
                [
                    TO_YCOCG @ current[min(max(y + j, 0), height - 1), min(max(x + i, 0), width - 1)]
                    for j in (-1, 0, 1)
                    for i in (-1, 0, 1)
                ]
            )
            new = near[4]
            if form == "longest":
                low, high = near.mean(0) - near.std(0), near.mean(0) + near.std(0)
                d = min(abs(low[0] - h[0]), abs(high[0] - h[0]))
                weight = min(max(alpha * d / (d + high[0] - low[0] + 1e-7), 0), 1)
                value = np.clip(h, low, high) * (1 - weight) + new * weight
            else:
                plus = near[[1, 3, 4, 5, 7]]
                low, high = (near.min(0) + plus.min(0)) / 2, (near.max(0) + plus.max(0)) / 2
                centre, extent = (low + high) / 2, (high - low) / 2 + 1e-7
                ratio = np.max(np.abs((h - centre) / extent))
                h = centre + (h - centre) / ratio if ratio > 1 else h
                w_new, w_old = alpha / (1 + new[0]), (1 - alpha) / (1 + h[0])
                value = (new * w_new + h * w_old) / (w_new + w_old)
            out[y, x] = np.maximum(FROM_YCOCG @ value, 0)
    return out


def device(values: np.ndarray) -> mi.Float:
    buffer = mi.Float(values.astype(np.float32).ravel()) + dr.opaque(mi.Float, 0)
    dr.eval(buffer)
    return buffer


def padded(picture: np.ndarray) -> mi.Float:
    return device(np.concatenate([picture, np.zeros((*picture.shape[:2], 1))], axis=2))


@pytest.mark.parametrize("form", ["longest", "karis"])
@pytest.mark.parametrize("size", [(13, 9), (1, 1), (2, 5)])
def test_the_resolve_is_the_oracles(form: str, size: tuple[int, int]) -> None:
    width, height = size
    rng = np.random.default_rng(width)
    current, history = rng.random((height, width, 3)), rng.random((height, width, 3))
    motion = rng.normal(0, 1.5, (height, width, 2))
    kernel = frozen(resolve)
    alpha = dr.opaque(mi.Float, 0.1)
    got = kernel(width * height, form, width, height, 1.0, padded(current), device(motion), padded(history), alpha)
    picture = np.array(got).reshape(height, width, 4)[..., :3]
    np.testing.assert_allclose(picture, oracle(form, current, motion, history, 0.1), atol=3e-5)


@pytest.mark.parametrize("form", ["longest", "karis"])
def test_a_flat_still_picture_stays(form: str) -> None:
    flat = np.full((6, 6, 3), 0.4)
    got = frozen(resolve)(
        36, form, 6, 6, 1.0, padded(flat), device(np.zeros((6, 6, 2))), padded(flat), dr.opaque(mi.Float, 0.1)
    )
    np.testing.assert_allclose(np.array(got).reshape(6, 6, 4)[..., :3], flat, atol=1e-6)


def test_the_jitter_is_the_halton_sequence() -> None:
    def radical_inverse(base: int, index: int) -> float:
        result, factor = 0.0, 1.0 / base
        while index:
            index, digit = divmod(index, base)
            result += digit * factor
            factor /= base
        return result

    wanted = [(radical_inverse(2, i), radical_inverse(3, i)) for i in range(1, 9)]
    np.testing.assert_allclose(HALTON_8, wanted, atol=1e-15)
