"""What the words of a pixel keep: colours to the bits that they are given, cache info as it is."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.backend import activate, dr, mi
from renderers.engine import LARGEST
from renderers.foveated.words import COLORS, LEAST, Layout, decoded, encoded, float_pair, floats, gathered, packed

activate()


@pytest.mark.parametrize(("bits", "error"), [(16, 1 / 2048), (21, 1 / 65536)])
def test_colours_come_back_to_their_bits_whatever_their_size(bits: int, error: float) -> None:
    values = np.concatenate([np.geomspace(LEAST, LARGEST, 5001), [1.0, 0.5, LARGEST]]).astype(np.float32)
    found = decoded(encoded(mi.Float(values), bits), bits).numpy()
    np.testing.assert_allclose(found, values, rtol=error)
    assert abs(np.mean(found / values - 1)) < error / 25  # rounded, not cut
    again = decoded(encoded(mi.Float(found), bits), bits).numpy()
    np.testing.assert_array_equal(again, found)
    assert (decoded(encoded(mi.Float([0.0, 0.99 * LEAST]), bits), bits).numpy() == 0).all()  # black stays black
    assert encoded(mi.Float([LARGEST]), bits).numpy() < 1 << bits


@pytest.mark.parametrize(("layout", "error"), [("shown", 1 / 65536), ("light", 1 / 2048), ("grey", 1 / 2048)])
def test_every_value_of_a_pixel_has_a_place_of_its_own(layout: Layout, error: float) -> None:
    lanes = 7
    rng = np.random.default_rng(1)
    given = {name: 10.0 ** rng.uniform(-5, 4, (3, lanes)).astype(np.float32) for name in COLORS[layout]}
    if layout == "grey":
        given["light"][1:] = given["light"][0]
    planes = packed(layout, {name: mi.Color3f(*map(mi.Float, value)) for name, value in given.items()})
    dr.eval(planes)
    found = gathered(layout, planes, dr.arange(mi.UInt32, lanes))
    assert set(found) == set(given)
    for name, wanted in given.items():
        np.testing.assert_allclose(found[name].numpy(), wanted, rtol=error)
    backwards = gathered(layout, planes, mi.UInt32(np.arange(lanes)[::-1].astype(np.uint32)))
    for name in given:
        np.testing.assert_array_equal(backwards[name].numpy(), found[name].numpy()[:, ::-1])
    nothing = gathered(layout, planes, dr.arange(mi.UInt32, lanes), mi.Bool(False))
    assert all((value.numpy() == 0).all() for value in nothing.values())


def test_two_floats_come_back_as_they_were() -> None:
    values = np.array([[0.0, -1.5, 1e30, np.inf, 3e-39], [7.0, 1 / 3, -0.0, np.nan, 65504.0]], np.float32)
    found = floats(float_pair(*map(mi.Float, values)))
    for got, wanted in zip(found, values, strict=True):
        np.testing.assert_array_equal(got.numpy(), wanted)
