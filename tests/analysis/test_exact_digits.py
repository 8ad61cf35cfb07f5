"""Digits: against exact rational arithmetic on the stored doubles, and under shifts, scales and permutations."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

import analysis
from tests.analysis.extremes import study


def nist_like(offset: float, per_group: int, groups: int = 9) -> pd.DataFrame:
    """The structure of NIST's SmLs sets: 0.2 ... 0.6 beside many constant leading digits."""
    rows = []
    for g in range(groups):
        centre = [0.4, 0.3, 0.5, 0.3, 0.5, 0.4, 0.5, 0.4, 0.4][g % 9]
        rows.append((g, offset + centre))
        rows += [(g, offset + centre + (0.1 if i % 2 else -0.1)) for i in range(per_group - 1)]
    return pd.DataFrame(rows, columns=["treatment", "response"])


def exact_f(table: pd.DataFrame) -> tuple[Fraction, Fraction, Fraction]:
    """(SS between, SS within, F) in rational arithmetic."""
    parts = [[Fraction(v) for v in part["response"]] for _, part in table.groupby("treatment")]
    n = sum(map(len, parts))
    grand = sum(map(sum, parts), Fraction(0)) / n
    means = [sum(part, Fraction(0)) / len(part) for part in parts]
    between = sum((len(part) * (m - grand) ** 2 for part, m in zip(parts, means, strict=True)), Fraction(0))
    within = sum(((v - m) ** 2 for part, m in zip(parts, means, strict=True) for v in part), Fraction(0))
    return between, within, between / (len(parts) - 1) / (within / (n - len(parts)))


@pytest.mark.parametrize(
    ("offset", "per_group"),
    [(1.0, 21), (1.0, 201), (1.0, 2001), (1e6, 21), (1e6, 201), (1e6, 2001), (1e12, 21), (1e12, 201), (1e12, 2001)],
)
def test_oneway_anova_has_twelve_digits_of_the_exact_answer(offset: float, per_group: int) -> None:
    table = nist_like(offset, per_group)
    between, within, f = exact_f(table)
    row = analysis.oneway_anova(table, dv="response", between="treatment").iloc[0]
    assert row["F"] == pytest.approx(float(f), rel=1e-12)
    assert row["ss"] == pytest.approx(float(between), rel=1e-12)
    assert row["ss_error"] == pytest.approx(float(within), rel=1e-12)
    assert row["status"] == "ok"


@pytest.mark.parametrize("offset", [0.0, 1e6, 1e9, 1e12])
def test_rm_anova_equals_the_exact_f_of_a_two_way_layout(offset: float) -> None:
    rng = np.random.default_rng(5)
    y = offset + np.round(rng.normal(size=(9, 4)), 2)
    exact = [[Fraction(v) for v in row] for row in y]
    n, k = 9, 4
    grand = sum(map(sum, exact), Fraction(0)) / (n * k)
    person = [sum(row, Fraction(0)) / k for row in exact]
    level = [sum((row[j] for row in exact), Fraction(0)) / n for j in range(k)]
    ss = n * sum((m - grand) ** 2 for m in level)
    error = sum((exact[i][j] - person[i] - level[j] + grand) ** 2 for i in range(n) for j in range(k))
    f = (ss / (k - 1)) / (error / ((n - 1) * (k - 1)))
    i, j = np.indices(y.shape)
    table = pd.DataFrame({"s": i.ravel(), "c": j.ravel(), "y": y.ravel()})
    assert analysis.rm_anova(table, "y", "c", "s")["F"].iloc[0] == pytest.approx(float(f), rel=1e-11)


@pytest.mark.parametrize(
    "values",
    [
        [10000001.0, 10000003.0, 10000002.0],
        [1000000.2] + [1000000.1, 1000000.3] * 500,
        [10000000.2] + [10000000.1, 10000000.3] * 500,
        [0.1, 0.2, 0.3, 1e-9],
    ],
    ids=["NumAcc1", "NumAcc3", "NumAcc4", "small"],
)
def test_univariate_moments_have_nine_digits_of_the_exact_answer(values: list[float]) -> None:
    exact = [Fraction(v) for v in values]
    n = len(exact)
    mean = sum(exact, Fraction(0)) / n
    ss = sum(((v - mean) ** 2 for v in exact), Fraction(0))
    lag = sum(((a - mean) * (b - mean) for a, b in zip(exact[1:], exact, strict=False)), Fraction(0))
    row = analysis.describe(pd.DataFrame({"y": values}), "y").iloc[0]
    assert row["mean"] == pytest.approx(float(mean), rel=1e-15)
    assert row["sd"] == pytest.approx(float(ss / (n - 1)) ** 0.5, rel=1e-12)
    assert row["autocorrelation"] == pytest.approx(float(lag / ss), rel=1e-9, abs=1e-12)


