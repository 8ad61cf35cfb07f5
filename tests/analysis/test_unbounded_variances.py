"""Mixed models whose variances may be negative: exact in balanced data, the same where none is, a maximum elsewhere."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import optimize

import analysis
from analysis.formula import model_frame
from analysis.reml import Reml
from stimuli.errors import InputError

RANDOM = ["(1|p)", "(1|p:c)"]


def judged(people: int, own_sd: float, seed: int, kept: float = 1.0) -> pd.DataFrame:
    """Four ratings of three conditions by everybody, who differ by an offset, and by ``own_sd`` in each condition."""
    rng = np.random.default_rng(seed)
    p, c, _ = (v.ravel() for v in np.indices((people, 3, 4)))
    y = rng.normal(size=people)[p] + own_sd * rng.normal(size=(people, 3))[p, c] + rng.normal(size=len(p))
    table = pd.DataFrame({"p": p, "c": [f"c{v}" for v in c], "y": y})
    return table[rng.random(len(table)) < kept].reset_index(drop=True)


def test_a_negative_variance_gives_the_analysis_of_variance() -> None:
    table = judged(12, 0.0, seed=1)
    made = analysis.linear_mixed(table, "y ~ c", RANDOM, variances="unbounded")
    assert made.attrs["variances"]["p:c"] < 0
    assert set(made["status"]) == {"boundary"}
    assert made["note"].str.contains("p:c .* below 0").all()
    anova = analysis.rm_anova(table, "y", ["c"], "p").iloc[0]
    test = made.attrs["f_tests"][0]
    assert test["F"] == pytest.approx(anova["F"], rel=1e-9)
    assert test["df2"] == pytest.approx(22, rel=1e-6)
    assert test["p"] == pytest.approx(anova["p"], rel=1e-6)
    # the mean square of participants by conditions is its expectation: 4 observations a cell
    variances = made.attrs["variances"]
    square = 4 * variances["p:c"] + variances["residual"]
    cells = table.groupby(["p", "c"])["y"].mean().unstack().to_numpy()
    rest = cells - cells.mean(axis=0) - cells.mean(axis=1)[:, None] + cells.mean()
    assert square == pytest.approx(4 * float((rest**2).sum()) / 22, rel=1e-8)


def test_held_at_0_the_same_test_is_less_likely_to_reject_and_says_so() -> None:
    table = judged(12, 0.0, seed=1)
    held = analysis.linear_mixed(table, "y ~ c", RANDOM)
    free = analysis.linear_mixed(table, "y ~ c", RANDOM, variances="unbounded")
    assert held.attrs["variances"]["p:c"] == 0
    assert held["note"].str.contains("may reject too seldom").all()
    assert (held["p"][1:] > free["p"][1:]).all()


@pytest.mark.parametrize("kept", [1.0, 0.7])
def test_where_none_is_negative_both_are_the_same(kept: float) -> None:
    table = judged(12, 1.0, seed=2, kept=kept)
    held = analysis.linear_mixed(table, "y ~ c", RANDOM)
    free = analysis.linear_mixed(table, "y ~ c", RANDOM, variances="unbounded")
    pd.testing.assert_frame_equal(held, free, check_exact=True)
    assert held.attrs["method"] != free.attrs["method"]


def test_in_unbalanced_data_it_is_the_maximum_of_the_restricted_likelihood() -> None:
    table = judged(10, 0.0, seed=1, kept=0.6)
    made = analysis.linear_mixed(table, "y ~ c", RANDOM, variances="unbounded")
    found = np.array([made.attrs["variances"][name] for name in ("residual", "p", "p:c")])
    assert found.min() < 0
    x = pd.get_dummies(table["c"]).to_numpy(dtype=float)
    groups = table["p"], table["p"].astype(str) + table["c"]
    z = [pd.get_dummies(codes).to_numpy(dtype=float) for codes in groups]
    y = table["y"].to_numpy()

    def minus(variances: np.ndarray) -> float:
        v = variances[0] * np.eye(len(y)) + sum(s * one @ one.T for s, one in zip(variances[1:], z, strict=True))
        if np.linalg.eigvalsh(v)[0] <= 0:
            return np.inf
        inverse = np.linalg.inv(v)
        middle = x.T @ inverse @ x
        rest = y - x @ np.linalg.solve(middle, x.T @ inverse @ y)
        log_dets = np.linalg.slogdet(v)[1] + np.linalg.slogdet(middle)[1]
        return 0.5 * float(log_dets + rest @ inverse @ rest)

    best = optimize.minimize(minus, found, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-12})
    assert minus(found) <= best.fun + 1e-9
    np.testing.assert_allclose(best.x, found, atol=1e-4)
    with pytest.raises(InputError, match="variances"):
        analysis.linear_mixed(table, "y ~ c", RANDOM, variances="free")


def test_a_covariance_that_is_not_positive_definite_is_refused() -> None:
    table = judged(6, 1.0, seed=4)
    frame = model_frame("test", table, "y ~ c", RANDOM)
    q = np.linalg.qr(frame.x)[0]
    reml = Reml(table["y"].to_numpy(), q, frame.random)
    assert np.isfinite(reml.state(np.array([1.0, 1.0, -0.24]))["value"])
    for variances in ([1.0, 1.0, -0.26], [0.0, 1.0, 1.0], [1.0, -0.09, 0.0]):
        with pytest.raises(np.linalg.LinAlgError):
            reml.state(np.array(variances))
