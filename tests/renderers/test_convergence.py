"""Samples by an error target: the error that is stated is measured, falls with the samples, and decides."""

from __future__ import annotations

import pytest

from renderers.clip_renderer import ClipRenderer
from renderers.convergence import reference_error, samples_for_error
from stimuli import load_scene
from stimuli.errors import InputError
from tests.renderers.test_clip_renderer import job


@pytest.fixture(scope="module")
def tunnel():
    return job(load_scene("tunnel_geom"), "reference", 3)


def test_error_falls_with_samples_and_the_smallest_power_within_the_target_is_taken(tunnel):
    renderer = ClipRenderer(None)
    errors = {spp: reference_error(tunnel, spp, renderer) for spp in (4, 16, 64)}
    assert errors[4] > errors[16] > errors[64] > 0
    found = samples_for_error(tunnel, errors[16], renderer)
    assert found.spp in (8, 16)
    assert found.errors[found.spp] <= errors[16]
    assert all(error > errors[16] for spp, error in found.errors.items() if spp < found.spp)


def test_errors_of_one_block_and_of_several_agree(tunnel):
    renderer = ClipRenderer(None)
    one, two = reference_error(tunnel, 64, renderer), reference_error(tunnel, 128, renderer)
    assert 0.3 * one < two < 1.1 * one


def test_target_out_of_reach_ends_early(tunnel):
    found = samples_for_error(tunnel, 1e-9, ClipRenderer(None))
    assert found.spp is None
    assert len(found.errors) <= 2


@pytest.mark.parametrize("target", [0.0, -1.0, float("nan")])
def test_useless_targets_are_refused(tunnel, target):
    with pytest.raises(InputError, match="above 0"):
        samples_for_error(tunnel, target, ClipRenderer(None))
