"""Tests whose unit is the participant, and one-sided profile likelihoods, against closed forms and t tests."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy import special, stats

import analysis
from analysis.apa import sentences
from analysis.participant_score import ParticipantScore
from analysis.planned_test import Result, Test
from analysis.threshold_bounds import Bounds, point_terms, point_values
from analysis.threshold_model import Quadrature, fit_fixed, fit_mixed
from stimuli.errors import InputError


def answers(counts: list[int], of: int) -> pd.DataFrame:
    """``counts[i]`` of ``of`` answers of participant i are true."""
    yes = [k < count for count in counts for k in range(of)]
    return pd.DataFrame({"who": np.repeat(np.arange(len(counts)), of), "yes": yes})


def intercepts(counts: list[int], of: int) -> tuple[Bounds, np.ndarray]:
    table = answers(counts, of)
    one, x = table["yes"].to_numpy(), np.ones((len(table), 1))
    upper, lower = np.where(one[:, None], 0.0, -x), np.where(one[:, None], -x, 0.0)
    bounds = Bounds(upper, lower, one, ~one, np.ones(len(one)), np.zeros((len(one), 2)))
    return bounds, table["who"].to_numpy()


def test_where_participants_are_alike_it_is_the_t_test_of_their_shares() -> None:
    counts = [5, 6, 7, 6, 5, 7, 8, 6, 7, 9]
    made = analysis.binomial_mixed(answers(counts, 12), "yes ~ 1", random="who")
    assert made.attrs["random_sd"]["who"] == 0
    right = stats.ttest_1samp(np.array(counts) / 12, 0.5)
    row = made.iloc[0]
    assert (row["t"], row["df"]) == (pytest.approx(right.statistic, rel=1e-9), 9)
    assert row["p"] == pytest.approx(right.pvalue, rel=1e-9)
    # the interval is the shares' own: the logits of what their t test does not reject, no closed form but its ends do
    for end in ("ci_low", "ci_high"):
        share = float(special.expit(row[end]))
        assert stats.ttest_1samp(np.array(counts) / 12, share).pvalue == pytest.approx(0.05, abs=0.01)


def test_scores_and_information_are_the_derivatives_of_the_likelihood() -> None:
    bounds, groups = intercepts([1, 9, 5, 11, 6, 3], 12)
    quadrature = Quadrature(bounds, groups, "logit", 21)
    phi, sd, h = np.array([0.3]), 0.9, 1e-4
    _, scores, information = quadrature.expansion(phi, sd)
    np.testing.assert_allclose(scores.sum(axis=0), quadrature.evaluate(phi, sd)[1], rtol=1e-10)
    by_sd = (quadrature.evaluate(phi, sd + h)[1] - quadrature.evaluate(phi, sd - h)[1]) / (2 * h)
    by_phi = (quadrature.evaluate(phi + h, sd)[1] - quadrature.evaluate(phi - h, sd)[1]) / (2 * h)
    np.testing.assert_allclose(-information, np.stack([by_phi, by_sd]), rtol=1e-6)


def test_a_grid_and_nodes_about_the_mode_agree_where_both_are_good() -> None:
    bounds, groups = intercepts([1, 9, 5, 11, 6, 3], 12)
    near = Quadrature(bounds, groups, "logit", 41).evaluate(np.array([0.3]), 1.2)[0]
    assert Quadrature(bounds, groups, "logit", 41, wide=True).evaluate(np.array([0.3]), 1.2)[0] == pytest.approx(near)


@pytest.mark.parametrize("nodes", [5, 9, 15])
def test_few_nodes_find_the_same_interval(nodes: int) -> None:
    """A search for the highest value by 9 nodes that move found no end here, and the interval was (-2.3, 3.1)."""
    counts = [5, 12, 3, 4, 2, 11, 6, 6, 12, 1, 4, 6]
    few, many = (analysis.binomial_mixed(answers(counts, 12), "yes ~ 1", "who", nodes=n).iloc[0] for n in (nodes, 41))
    assert few["t"] == pytest.approx(many["t"], rel=0.02)
    for end, right in (("ci_low", -1.067), ("ci_high", 1.862)):
        assert many[end] == pytest.approx(right, abs=1e-3)
        assert few[end] == pytest.approx(many[end], rel=0.05)


def test_a_step_is_judged_by_the_nodes_that_gave_it() -> None:
    bounds, groups = intercepts([1, 9, 5, 11, 6, 12], 12)
    quadrature = Quadrature(bounds, groups, "logit", 5)
    phi, sd, h = np.array([0.3]), 1.7, 1e-5
    nodes = quadrature.nodes(phi, sd)
    value, scores, _ = quadrature.expansion(phi, sd, nodes)
    assert quadrature.value(phi, sd, nodes) == pytest.approx(value, rel=1e-14)
    by_phi = (quadrature.value(phi + h, sd, nodes) - quadrature.value(phi - h, sd, nodes)) / (2 * h)
    by_sd = (quadrature.value(phi, sd + h, nodes) - quadrature.value(phi, sd - h, nodes)) / (2 * h)
    np.testing.assert_allclose(scores.sum(axis=0), [by_phi, by_sd], rtol=1e-6)


def test_the_ends_of_the_interval_are_just_rejected() -> None:
    bounds, groups = intercepts([2, 9, 5, 11, 7, 8, 10, 4], 12)
    fit = fit_mixed(bounds, groups, fit_fixed(bounds, np.zeros(1), "logit"), "logit", 21, 0)
    score = ParticipantScore(bounds, groups, fit, "logit", 21, 0)
    found = score.test(0, 0.95)
    assert found.ci_low < fit.phi[0] < found.ci_high
    cut = stats.t.isf(0.025, 7)
    assert [score.statistic(0, found.ci_low), score.statistic(0, found.ci_high)] == pytest.approx([cut, -cut], rel=1e-5)


def test_turned_answers_turn_the_interval_and_the_order_of_rows_is_nothing() -> None:
    table = answers([2, 9, 5, 11, 7, 8, 10, 4], 12)
    made = analysis.binomial_mixed(table, "yes ~ 1", random="who").iloc[0]
    turned = analysis.binomial_mixed(table.assign(yes=~table["yes"]), "yes ~ 1", random="who").iloc[0]
    assert (turned["ci_low"], turned["ci_high"]) == pytest.approx((-made["ci_high"], -made["ci_low"]), rel=1e-6)
    mixed = table.sample(frac=1, random_state=3).assign(who=lambda t: "p" + (7 - t["who"]).astype(str))
    again = analysis.binomial_mixed(mixed, "yes ~ 1", random="who").iloc[0]
    for column in ("t", "p", "ci_low", "ci_high"):
        assert again[column] == pytest.approx(made[column], rel=1e-8), column


def test_participants_who_differ_in_an_effect_do_not_make_it_significant() -> None:
    """Half lean strongly one way, half the other: Wald's error is of the trials, this one's of the participants."""
    rng = np.random.default_rng(5)
    who, c, _ = (part.ravel() for part in np.indices((12, 2, 30)))
    lean = np.where(who % 2 == 0, 2.0, -1.2)
    rating = np.digitize(lean * (c - 0.5) + rng.logistic(size=len(who)), [-1.0, 0.0, 1.0])
    table = pd.DataFrame({"who": who, "c": np.array(["a", "b"], dtype=object)[c], "rating": rating})
    wald = analysis.cumulative_link(table, "rating ~ c", random="who").iloc[-1]
    made = analysis.cumulative_link(table, "rating ~ c", random="who", test="participants").iloc[-1]
    means = table.groupby(["who", "c"])["rating"].mean().unstack()
    paired = stats.ttest_rel(means["b"], means["a"])
    assert wald["p"] < 0.05 < made["p"]
    assert made["p"] == pytest.approx(paired.pvalue, abs=0.05)
    assert made["df"] == 11


def test_a_difference_between_participants_leaves_fewer_degrees_of_freedom() -> None:
    table = answers([2, 9, 5, 11, 7, 8, 10, 4], 12).assign(group=lambda t: np.where(t["who"] < 4, "g1", "g2"))
    made = analysis.binomial_mixed(table, "yes ~ group", random="who")
    assert made["df"].tolist() == [6, 6]


def test_separated_answers_have_one_end() -> None:
    """All of 144 say yes: the profile, without a variance among participants, is n log p = -chi2 / 2."""
    row = analysis.binomial_mixed(answers([12] * 12, 12), "yes ~ 1", random="who").iloc[0]
    assert (row["status"], row["estimate"], row["ci_high"]) == ("separated", math.inf, math.inf)
    lowest = math.exp(-stats.chi2.isf(0.05, 1) / 2 / 144)
    assert row["ci_low"] == pytest.approx(math.log(lowest / (1 - lowest)), rel=1e-4)


def test_an_interval_that_does_not_close_says_so() -> None:
    """Eleven of twelve always say yes: any larger value fits."""
    row = analysis.binomial_mixed(answers([12] * 11 + [6], 12), "yes ~ 1", random="who").iloc[0]
    assert (row["status"], row["ci_high"]) == ("boundary", math.inf)
    assert "above" in row["note"]
    assert 0 < row["ci_low"] < row["estimate"]
    assert row["p"] < 1e-4


def test_equal_participants_have_no_error() -> None:
    alike = analysis.binomial_mixed(answers([8] * 6, 12), "yes ~ 1", random="who").iloc[0]
    assert (alike["status"], alike["p"], alike["log10_p"]) == ("zero_error_variance", 0.0, -math.inf)
    level = analysis.binomial_mixed(answers([6] * 6, 12), "yes ~ 1", random="who").iloc[0]
    assert level["status"] == "undefined"


def test_a_test_by_participants_needs_their_random_intercept() -> None:
    table = answers([2, 9, 5], 12)
    with pytest.raises(InputError, match="one random intercept"):
        analysis.binomial_mixed(table, "yes ~ 1", test="participants")
    with pytest.raises(InputError, match="test"):
        analysis.binomial_mixed(table, "yes ~ 1", test="score")


def test_sentences_name_the_statistic_that_p_comes_from() -> None:
    def said(**options: str) -> str:
        table = analysis.binomial_mixed(answers([2, 9, 5, 11, 7, 8, 10, 4], 12), "yes ~ 1", random="who", **options)
        return sentences(Result(Test("choice", "binomial_mixed"), table, "", 8))[0]

    assert "t(7) = " in said()
    assert "95% CI [" in said()
    assert "χ²(1) = " in said(test="likelihood_ratio")
    assert "z = " in said(test="wald")


def test_a_variance_of_zero_still_gives_its_numbers() -> None:
    table = analysis.binomial_mixed(answers([5, 6, 7, 6, 5, 7, 8, 6], 12), "yes ~ 1", random="who")
    text = sentences(Result(Test("choice", "binomial_mixed"), table, "", 8))[0]
    assert "t(7) = " in text
    assert "estimated as 0" in text


@pytest.mark.parametrize("link", ["logit", "probit", "cloglog"])
def test_an_infinite_bound_is_certain_and_its_slope_nothing(link: str) -> None:
    far, near = np.array([1e9, 0.3]), np.array([0.2, -1e9])
    none, all_ = np.zeros(2, dtype=bool), np.ones(2, dtype=bool)
    terms = point_terms(far, near, all_, all_, link)
    assert all((part == 0).all() for part in terms)
    # where a bound is far but finite the derivatives are those of the other one alone
    value, ga, gb, *_ = point_terms(np.array([0.3, 0.3]), np.array([-1e9, 0.0]), none, np.array([False, True]), link)
    np.testing.assert_allclose((value[0], ga[0], gb[0]), (value[1], ga[1], gb[1]), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(
        point_values(far, near, all_, none, link), point_terms(far, near, all_, none, link)[0]
    )
