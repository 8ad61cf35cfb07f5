"""The foveal function: values by hand, configurations of the paper, shares at a display."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from renderers import render_clip
from renderers.foveated.foveal_function import picture_probability, sampling_probability
from renderers.parameters import Foveated
from renderers.technique import ViewGeometry
from stimuli import load_scene
from stimuli.errors import InputError


def test_the_named_configurations_are_the_papers() -> None:
    regions = {name: Foveated(configuration=name).region for name in ("small", "medium", "large", "full")}
    assert regions == {
        "small": (5, 10, 0.01), "medium": (10, 20, 0.05), "large": (15, 30, 0.1), "full": (math.inf, math.inf, 1),
    }  # fmt: skip
    assert Foveated(configuration="small", r1_deg=40.0).region == (5, 40, 0.01)


def test_probability_falls_linearly_between_the_radii() -> None:
    p = Foveated(r0_deg=10, r1_deg=20, p_min=0.2)
    e = [0, 10, 12.5, 15, 20, 21, 180]
    np.testing.assert_allclose(sampling_probability(np.array(e), p), [1, 1, 0.8, 0.6, 0.2, 0.2, 0.2])


def test_equal_radii_are_a_step_and_full_is_one_everywhere() -> None:
    step = Foveated(r0_deg=10, r1_deg=10, p_min=0.0)
    np.testing.assert_array_equal(sampling_probability(np.array([10.0, 10.001, 90]), step), [1, 0, 0])
    assert (sampling_probability(np.linspace(0, 180, 50), Foveated(configuration="full")) == 1).all()


@pytest.mark.parametrize(
    "values",
    [
        {"r0_deg": 20, "r1_deg": 10}, {"k_min": 0}, {"k_min": 0.9, "k_max": 0.1}, {"p_min": 1.1}, {"p_min": math.nan},
        {"t_max": 0}, {"support_divisor": 0.5}, {"light_samples": 8}, {"r0_deg": math.nan}, {"r0_deg": 40},
    ],
)  # fmt: skip
def test_settings_without_sense_are_errors(values: dict) -> None:
    with pytest.raises(ValidationError):
        Foveated(**values)


@pytest.mark.parametrize(
    ("params", "line"),
    [
        (
            {"r0_deg": 20, "r1_deg": 10},
            "parameters: got {'r0_deg': 20, 'r1_deg': 10}, wanted r1_deg of at least r0_deg = 20 (it is 10)",
        ),
        ({"r1_deg": 4}, "parameters: got {'r1_deg': 4}, wanted r1_deg of at least r0_deg = 10 (it is 4)"),
        ({"k_min": 0.9, "k_max": 0.1}, "parameters: got {'k_min': 0.9, 'k_max': 0.1}, wanted k_max of at least k_min"),
        ({"t_max": 1.5}, "t_max: got 1.5, wanted a valid integer"),
        ({"k_min": 0}, "k_min: got 0, wanted greater than 0"),
        ({"configuration": "huge"}, "configuration: got 'huge', wanted 'small', 'medium', 'large' or 'full'"),
        ({"k_mim": 0.1}, "parameter: got 'k_mim', wanted one of configuration | r0_deg"),
    ],
)  # fmt: skip
def test_errors_are_one_line_that_says_what_was_wanted(params: dict, line: str) -> None:
    with pytest.raises(InputError) as caught:
        render_clip(load_scene("bar"), "foveated", params=params)
    assert str(caught.value).startswith(f"foveated: {line}")
    assert "\n" not in str(caught.value).strip()


def test_a_display_sees_the_fovea_as_a_circle_on_its_plane() -> None:
    near, far = ViewGeometry(1.0, 1.0, 0.5), ViewGeometry(0.1, 0.1, 1.0)
    # a circle of tan(10 deg) * 0.5 m on a square metre
    inside = math.pi * (0.5 * math.tan(math.radians(10))) ** 2
    at_full_rate = picture_probability(Foveated(), (400, 400), 1.0, near) == 1
    assert at_full_rate.mean() == pytest.approx(inside, abs=2e-3)
    assert (picture_probability(Foveated(), (400, 400), 1.0, far) == 1).all()
    assert (picture_probability(Foveated(configuration="full"), (40, 40), 1.0, near) == 1).all()
