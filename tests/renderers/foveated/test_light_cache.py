"""What the packed cache of sampled light keeps: colours to half a thousandth, cache info as it is."""

from __future__ import annotations

import numpy as np

from renderers.backend import activate, dr, mi
from renderers.engine import LARGEST
from renderers.foveated.light_cache import LEAST, WORDS, colors, decoded, encoded, info, write

activate()


def test_colours_come_back_to_half_a_thousandth_whatever_their_size() -> None:
    values = np.concatenate([np.geomspace(1e-9, LARGEST, 5001), [1.0, 0.5, LARGEST]]).astype(np.float32)
    found = decoded(encoded(mi.Float(values))).numpy()
    np.testing.assert_allclose(found, values, rtol=1 / 2048)
    assert abs(np.mean(found / values - 1)) < 2e-5  # rounded, not cut
    again = decoded(encoded(mi.Float(found))).numpy()
    np.testing.assert_array_equal(again, found)
    assert decoded(encoded(mi.Float([0.0]))).numpy() == LEAST
    assert encoded(mi.Float([LARGEST])).numpy() < 1 << 16


def test_all_nine_values_and_the_cache_info_of_a_pixel_have_a_place_of_their_own() -> None:
    lanes = 7
    cache = mi.UInt32(np.zeros(lanes * WORDS, np.uint32))
    pixel = dr.arange(mi.UInt32, lanes)
    rng = np.random.default_rng(1)
    given = {name: rng.random((3, lanes)).astype(np.float32) for name in ("surface", "albedo", "light")}
    known = {name: (100 * rng.random(lanes)).astype(np.float32) for name in ("rho", "age", "rho_light")}
    values = {name: mi.Color3f(*map(mi.Float, v)) for name, v in given.items()}
    write(cache, pixel, values | {name: mi.Float(v) for name, v in known.items()})
    found = colors(cache, pixel)
    for name, wanted in given.items():
        np.testing.assert_allclose(found[name].numpy(), wanted, rtol=1 / 2048)
    for name, wanted in known.items():
        np.testing.assert_array_equal(info(cache, pixel)[name].numpy(), wanted)
    assert (info(cache, pixel, mi.Bool(False))["rho"].numpy() == 0).all()
