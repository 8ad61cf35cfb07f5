"""Inputs on which common programs answer wrongly and say nothing: here each has its right answer, and says so."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

import analysis
from tests.analysis.extremes import study


def cells(values: np.ndarray) -> pd.DataFrame:
    """Subjects by levels as a long table."""
    s, c = np.indices(values.shape)
    return pd.DataFrame({"s": s.ravel(), "c": [f"c{k}" for k in c.ravel()], "y": values.ravel()})


def anova(values: np.ndarray) -> pd.Series:
    return analysis.rm_anova(cells(values), dv="y", within=["c"], subject="s").iloc[0]


def exact_f(values: np.ndarray) -> float:
    """F of subjects by levels in exact rational arithmetic on the stored doubles."""
    y = [[Fraction(float(v)) for v in row] for row in values]
    n, k = values.shape
    grand = sum(map(sum, y)) / (n * k)
    level = [sum(row[j] for row in y) / n for j in range(k)]
    person = [sum(row) / k for row in y]
    between = n * sum((m - grand) ** 2 for m in level)
    error = sum((y[i][j] - level[j] - person[i] + grand) ** 2 for i in range(n) for j in range(k))
    return float(between / (k - 1) / (error / ((n - 1) * (k - 1))))


def test_nothing_varies_or_only_subjects_differ_is_undefined() -> None:
    """statsmodels gives F = -2.8 and -0.65 with p = 1, R's aov F = 1."""
    for values in (np.full((5, 3), 0.1), np.outer([0.1, 0.7, 2.3, 1.1], np.ones(3))):
        row = anova(values)
        assert row["status"] == "undefined"
        assert math.isnan(row["F"])
        assert math.isnan(row["p"])


@pytest.mark.parametrize("step", [1.0, 0.1])
def test_the_same_difference_in_every_subject_is_infinite(step: float) -> None:
    """pingouin gives F = -6.8e15 and p = 1 with decimals, R 4e16."""
    row = anova(np.add.outer(np.array([0.3, 1.7, 2.9, 0.2]), step * np.arange(3)))
    assert (row["status"], row["F"], row["p"], row["log10_p"]) == ("zero_error_variance", math.inf, 0.0, -math.inf)


def test_a_paired_difference_that_is_constant_up_to_rounding_is_infinite() -> None:
    """scipy gives t = 4e9, p = 3e-29."""
    x = np.array([0.1, 0.2, 0.3, 1.4, 2.6])
    row = analysis.posthoc_t(cells(np.column_stack([x, x + 0.1])), dv="y", within="c", subject="s").iloc[0]
    assert (row["status"], row["t"], row["p"]) == ("zero_error_variance", -math.inf, 0.0)
    assert analysis.tost(x, x + 0.1, low=-0.5, high=0.5)["status"].iloc[0] == "zero_error_variance"


def test_more_levels_than_subjects() -> None:
    """pingouin says W = 0 and 'violated', R drops Greenhouse-Geisser as well."""
    values = np.random.default_rng(4).integers(-3, 4, (4, 6)).astype(float)
    row = anova(values)
    assert row["F"] == pytest.approx(exact_f(values), rel=1e-12)
    assert math.isnan(row["mauchly_w"])
    assert 1 / 5 <= row["eps_gg"] <= 1 / 5 * 3
    centred = values - values.mean(axis=1, keepdims=True)
    eigenvalues = np.linalg.eigvalsh(np.cov(centred, rowvar=False))
    assert row["eps_gg"] == pytest.approx(eigenvalues.sum() ** 2 / (5 * np.sum(eigenvalues**2)), rel=1e-10)
    assert "Mauchly" in row["note"]


def test_one_subject_is_refused() -> None:
    row = anova(np.array([[1.0, 2.0, 4.0]]))
    assert row["status"] == "too_few_subjects"
    assert math.isnan(row["F"])


@pytest.mark.parametrize("offset", [1e9, 1e12])
def test_large_offsets_cost_only_the_digits_that_the_doubles_lost(offset: float) -> None:
    """R is 2e-3 off at 1e12; the right answer is that of the stored doubles."""
    values = np.random.default_rng(5).normal(size=(15, 4)) + offset
    assert anova(values)["F"] == pytest.approx(exact_f(values), rel=1e-9)
    whole = np.random.default_rng(5).integers(-3, 4, (15, 4)).astype(float)
    assert anova(whole + offset)["F"] == pytest.approx(anova(whole)["F"], rel=1e-12)


def test_ordinal_separation_has_no_finite_maximum() -> None:
    """statsmodels gives a slope of 31.5, converged = True."""
    table = pd.DataFrame({"y": [1, 1, 1, 2, 2, 2, 3, 3, 3], "x": list("aaabbbccc")})
    made = analysis.cumulative_link(table, "y ~ x").set_index("term")
    assert set(made["status"]) == {"separated"}
    assert made.loc["xc", "estimate"] == math.inf
    assert not np.isfinite(made["se"]).any()


