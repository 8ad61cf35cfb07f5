"""The encoder against its own formula in float64, bit pattern by bit pattern."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stimuli.encode import (
    DisplayTable,
    code_table,
    display_values,
    encode,
    linear_from_pq,
    linear_from_srgb,
    srgb_from_linear,
    table_from_samples,
)
from stimuli.errors import InputError
from stimuli.exposure import default_exposure, luminance
from stimuli.exr import to_half


def formula(value: float, exposure: float) -> int:
    """The rule of decisions.md, written out for one number."""
    light = min(max(exposure * value, 0.0), 1.0)
    coded = 12.92 * light if light <= 0.0031308 else 1.055 * light ** (1 / 2.4) - 0.055
    return round(255 * coded)


@pytest.mark.parametrize("exposure", [1.0, 0.125, 2.0 ** (3 / 8), 400.0])
def test_every_finite_half_gets_the_formulas_code(exposure):
    halves = np.arange(65536, dtype=np.uint16).view(np.float16)
    finite = np.isfinite(halves)
    wanted = [formula(float(value), exposure) for value in halves[finite]]
    assert code_table(exposure)[finite].tolist() == wanted


def test_live_float_frames_and_stored_half_frames_have_the_same_codes():
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**32, 3 * 200_000, dtype=np.uint64).astype(np.uint32)
    any_float = bits.view(np.float32).reshape(400, 500, 3)
    around = (10.0 ** rng.uniform(-9, 6, (400, 500, 3))).astype(np.float32)
    ties = ((np.arange(0x7BFF, dtype=np.uint32) << 13) + 0x1000 + (112 << 23)).view(np.float32)[: 3 * 10_000]
    with np.errstate(invalid="ignore", over="ignore"):
        for frame in (any_float, around, ties.reshape(100, 100, 3)):
            for exposure in (1.0, 3000.0, 1e-6):
                np.testing.assert_array_equal(encode(frame, exposure), encode(to_half(frame), exposure))


def test_extremes():
    frame = np.array([[[np.nan, np.inf, -np.inf], [0.0, 1.0, -1.0], [65504.0, 1e30, 1e-30]]], np.float32)
    np.testing.assert_array_equal(encode(frame)[..., :3], [[[0, 255, 0], [0, 255, 0], [255, 255, 0]]])
    np.testing.assert_array_equal(encode(frame)[..., 3], 255)
    assert encode(np.zeros((0, 5, 3), np.float32)).shape == (0, 5, 4)
    assert encode(np.ones((2, 2, 3), np.float64)).tolist() == np.full((2, 2, 4), 255).tolist()


def test_output_array_and_views_are_honoured():
    frame = np.random.default_rng(1).random((6, 8, 3)).astype(np.float32)
    out = np.zeros((6, 8, 4), np.uint8)
    assert encode(frame, out=out) is out
    np.testing.assert_array_equal(encode(frame[::-1, ::2]), out[::-1, ::2])
    with pytest.raises(InputError, match="output array"):
        encode(frame, out=np.zeros((6, 16, 4), np.uint8)[:, ::2])


@pytest.mark.parametrize("exposure", [0.0, -1.0, math.nan, math.inf])
def test_useless_exposures_are_refused(exposure):
    with pytest.raises(InputError, match="exposure"):
        encode(np.zeros((1, 1, 3), np.float32), exposure)


def test_unknown_tone_and_shape_are_refused():
    with pytest.raises(InputError, match="tone"):
        encode(np.zeros((1, 1, 3), np.float32), tone="filmic")
    with pytest.raises(InputError, match="picture shape"):
        encode(np.zeros((1, 3), np.float32))


def test_srgb_and_pq_at_published_points():
    assert srgb_from_linear(np.array(0.0031308)) == pytest.approx(0.04045, abs=1e-6)
    assert srgb_from_linear(np.array(0.18)) == pytest.approx(0.4613561, abs=1e-6)
    x = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(linear_from_srgb(srgb_from_linear(x)), x, atol=1e-7)
    # SMPTE ST 2084: 0 -> 0, 1 -> 10,000 cd/m2, 0.508078 -> 100 cd/m2
    assert linear_from_pq(np.array(0.0)) == 0
    assert linear_from_pq(np.array(1.0)) == pytest.approx(100.0)
    assert linear_from_pq(np.array(0.508078)) == pytest.approx(1.0, rel=1e-4)


def test_display_values_are_unrounded():
    assert display_values(np.array([0.18, 2.0, -1.0, np.nan])).tolist() == pytest.approx([0.4613561, 1, 0, 0], abs=1e-6)
    assert display_values(np.array(0.09), exposure=2.0) == pytest.approx(0.4613561, abs=1e-6)


def test_measured_table_of_an_ideal_srgb_display_gives_srgb_codes():
    ideal = DisplayTable(tuple(linear_from_srgb(np.arange(256) / 255) * 200.0))
    wanted, got = code_table(1.0).astype(int), code_table(1.0, "none", ideal).astype(int)
    assert np.abs(wanted - got).max() <= 1  # straight lines between codes round otherwise only at the middle
    assert (wanted == got).mean() > 0.999


def test_measured_table_of_a_linear_display_with_black_level():
    table = table_from_samples([0, 255], [1.0, 101.0])
    frame = np.array([[[0.0, 1.0 / 101.0, 51.0 / 101.0]]], np.float32)
    assert encode(frame, table=table)[0, 0, :3].tolist() == [0, 0, 127]
    assert encode(np.ones((1, 1, 3), np.float32), table=table)[0, 0, :3].tolist() == [255] * 3


@pytest.mark.parametrize(
    "levels", [np.zeros(256), np.arange(255.0), np.arange(256.0)[::-1], np.full(256, np.nan), np.arange(-1.0, 255.0)]
)
def test_impossible_tables_are_refused(levels):
    with pytest.raises(InputError, match="display table"):
        DisplayTable(tuple(levels))


def test_default_exposure_brings_the_log_average_to_middle_grey_within_a_sixteenth_stop():
    rng = np.random.default_rng(2)
    picture = np.exp(rng.normal(-3, 1.5, (64, 64, 3)))
    exposure = default_exposure(picture)
    key = math.exp(np.mean(np.log(luminance(exposure * picture))))
    assert abs(math.log2(key / 0.18)) <= 1 / 16 + 1e-9
    assert (8 * math.log2(exposure)) == pytest.approx(round(8 * math.log2(exposure)), abs=1e-9)


def test_default_exposure_of_black_is_one_and_black_pixels_do_not_count():
    assert default_exposure(np.zeros((64, 64, 3))) == 1.0
    half_black = np.zeros((64, 64, 3))
    half_black[:32] = 0.18
    assert default_exposure(half_black) == 1.0
    half_black[0, 0] = np.nan
    assert default_exposure(half_black) == 1.0
    assert default_exposure(np.full((4, 4, 3), 1e-12)) > 1e9
    assert default_exposure(np.full((4, 4, 3), 65504.0)) < 1e-5
