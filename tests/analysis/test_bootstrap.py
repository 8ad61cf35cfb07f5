"""Bootstraps over participants: the same numbers for a seed, whatever the number of threads."""

from __future__ import annotations

import numpy as np
import pytest

import analysis
from analysis.bootstrap import BLOCK, in_blocks, resample_weights
from tests.analysis.extremes import study


@pytest.mark.parametrize("method", ["ml", "mean_z"])
def test_threads_change_nothing(method: str) -> None:
    table = study(n=14)
    made = [
        analysis.thurstone(
            table, winner="winner", loser="loser", observer="participant", method=method, n_boot=1100, workers=workers
        )
        for workers in (1, 2, 5)
    ]
    for other in made[1:]:
        assert other.equals(made[0])
        assert other.attrs["covariance"] == made[0].attrs["covariance"]


def test_another_seed_gives_other_numbers() -> None:
    table, names = study(n=14), {"winner": "winner", "loser": "loser", "observer": "participant", "n_boot": 300}
    one, same, other = (analysis.thurstone(table, **names, seed=seed) for seed in (0, 0, 1))
    assert one.equals(same)
    assert (one["se"].iloc[1:] != other["se"].iloc[1:]).all()


def test_resamples_draw_every_participant_equally_often() -> None:
    weights = resample_weights(8, 4000, seed=3)
    assert (weights.sum(axis=1) == 8).all()
    # the mean of 4,000 binomial(8, 1/8) draws: SD 0.0148
    np.testing.assert_allclose(weights.mean(axis=0), 1.0, atol=0.07)


@pytest.mark.parametrize("n", [0, 1, BLOCK, BLOCK + 1])
def test_blocks_keep_the_order(n: int) -> None:
    weights = np.arange(3.0 * n).reshape(n, 3)
    np.testing.assert_array_equal(in_blocks(lambda block: block * 2, weights, workers=3), weights * 2)