def test_ordinal_category_that_nobody_chose_is_left_out() -> None:
    """statsmodels fails in shape, or gives -inf and nan."""
    table = study()
    scale = pd.CategoricalDtype([-4, *range(-3, 4), 9], ordered=True)
    plain = analysis.cumulative_link(table, "rating ~ condition")
    unused = analysis.cumulative_link(table.astype({"rating": scale}), "rating ~ condition")
    assert unused["term"].tolist() == plain["term"].tolist()
    np.testing.assert_allclose(unused["estimate"], plain["estimate"], rtol=1e-7)


def test_binomial_separation_has_no_finite_maximum() -> None:
    """statsmodels gives 47 (SE 25,240) and R 52 (SE 91,689)."""
    table = pd.DataFrame({"y": [0] * 10 + [1] * 10, "x": ["a"] * 10 + ["b"] * 10, "s": list(range(10)) * 2})
    made = analysis.binomial_mixed(table, "y ~ x", random=None).set_index("term")
    assert made.loc["xb", ["estimate", "status"]].tolist() == [math.inf, "separated"]


def test_unanimous_pairs_have_no_scale() -> None:
    """pwcmp gives 0, 11.7 and 25 JOD: leftovers of the optimiser."""
    wins = pd.DataFrame({"w": ["c", "c", "b"], "l": ["a", "b", "a"], "n": [20, 20, 20]})
    for made, value in (
        (analysis.thurstone(wins, winner="w", loser="l", count="n"), "scale"),
        (analysis.bradley_terry(wins, winner="w", loser="l", count="n"), "ability"),
    ):
        assert set(made["status"]) == {"separated"}
        assert made[value].iloc[1:].tolist() == [math.inf, math.inf]


def test_thousands_of_answers_a_pair_do_not_underflow() -> None:
    """pwcmp's product of probabilities is 0 above 1,074 answers."""
    wins = pd.DataFrame({"w": list("abacbc"), "l": list("bacacb"), "n": [3, 7, 2, 8, 4, 6]})
    few = analysis.thurstone(wins, winner="w", loser="l", count="n")
    many = analysis.thurstone(wins.assign(n=wins["n"] * 100_000), winner="w", loser="l", count="n")
    np.testing.assert_allclose(many["scale"], few["scale"], rtol=1e-8)
    np.testing.assert_allclose(many["se"], few["se"] / math.sqrt(100_000), rtol=1e-6)
    assert set(many["status"]) == {"ok"}


def test_mixed_model_of_a_constant_is_refused() -> None:
    """statsmodels fits the noise: p = .92, .44, .63, converged = True."""
    made = analysis.linear_mixed(study().assign(rt_s=0.1), "rt_s ~ condition", random="(1|participant)")
    assert set(made["status"]) <= {"undefined", "zero_error_variance"}
    assert made["p"].iloc[1:].isna().all()


def test_mixed_model_of_two_subjects_says_that_there_are_two() -> None:
    made = analysis.linear_mixed(study(n=2), "rating ~ condition", random="(1|participant)")
    assert set(made["status"]) == {"too_few_subjects"}
    assert made["note"].str.contains("2 groups").all()
    assert np.isfinite(made["t"]).all()


def test_limits_of_a_unanimous_choice_are_exactly_one() -> None:
    row = analysis.binomial_choice(35, 35).iloc[0]
    assert (row["exact_high"], row["wilson_high"]) == (1.0, 1.0)
    assert row["exact_low"] == pytest.approx(0.025 ** (1 / 35), rel=1e-12)
    none = analysis.binomial_choice(0, 35).iloc[0]
    assert (none["exact_low"], none["wilson_low"]) == (0.0, 0.0)


def test_wilcoxon_exact_with_ties_and_zeros() -> None:
    """scipy's exact method gives a wrong p without a warning: here against every assignment of signs."""
    x = np.array([1.0, 2, 2, 3, 0, -1, -2, 4, 1, 0, 3])
    d = x[x != 0]
    ranks = pd.Series(np.abs(d)).rank().to_numpy()
    signs = (np.arange(2 ** len(d))[:, None] >> np.arange(len(d))) & 1
    sums = signs @ ranks
    observed = ranks[d > 0].sum()
    p = min(1.0, 2 * min(np.mean(sums >= observed - 1e-9), np.mean(sums <= observed + 1e-9)))
    made = analysis.wilcoxon(x, np.zeros(len(x)), zeros="wilcox", exact=True).iloc[0]
    assert made["p"] == pytest.approx(p, rel=1e-12)
    assert made["n_used"] == len(d)
