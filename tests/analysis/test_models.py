"""Regression models against brute-force likelihoods, other libraries and the balanced special cases."""

from __future__ import annotations

import math
import re

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm
import statsmodels.formula.api as smf
from scipy import integrate, optimize, special, stats

import analysis
from analysis.formula import model_frame
from stimuli.errors import InputError


def ratings(people: int = 10, trials: int = 16, seed: int = 0) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    who = np.repeat(np.arange(people), trials)
    own = rng.normal(0, 1.2, people)[who]
    c = np.tile(["a", "b"], people * trials // 2)
    latent = 0.9 * (c == "b") + own + rng.logistic(size=len(who))
    return pd.DataFrame(
        {"who": who, "c": c, "r": np.digitize(latent, [-1.0, 0.5, 2.0]), "yes": latent > 0.3, "y": latent}
    )


def test_binomial_mixed_maximises_the_integral_over_participants() -> None:
    """The likelihood by scipy's adaptive integration, participant by participant."""
    table = ratings(people=6, trials=10)
    made = analysis.binomial_mixed(table, "yes ~ c", random="(1|who)")
    parts = [(p["yes"].to_numpy(float), (p["c"] == "b").to_numpy(float)) for _, p in table.groupby("who")]

    def negative(theta: np.ndarray) -> float:
        total = 0.0
        for yes, b in parts:

            def inside(u: float, yes: np.ndarray = yes, b: np.ndarray = b) -> float:
                eta = theta[0] + theta[1] * b + theta[2] * u
                return float(np.prod(special.expit(np.where(yes == 1, eta, -eta))) * stats.norm.pdf(u))

            total += math.log(integrate.quad(inside, -9, 9, epsabs=1e-14)[0])
        return -total

    estimate = np.append(made["estimate"], made.attrs["random_sd"]["who"])
    assert made.attrs["log_likelihood"] == pytest.approx(-negative(estimate), abs=1e-8)
    slopes = optimize.approx_fprime(estimate, negative, 1e-5)
    np.testing.assert_allclose(slopes, 0, atol=2e-4)
    h = 1e-3
    size = 3
    hessian = np.zeros((size, size))
    for i, j in np.ndindex(size, size):
        up, across = h * np.eye(size)[i], h * np.eye(size)[j]
        corners = [(a, b) for a in (1, -1) for b in (1, -1)]
        hessian[i, j] = sum(a * b * negative(estimate + a * up + b * across) for a, b in corners) / (4 * h * h)
    np.testing.assert_allclose(made["se"], np.sqrt(np.diag(np.linalg.inv(hessian)))[:2], rtol=1e-3)


def test_cumulative_link_of_two_categories_is_binomial_with_the_sign_of_its_threshold_turned() -> None:
    table = ratings()
    one = analysis.cumulative_link(table.assign(k=table["yes"].astype(int)), "k ~ c", random="who")
    other = analysis.binomial_mixed(table, "yes ~ c", random="who")
    np.testing.assert_allclose(one["estimate"], other["estimate"] * [-1, 1], rtol=1e-6)
    np.testing.assert_allclose(one["se"], other["se"], rtol=1e-5)
    assert one.attrs["log_likelihood"] == pytest.approx(other.attrs["log_likelihood"], rel=1e-10)


@pytest.mark.parametrize("link", ["logit", "probit"])
def test_binomial_without_random_effects_is_the_generalised_linear_model(link: str) -> None:
    table = ratings().assign(x=lambda t: np.arange(len(t)) % 7 / 3, k=lambda t: t["yes"].astype(int))
    made = analysis.binomial_mixed(table, "k ~ c * x", link=link)
    fit = {"logit": smf.logit, "probit": smf.probit}[link]("k ~ c * x", table).fit(disp=0)
    assert made["term"].tolist() == ["(Intercept)", "cb", "x", "cb:x"]
    np.testing.assert_allclose(made["estimate"], fit.params, rtol=1e-6)
    np.testing.assert_allclose(made["se"], fit.bse, rtol=1e-6)


def test_crossed_random_intercepts_by_laplace_reduce_to_one() -> None:
    """A second grouping without variance changes nothing, and its SD is 0."""
    table = ratings().assign(scene=lambda t: np.arange(len(t)) % 4)
    two = analysis.cumulative_link(table, "r ~ c", random=["(1|who)", "(1|scene)"])
    one = analysis.cumulative_link(table, "r ~ c", random="(1|who)", nodes=1)
    if two.attrs["random_sd"]["scene"] == 0:
        np.testing.assert_allclose(two["estimate"], one["estimate"], atol=2e-3)
    assert two.attrs["log_likelihood"] >= one.attrs["log_likelihood"] - 1e-6


def test_linear_mixed_equals_statsmodels_reml() -> None:
    import warnings

    table = ratings(people=12, trials=20)
    made = analysis.linear_mixed(table, "y ~ c", random="(1|who)")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = smf.mixedlm("y ~ c", table, groups="who").fit(reml=True)
    np.testing.assert_allclose(made["estimate"], fit.fe_params, rtol=1e-6)
    np.testing.assert_allclose(made["se"], fit.bse_fe, rtol=1e-3)
    assert made.attrs["variances"]["residual"] == pytest.approx(fit.scale, rel=1e-4)
    assert made.attrs["log_likelihood"] == pytest.approx(fit.llf, abs=1e-5)


def test_linear_mixed_of_balanced_data_is_the_analysis_of_variance() -> None:
    rng = np.random.default_rng(2)
    i, j = np.indices((11, 4))
    y = rng.normal(size=(11, 1)) * 2 + 0.4 * j + rng.normal(size=(11, 4))
    table = pd.DataFrame({"p": i.ravel(), "c": [f"c{v}" for v in j.ravel()], "y": y.ravel()})
    anova = analysis.rm_anova(table, "y", "c", "p").iloc[0]
    made = analysis.linear_mixed(table, "y ~ c", random="p")
    test = made.attrs["f_tests"][0]
    assert test["F"] == pytest.approx(anova["F"], rel=1e-9)
    assert test["df2"] == pytest.approx(anova["df2"], rel=1e-6)
    assert made["df"][1:].tolist() == pytest.approx([30] * 3, rel=1e-6)
    # Variances by the method of moments, which REML equals in balanced data.
    means = y.mean(axis=1)
    residual = float(np.sum((y - y.mean(axis=0) - means[:, None] + y.mean()) ** 2)) / 30
    between = 4 * float(np.var(means, ddof=1))
    assert made.attrs["variances"]["residual"] == pytest.approx(residual, rel=1e-8)
    assert made.attrs["variances"]["p"] == pytest.approx((between - residual) / 4, rel=1e-7)


@pytest.mark.parametrize("formula", ["y ~ a * b * x", "y ~ x * b * a", "y ~ a * flag + b", "y ~ C(a) * `b b`"])
def test_type_three_tests_average_over_the_other_factors(formula: str) -> None:
    """In unequal cells against statsmodels' type III of deviation coding; treatment coding would test another thing."""
    rng = np.random.default_rng(8)
    a, b, flag = rng.integers(0, 3, 90), rng.integers(0, 2, 90), rng.random(90) < 0.4
    table = pd.DataFrame({"a": [f"a{v}" for v in a], "b": [f"b{v}" for v in b], "x": rng.normal(size=90), "flag": flag})
    table["y"] = a + 2 * a * b + flag + rng.normal(size=90)
    table["b b"] = table["b"]
    theirs = formula.replace("`b b`", "b").replace("C(a)", "a")
    for name in ("a", "b", "flag"):
        theirs = re.sub(rf"\b{name}\b", f"C({name}, Sum)", theirs)
    fit = smf.ols(theirs, table.assign(flag=flag.astype(str))).fit()
    wanted = sm.stats.anova_lm(fit, typ=3).drop(index=["Intercept", "Residual"])
    tests = pd.DataFrame(analysis.linear_mixed(table, formula).attrs["f_tests"])
    np.testing.assert_allclose(np.sort(tests["F"]), np.sort(wanted["F"]), rtol=1e-9)
    np.testing.assert_allclose(np.sort(tests["p"]), np.sort(wanted["PR(>F)"]), rtol=1e-7)
    assert sorted(tests["df1"]) == sorted(wanted["df"])


def test_mixed_type_three_tests_of_balanced_factors_are_the_analysis_of_variance() -> None:
    """The rows of treatment coding are not: they test a factor at the first level of the other."""
    rng = np.random.default_rng(3)
    p, a, b = (v.ravel() for v in np.indices((12, 3, 2)))
    y = rng.normal(size=12)[p] + rng.normal(size=(12, 3))[p, a] + rng.normal(size=(12, 2))[p, b] + 0.5 * a * b
    table = pd.DataFrame({"p": p, "a": [f"a{v}" for v in a], "b": [f"b{v}" for v in b]})
    table["y"] = y + 0.5 * rng.normal(size=len(p))
    made = analysis.linear_mixed(table, "y ~ a * b", random=["(1|p)", "(1|p:a)", "(1|p:b)"])
    assert min(made.attrs["variances"].values()) > 0
    tests = pd.DataFrame(made.attrs["f_tests"]).set_index("term")
    anova = analysis.rm_anova(table, "y", ["a", "b"], "p").set_index("effect")
    np.testing.assert_allclose(tests.loc[anova.index, "F"], anova["F"], rtol=1e-6)
    np.testing.assert_allclose(tests.loc[anova.index, "df2"], anova["df2"], rtol=1e-4)


def test_there_are_no_type_three_tests_where_a_cell_is_missing() -> None:
    table = pd.DataFrame({"a": list("xxyyxx"), "b": list("uvuuuv"), "y": [1.0, 2.0, 4.0, 3.0, 1.5, 2.2]})
    assert analysis.linear_mixed(table, "y ~ a * b").attrs["f_tests"] == []


def test_satterthwaites_df_of_a_between_participants_term() -> None:
    """Balanced groups: the between effect has n - 2 degrees of freedom, the within effect its own."""
    rng = np.random.default_rng(5)
    i, j = np.indices((12, 6))
    y = rng.normal(size=(12, 1)) + rng.normal(size=(12, 6))
    table = pd.DataFrame(
        {"p": i.ravel(), "g": (i.ravel() % 2).astype(str), "c": (j.ravel() % 2).astype(str), "y": y.ravel()}
    )
    made = analysis.linear_mixed(table, "y ~ g + c", random="p").set_index("term")
    assert made.loc["g1", "df"] == pytest.approx(10, rel=1e-5)
    assert made.loc["c1", "df"] == pytest.approx(59, rel=1e-5)


def test_terms_are_named_as_r_names_them() -> None:
    table = pd.DataFrame({"y": [1.0, 2, 3, 4, 5, 6.5], "x": [0.1, 0.5, 0.2, 0.9, 0.4, 0.3]})
    table["f"] = pd.Categorical(list("zyxzyx"), ["z", "y", "x"])
    table["flag"] = [True, False, True, False, True, True]
    assert model_frame("test", table, "y ~ f * x", None).terms == ["(Intercept)", "fy", "fx", "x", "fy:x", "fx:x"]
    assert model_frame("test", table, "y ~ flag", None).terms == ["(Intercept)", "flagTRUE"]
    frame = model_frame("test", table, "y ~ x + (1|f)", None)
    assert [term.name for term in frame.random] == ["f"]
    assert [t.name for t in model_frame("test", table, "y ~ x", "(1|f/flag)").random] == ["f", "f:flag"]
    with pytest.raises(InputError, match="random intercept"):
        model_frame("test", table, "y ~ x", "(x|f)")
    with pytest.raises(InputError, match="formula"):
        model_frame("test", table, "y = x", None)


@pytest.mark.parametrize("link", ["logit", "probit", "cloglog"])
def test_psychometric_equals_the_generalised_linear_model(link: str) -> None:
    x, k, n = np.array([-2.0, -1, 0, 1, 2]), np.array([2, 10, 24, 40, 48]), 50
    links = {
        "logit": sm.families.links.Logit(),
        "probit": sm.families.links.Probit(),
        "cloglog": sm.families.links.CLogLog(),
    }
    fit = sm.GLM(np.column_stack([k, n - k]), sm.add_constant(x), family=sm.families.Binomial(links[link])).fit(
        tol=1e-14
    )
    made = analysis.psychometric(pd.DataFrame({"x": x, "k": k, "n": n}), x="x", k="k", n="n", link=link)
    table = made.set_index("parameter")
    assert table.loc["slope", "estimate"] == pytest.approx(fit.params[1], rel=1e-7)
    assert table.loc["slope", "se"] == pytest.approx(fit.bse[1], rel=1e-5)
    assert table.loc["threshold", "estimate"] == pytest.approx(-fit.params[0] / fit.params[1], rel=1e-7)
    gradient = np.array([-1 / fit.params[1], fit.params[0] / fit.params[1] ** 2])
    se = math.sqrt(gradient @ fit.cov_params() @ gradient)
    assert table.loc["threshold", "se"] == pytest.approx(se, rel=1e-5)
    assert made.attrs["deviance"] == pytest.approx(fit.deviance, rel=1e-7)


@pytest.mark.parametrize("link", ["logit", "probit", "weibull", "cloglog"])
def test_psychometric_recovers_a_function_with_guesses_and_lapses(link: str) -> None:
    x = np.geomspace(0.5, 8, 9)
    z = 1.6 * (np.log(x) - math.log(2.5)) if link == "weibull" else 1.6 * (x - 2.5)
    f = {"logit": special.expit, "probit": special.ndtr}.get(link, lambda v: -np.expm1(-np.exp(v)))(z)
    table = pd.DataFrame({"x": x, "k": 1e6 * (0.5 + 0.48 * f), "n": 1e6})
    made = analysis.psychometric(table, x="x", k="k", n="n", link=link, guess=0.5, lapse=0.02)
    assert made["estimate"].tolist() == pytest.approx([2.5, 1.6], rel=1e-6)
    assert (made["status"] == "ok").all()


@pytest.mark.parametrize(
    ("k", "guess", "status"),
    [
        ([0, 0, 0, 50, 50], 0.0, "separated"),
        ([0, 0, 10, 50, 50], 0.0, "separated"),
        ([25, 25, 25, 50, 50], 0.5, "separated"),
        ([50, 50, 50, 50, 50], 0.5, "undefined"),
        ([50, 40, 20, 10, 1], 0.0, "ok"),
        ([26, 30, 40, 48, 50], 0.5, "ok"),
    ],
)
def test_psychometric_says_where_there_is_no_threshold(k: list[int], guess: float, status: str) -> None:
    table = pd.DataFrame({"x": np.arange(5.0), "k": k, "n": 50})
    assert set(analysis.psychometric(table, x="x", k="k", n="n", guess=guess)["status"]) == {status}


def test_psychometric_jackknife_sees_participants_that_differ() -> None:
    rng = np.random.default_rng(1)
    rows = [(p, x, rng.binomial(40, special.expit(1.5 * (x - own))), 40)
            for p, own in enumerate(rng.normal(0, 1, 12)) for x in (-3.0, -1.5, 0.0, 1.5, 3.0)]  # fmt: skip
    table = pd.DataFrame(rows, columns=["who", "x", "k", "n"])
    alone = analysis.psychometric(table, "x", "k", "n").iloc[0]
    people = analysis.psychometric(table, "x", "k", "n", observer="who").iloc[0]
    assert people["estimate"] == pytest.approx(alone["estimate"], rel=1e-9)
    assert people["se"] > 3 * alone["se"]


def test_likelihood_ratio_of_a_logistic_regression_is_its_deviance() -> None:
    """One two-level factor without random effects: G squared of the 2 x 2 table, in closed form."""
    counts = {("a", 1): 12, ("a", 0): 8, ("b", 1): 5, ("b", 0): 15}
    rows = [(x, y) for (x, y), n in counts.items() for _ in range(n)]
    table = pd.DataFrame(rows, columns=["x", "y"])
    made = analysis.binomial_mixed(table, "y ~ x", test="likelihood_ratio").set_index("term")
    observed = np.array([[12.0, 8.0], [5.0, 15.0]])
    expected = np.outer(observed.sum(axis=1), observed.sum(axis=0)) / observed.sum()
    g2 = 2 * float(np.sum(observed * np.log(observed / expected)))
    assert made.loc["xb", "chi2"] == pytest.approx(g2, rel=1e-8)
    assert made.loc["xb", "p"] == pytest.approx(stats.chi2.sf(g2, 1), rel=1e-8)
    assert 10 ** made.loc["xb", "log10_p"] == pytest.approx(made.loc["xb", "p"], rel=1e-10)


@pytest.mark.parametrize("seed", range(12))
def test_a_search_for_variances_does_not_rest_at_zero_where_more_is_likelier(seed: int) -> None:
    """Balanced: t of a contrast within participants is that of the interaction's mean square, where it is above 0."""
    n, levels, repetitions = 24, 3, 12
    rng = np.random.default_rng(seed)
    own = rng.normal(size=(n, 1, 1)) + 0.5 * rng.normal(size=(n, levels, 1))
    y = own + rng.logistic(size=(n, levels, repetitions))
    who, c, _ = (part.ravel() for part in np.indices(y.shape))
    table = pd.DataFrame({"who": who, "c": np.array(["a", "b", "d"], dtype=object)[c], "y": y.ravel()})
    made = analysis.linear_mixed(table, "y ~ c", random=["(1|who)", "(1|who:c)"])
    cell = y.mean(axis=2)
    left = cell - cell.mean(axis=1, keepdims=True) - cell.mean(axis=0) + cell.mean()
    between = float(np.sum(left**2)) / ((n - 1) * (levels - 1))
    within = float(np.sum((y - cell[:, :, None]) ** 2)) / (n * levels * (repetitions - 1)) / repetitions
    assert made.attrs["variances"]["who:c"] == pytest.approx(max(between - within, 0.0), rel=1e-5, abs=1e-9)
    if between > within:
        t = float(cell[:, 1].mean() - cell[:, 0].mean()) / math.sqrt(2 * between / n)
        assert made["t"].iloc[1] == pytest.approx(t, rel=1e-7)
        assert made["df"].iloc[1] == pytest.approx((n - 1) * (levels - 1), rel=1e-6)
