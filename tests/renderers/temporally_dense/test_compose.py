"""Final frame generation against plain float64 loops; static windows against their definition."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.backend import activate, dr, mi
from renderers.frozen import frozen
from renderers.temporally_dense.compose import Settings, compose
from tests.renderers.temporally_dense import oracle

activate()


def settings(width: int, height: int, neighbourhood: str = "recent_immediate", reproject: bool = True) -> Settings:
    return Settings(width, height, neighbourhood, reproject, 1.0, 0.0)


def device(values: np.ndarray) -> mi.Float:
    """A buffer of Dr.Jit's own (numpy's memory, aligned or not, would make for other recordings)."""
    buffer = mi.Float(values.astype(np.float32).ravel()) + dr.opaque(mi.Float, 0)
    dr.eval(buffer)
    return buffer


def picture_buffer(picture: np.ndarray) -> mi.Float:
    return device(np.concatenate([picture, np.zeros((*picture.shape[:2], 1))], axis=2))


def run(kernel, s, moving, history, previous, samples, motion, orders, state, subframe, slot, frame):
    texels = np.concatenate([samples, orders[..., None].astype(float)], axis=2)
    window, last_dynamic = state
    opaque = [mi.UInt32(v) for v in (subframe, slot, frame)]
    dr.make_opaque(opaque)
    out = kernel(
        s.tiles_x * s.tiles_y, s, moving, history, picture_buffer(previous), device(texels),
        device(motion), window, last_dynamic, *opaque,
    )  # fmt: skip
    dr.eval(out)
    return np.array(out[0]).reshape(s.height, s.width, 4)[..., :3], (out[1], out[2])


def empty_state(s: Settings):
    state = (dr.zeros(mi.Float, s.width * s.height * 16), dr.zeros(mi.UInt32, s.tiles_x * s.tiles_y))
    dr.make_opaque(state)
    return state


@pytest.mark.parametrize("size", [(16, 12), (15, 11), (2, 2), (1, 1), (3, 1)])
@pytest.mark.parametrize("subframe", [0, 1, 2, 3])
def test_a_dynamic_frame_is_the_oracles(size: tuple[int, int], subframe: int) -> None:
    width, height = size
    s = settings(width, height)
    rng = np.random.default_rng(width * 10 + subframe)
    previous = rng.random((height, width, 3))
    samples = rng.random((s.tiles_y, s.tiles_x, 3))
    motion = rng.normal(0, 2, (s.tiles_y, s.tiles_x, 2))
    orders = rng.random((s.tiles_y, s.tiles_x)) < 0.5
    got, _ = run(frozen(compose), s, True, True, previous, samples, motion, orders, empty_state(s), subframe, 0, 5)
    wanted = oracle.compose_dynamic(previous, samples, motion, orders, subframe, size)
    np.testing.assert_allclose(got, wanted, atol=2e-5)


def test_without_history_old_pixels_are_the_mean_of_their_box() -> None:
    s = settings(8, 6)
    rng = np.random.default_rng(1)
    samples, orders = rng.random((3, 4, 3)), np.ones((3, 4), bool)
    motion = np.zeros((3, 4, 2))
    got, _ = run(
        frozen(compose), s, False, False, np.full((6, 8, 3), 9.0), samples, motion, orders, empty_state(s), 0, 0, 1
    )
    np.testing.assert_allclose(got, oracle.compose_dynamic(None, samples, motion, orders, 0, (8, 6)), atol=2e-6)


def test_a_static_pixel_shows_the_mean_of_its_last_four_samples_exactly() -> None:
    s = settings(6, 4)
    kernel, state = frozen(compose), empty_state(s)
    rng = np.random.default_rng(2)
    orders, motion = rng.random((2, 3)) < 0.5, np.zeros((2, 3, 2))
    shown = np.zeros((4, 6, 3))
    own: dict[tuple[int, int], list[np.ndarray]] = {}
    for n in range(40):
        samples = rng.random((2, 3, 3)).astype(np.float32)
        before = shown
        shown, state = run(kernel, s, False, n > 0, before, samples, motion, orders, state, n % 4, n // 4 % 4, n + 1)
        for ty in range(2):
            for tx in range(3):
                pixel = oracle.traced_pixel(tx, ty, bool(orders[ty, tx]), n % 4, 6, 4)
                if n > 0:
                    own.setdefault(pixel, []).append((n // 4 % 4, samples[ty, tx]))
        for (x, y), taken in own.items():
            by_slot = dict(taken[-4:])  # the newest in each slot
            mean = np.sum([by_slot[k] for k in sorted(by_slot)], axis=0, dtype=np.float32) / np.float32(len(by_slot))
            np.testing.assert_array_max_ulp(shown[y, x], mean.astype(np.float32), maxulp=2)
    assert kernel.recordings <= 3


def test_a_motion_resets_the_window() -> None:
    s = settings(2, 2)
    kernel, state = frozen(compose), empty_state(s)
    orders = np.ones((1, 1), bool)
    shown = np.zeros((2, 2, 3))
    for n in range(12):
        moving = np.full((1, 1, 2), 0.5 if n == 8 else 0.0)
        value = np.full((1, 1, 3), 1.0 if n < 8 else 0.25)
        shown, state = run(kernel, s, False, n > 0, shown, value, moving, orders, state, n % 4, n // 4 % 4, n + 1)
    np.testing.assert_array_equal(shown[0, 0], 0.25)  # dynamic at 8: as it was traced
    np.testing.assert_array_equal(shown[0, 1], 0.25)  # its own sample after the reset, no trace of 1.0
    np.testing.assert_array_equal(shown[1, 1], 0.25)


def test_the_mosaic_keeps_old_pixels_where_they_were() -> None:
    s = settings(4, 4, reproject=False)
    previous = np.random.default_rng(3).random((4, 4, 3)).astype(np.float32)
    samples, orders = np.full((2, 2, 3), 5.0), np.ones((2, 2), bool)
    got, _ = run(
        frozen(compose), s, True, True, previous, samples, np.full((2, 2, 2), 3.0), orders, empty_state(s), 1, 0, 9
    )
    wanted = previous.copy()
    wanted[0::2, 1::2] = 5.0
    np.testing.assert_array_equal(got, wanted)


@pytest.mark.parametrize("neighbourhood", ["all_immediate", "recent_3x3"])
def test_the_rejected_neighbourhoods_of_figure_7_do_worse_on_a_moving_edge(neighbourhood: str) -> None:
    def error(kind: str) -> float:
        s = settings(32, 32, kind)
        kernel, state, shown, total = frozen(compose), empty_state(s), np.zeros((32, 32, 3)), 0.0
        orders = np.ones((16, 16), bool)
        for n in range(24):
            x = np.arange(32) + 0.5
            edge = 6.0 + 0.75 * n
            truth = np.repeat(np.where((x > edge) & (x < edge + 5), 1.0, 0.2)[None, :, None], 32, 0).repeat(3, 2)
            column, row = [(0, 0), (1, 0), (0, 1), (1, 1)][n % 4]
            samples = truth[row::2, column::2]
            motion = np.zeros((16, 16, 2))
            motion[..., 0] = 0.75
            shown, state = run(kernel, s, True, n > 0, shown, samples, motion, orders, state, n % 4, 0, n + 1)
            total += float(np.mean((shown - truth) ** 2)) if n >= 8 else 0.0
        return total

    assert error("recent_immediate") < error(neighbourhood)