# NIST StRD Longley (Longley 1967, JASA 62), certified coefficients.
LONGLEY = """83.0 234289 2356 1590 107608 1947 60323
88.5 259426 2325 1456 108632 1948 61122
88.2 258054 3682 1616 109773 1949 60171
89.5 284599 3351 1650 110929 1950 61187
96.2 328975 2099 3099 112075 1951 63221
98.1 346999 1932 3594 113270 1952 63639
99.0 365385 1870 3547 115094 1953 64989
100.0 363112 3578 3350 116219 1954 63761
101.2 397469 2904 3048 117388 1955 66019
104.6 419180 2822 2857 118734 1956 67857
108.4 442769 2936 2798 120445 1957 68169
110.8 444546 4681 2637 121950 1958 66513
112.6 482704 3813 2552 123366 1959 68655
114.2 502601 3931 2514 125368 1960 69564
115.7 518173 4806 2572 127852 1961 69331
116.9 554894 4007 2827 130081 1962 70551"""
CERTIFIED = [
    -3482258.63459582, 15.0618722713733, -0.0358191792925910, -2.02022980381683, -1.03322686717359,
    -0.0511041056535807, 1829.15146461355,
]  # fmt: skip


def test_longley_has_nine_digits_of_the_certified_coefficients() -> None:
    names = ["x1", "x2", "x3", "x4", "x5", "x6", "y"]
    table = pd.DataFrame([[float(v) for v in line.split()] for line in LONGLEY.splitlines()], columns=names)
    made = analysis.linear_mixed(table, "y ~ x1 + x2 + x3 + x4 + x5 + x6")
    assert made["estimate"].tolist() == pytest.approx(CERTIFIED, rel=1e-11)


# (function, how to get the numbers that may not change)
INVARIANTS = {
    "oneway_anova": lambda t: analysis.oneway_anova(t, "rating", "condition")[["F", "p", "eta2", "eta2_low"]],
    "rm_anova": lambda t: analysis.rm_anova(t, "rating", ["condition", "scene"], "participant")[
        ["F", "p", "p_gg", "p_hf", "mauchly_w", "eta2_partial", "eta2_generalized", "eta2_partial_high"]
    ],
    "posthoc_t": lambda t: analysis.posthoc_t(t, "rating", "condition", "participant")[
        ["t", "p", "p_adjusted", "dz", "dz_low", "dz_high"]
    ],
    "aligned_rank_anova": lambda t: analysis.aligned_rank_anova(t, "rating", ["condition", "scene"], "participant")[
        ["F", "p", "eta2_partial"]
    ],
    "friedman": lambda t: analysis.friedman(t, "rating", "condition", "participant")[["chi2", "p", "kendall_w"]],
    "linear_mixed": lambda t: analysis.linear_mixed(t, "rating ~ condition", random="participant").loc[
        1:, ["t", "p", "df"]
    ],
    "cumulative_link": lambda t: analysis.cumulative_link(t, "rating ~ condition").iloc[-2:][["estimate", "z", "p"]],
}
CHANGES = {
    "plus 1e9": lambda t: t.assign(rating=t["rating"] + 1e9),
    "times 1e9": lambda t: t.assign(rating=t["rating"] * 1e9),
    "times 1e-9": lambda t: t.assign(rating=t["rating"] * 1e-9),
    "rows permuted": lambda t: t.sample(frac=1.0, random_state=4).reset_index(drop=True),
    "participants relabelled": lambda t: t.assign(
        participant=t["participant"].map(
            {p: f"x{(i * 7) % 12}" for i, p in enumerate(sorted(t["participant"].unique()))}
        )
    ),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("function", INVARIANTS)
def test_what_may_not_change_does_not(function: str, change: str) -> None:
    table = study()
    before, after = INVARIANTS[function](table), INVARIANTS[function](CHANGES[change](table))
    np.testing.assert_allclose(after.to_numpy(float), before.to_numpy(float), rtol=1e-8, atol=1e-300)


@pytest.mark.parametrize("change", ["plus 1e9", "times 1e9", "times 1e-9"])
def test_wilcoxon_and_tost_do_not_change_with_the_unit(change: str) -> None:
    rng = np.random.default_rng(2)
    x, y = rng.integers(-3, 4, 20).astype(float), rng.integers(-3, 4, 20).astype(float)
    factor, shift = {"plus 1e9": (1.0, 1e9), "times 1e9": (1e9, 0.0), "times 1e-9": (1e-9, 0.0)}[change]
    one, other = analysis.wilcoxon(x, y), analysis.wilcoxon(x * factor + shift, y * factor + shift)
    np.testing.assert_allclose(other[["statistic", "z", "p"]], one[["statistic", "z", "p"]], rtol=1e-8)
    one = analysis.tost(x, y, low=-1.0, high=1.0)
    other = analysis.tost(x * factor + shift, y * factor + shift, low=-factor, high=factor)
    np.testing.assert_allclose(other[["t_low", "t_high", "p"]], one[["t_low", "t_high", "p"]], rtol=1e-8)


@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1e150, 1e300])
def test_f_survives_units_whose_squares_do_not(scale: float) -> None:
    table = study()
    right = analysis.rm_anova(table, "rating", "condition", "participant")["F"].iloc[0]
    made = analysis.rm_anova(table.assign(rating=table["rating"] * scale), "rating", "condition", "participant")
    assert made["F"].iloc[0] == pytest.approx(right, rel=1e-9)
