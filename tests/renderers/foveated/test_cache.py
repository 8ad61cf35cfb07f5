"""The cache's recursion against float64, and the four cases in which a sample overwrites."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from renderers.backend import activate, dr, mi
from renderers.foveated.cache import blend, least_weight, weights
from renderers.parameters import Foveated
from renderers.technique import View
from tests.renderers.foveated.test_technique import made, view, wall

activate()


def k_reference(age: float, k_min: float, k_max: float, t_max: int) -> float:
    """The paper's k as printed: min{exp(x0 + (dt - 1) / (t_max - 1) (x1 - x0)), k_max}, in float64."""
    if age >= t_max:
        return k_max
    x0, x1 = np.log(k_min), np.log(k_max)
    return min(float(np.exp(x0 + (age - 1) / (t_max - 1) * (x1 - x0))), k_max)


@pytest.mark.parametrize(("k_min", "k_max", "t_max"), [(0.05, 0.8, 16), (0.3, 0.3, 7), (0.01, 1.0, 2), (0.05, 0.8, 1)])
def test_k_grows_geometrically_with_age(k_min: float, k_max: float, t_max: int) -> None:
    ages = np.arange(1, 40)
    found = least_weight(k_min, k_max, mi.Float(ages), mi.Float(t_max)).numpy()
    wanted = [k_reference(age, k_min, k_max, t_max) for age in ages]
    np.testing.assert_allclose(found, wanted, rtol=2e-6)
    assert np.isfinite(found).all()


def test_a_thousand_frames_of_the_recursion_agree_with_float64() -> None:
    """Random gaps, random samples, many pixels: alpha, rho and the blended value."""
    rng = np.random.default_rng(7)
    lanes, k_min, k_max, t_max = 64, 0.05, 0.8, 16
    rho, age, value = np.zeros(lanes), np.ones(lanes), np.zeros(lanes)
    device = {"rho": mi.Float(rho), "value": mi.Float(value)}
    worst = 0.0
    for _ in range(1000):
        drawn = rng.random(lanes) < np.linspace(0.02, 1, lanes)
        new = rng.random(lanes)
        alpha, next_rho = weights(
            device["rho"], mi.Float(age), k_min, k_max, mi.Float(t_max), mi.Bool(np.zeros(lanes, bool))
        )
        here = mi.Bool(drawn)
        blended = dr.lerp(device["value"], mi.Float(new), alpha)
        device["value"] = dr.select(here, blended, device["value"])
        device["rho"] = dr.select(here, next_rho, device["rho"])
        dr.eval(device)
        for i in np.flatnonzero(drawn):
            a = 1.0 if rho[i] == 0 else max(1 / (rho[i] + 1), k_reference(age[i], k_min, k_max, t_max))
            rho[i] = 1 / (a**2 + (0.0 if rho[i] == 0 else (1 - a) ** 2 / rho[i]))
            value[i] = a * new[i] + (1 - a) * value[i]
        age = np.where(drawn, 1, age + 1)
        worst = max(
            worst,
            np.abs(device["value"].numpy() - value).max(),
            np.abs(device["rho"].numpy() / np.maximum(rho, 1e-9) - 1)[rho > 0].max(initial=0),
        )
    assert worst < 2e-5


@pytest.mark.parametrize("k", [0.05, 0.1, 0.5])
def test_the_number_of_samples_settles_at_its_fixed_point(k: float) -> None:
    """A pixel sampled in every frame: rho -> (2 - k) / k, and never without bound (as with the printed min)."""
    rho = mi.Float(0)
    for _ in range(1000):
        _, rho = weights(rho, mi.Float(1), k, k, mi.Float(16), mi.Bool(False))
        dr.eval(rho)
    assert rho[0] == pytest.approx((2 - k) / k, rel=1e-4)


def merged(*, overwrite: bool = False, rho: float = 4.0, z_cache: float = 10.0, z: float = 10.0) -> tuple[float, ...]:
    """A sample of 1 against a cached 0: what is shown, alpha, rho, age."""
    cached = {"shown": mi.Color3f(0.0), "rho": mi.Float(rho), "age": mi.Float(1)}
    sample = {"color": mi.Color3f(1.0), "shown": mi.Color3f(1.0), "z": mi.Float(z)}
    settings, far = Foveated(k_min=0.05), mi.Float(1e4)
    out, alpha = blend(settings, sample, cached, mi.Bool(overwrite), mi.Float(z_cache), far, mi.Float(16))
    return out["shown"].x[0], alpha[0], out["rho"][0], out["age"][0]


def test_a_sample_is_blended_where_nothing_speaks_against_it() -> None:
    shown, alpha, rho, age = merged()
    assert shown == pytest.approx(0.2)  # one of five samples
    assert (alpha, rho, age) == (pytest.approx(0.2), pytest.approx(5.0), 0)


@pytest.mark.parametrize(
    "case",
    [
        {"overwrite": True},  # the fovea, and marked pixels: both come in by this flag (see test_technique)
        {"rho": 0.0},  # nothing was reprojected
        {"z": 11.0},  # depth disagrees: it lies behind,
        {"z_cache": 11.0},  # in front of,
        {"z": float("inf")},  # or beyond what was reprojected
    ],
)
def test_a_sample_overwrites(case: dict) -> None:
    assert merged(**case) == (1.0, 1.0, 1.0, 0.0)


def test_depths_within_the_threshold_and_two_backgrounds_agree() -> None:
    assert merged(z=10.4)[0] == pytest.approx(0.2)
    assert merged(z=float("inf"), z_cache=5e4)[0] == pytest.approx(0.2)


def test_t_max_is_a_time_unless_it_is_set() -> None:
    scene = wall()
    assert made(scene).t_max(view(scene, 0)) == 16
    assert made(scene, t_max=1).t_max(view(scene, 0)) == 1
    slow = View(0, Fraction(0), Fraction(1), (120, 90), scene.camera)
    assert made(scene).t_max(slow) == 1
