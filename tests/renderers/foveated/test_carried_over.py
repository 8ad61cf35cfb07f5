"""What a new picture takes from the last one, value by value: taps in a pixel's footprint, bilinear support image."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.backend import activate, dr, mi
from renderers.foveated.compose import Picture, Samples, carried_over
from renderers.foveated.support import SupportGrid
from renderers.foveated.words import float_pair, packed
from renderers.parameters import Foveated as Parameters

activate()
SIDE = 128
GRID = SupportGrid.of((SIDE, SIDE), 4.6)


def ramp(columns: int, rows: int) -> tuple:
    """Words of a picture whose red is 1 + the column and whose green is 1 + the row."""
    y, x = (v.ravel().astype(np.float32) for v in np.mgrid[:rows, :columns])
    words = packed("shown", {"shown": mi.Color3f(mi.Float(x + 1), mi.Float(y + 1), mi.Float(np.ones_like(x)))})
    dr.eval(words)
    return words


def carried(place: np.ndarray, **params: float) -> dict[str, np.ndarray]:
    """The ramps taken over by pixels that were at ``place`` (SIDE, SIDE, 2); support image: ramps over its texels."""
    zero = mi.Float(np.zeros(SIDE * SIDE, np.float32))
    old = Picture(zero, ramp(SIDE, SIDE), float_pair(zero + 3, zero + 2), None, zero)
    lanes = dr.arange(mi.UInt32, GRID.texels)
    samples = Samples((zero, zero), ramp(GRID.columns, GRID.rows), zero, (zero,) * 3, mi.UInt32(0))
    index = dr.arange(mi.UInt32, SIDE * SIDE)
    found = carried_over(
        Parameters(**params), GRID, "shown", mi.Float(place.astype(np.float32).ravel()), index,
        mi.Bool(np.ones(SIDE * SIDE, bool)), old, samples, lanes, mi.UInt32(7),
    )  # fmt: skip
    red, green, _ = found["shown"].numpy().reshape(3, SIDE, SIDE)
    return {"x": red - 1, "y": green - 1, **{name: found[name].numpy().reshape(SIDE, SIDE) for name in ("rho", "age")}}


def places(scale: float, shift: float = 0.0) -> np.ndarray:
    """Pixels that were ``scale`` times as far from the picture's middle, and ``shift`` px off."""
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2
    return np.stack([x, y], -1) * scale + SIDE / 2 + shift


@pytest.mark.parametrize("taps", [1, 4, 16])
@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.25), (0.5, 0.0), (2.0, 0.0)])
def test_taps_spread_over_the_footprint_as_a_normal_distribution_does(
    scale: float, shift: float, sigma: float, taps: int
) -> None:
    """Mean and deviation are those of independent normal taps of ``sigma`` half footprints, of the pixels they hit."""
    place = places(scale, shift)
    found = carried(place, n_fp=taps, footprint_sigma=sigma)
    reach = 3.5 * sigma * scale / 2 + 1  # taps beyond the picture's edge fall onto it
    inside = ((place > reach) & (place < SIDE - reach)).all(-1)
    assert inside.sum() > 2000
    rng = np.random.default_rng(8)
    for axis, name in enumerate("xy"):
        at = place[..., axis][inside]
        hits = np.floor(at + sigma * scale / 2 * rng.standard_normal((taps, at.size))) + 0.5
        off, wanted = found[name][inside] + 0.5 - at, hits.mean(axis=0) - at
        assert off.mean() == pytest.approx(wanted.mean(), abs=0.03 * max(0.5, sigma * scale))
        assert off.std() == pytest.approx(wanted.std(), rel=0.06)
    assert (found["rho"][inside] == 3).all()  # never averaged
    assert (found["age"][inside] == 3).all()


def test_what_rests_is_taken_as_it_was() -> None:
    found = carried(places(1.0))
    y, x = np.mgrid[:SIDE, :SIDE]
    np.testing.assert_allclose(found["x"], x, atol=2e-3)
    np.testing.assert_allclose(found["y"], y, atol=2e-3)


def test_holes_get_the_support_image_between_its_texels() -> None:
    found = carried(np.full((SIDE, SIDE, 2), np.nan))
    at = np.clip((np.arange(SIDE) + 0.5) * GRID.columns / SIDE - 0.5, 0, GRID.columns - 1)
    np.testing.assert_allclose(found["x"], np.tile(at, (SIDE, 1)), atol=2e-3)
    np.testing.assert_allclose(found["y"], np.tile(at[:, None], (1, SIDE)), atol=2e-3)
    assert (found["rho"] == 0).all()
