"""Rank tests, choices and categorical tests against enumeration, closed forms and published numbers."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, stats

import analysis
from analysis.detection import proportion_correct
from analysis.plan_tests import RUNNERS
from analysis.planned_test import Plan, Test
from stimuli.errors import InputError


@pytest.mark.parametrize("zeros", ["wilcox", "pratt"])
@pytest.mark.parametrize("seed", range(6))
def test_exact_wilcoxon_equals_the_enumeration_of_all_signs(seed: int, zeros: str) -> None:
    d = np.random.default_rng(seed).integers(-3, 4, 9).astype(float)
    kept = d[d != 0] if zeros == "wilcox" else d
    ranks = stats.rankdata(np.abs(kept))[kept != 0]
    observed = ranks[kept[kept != 0] > 0].sum()
    middle = ranks.sum() / 2
    sums = [
        sum(r for r, s in zip(ranks, signs, strict=True) if s) for signs in itertools.product((0, 1), repeat=len(ranks))
    ]
    exact = np.mean([abs(s - middle) >= abs(observed - middle) - 1e-9 for s in sums])
    made = analysis.wilcoxon(d, np.zeros(9), zeros=zeros, exact=True).iloc[0]
    assert made["p"] == pytest.approx(exact, rel=1e-12)
    assert made["statistic"] == observed


@pytest.mark.parametrize("zeros", ["wilcox", "pratt"])
def test_normal_wilcoxon_equals_scipys(zeros: str) -> None:
    rng = np.random.default_rng(1)
    x, y = rng.integers(-3, 4, 40).astype(float), rng.integers(-3, 4, 40).astype(float)
    right = stats.wilcoxon(x, y, zero_method=zeros, method="approx", correction=False)
    made = analysis.wilcoxon(x, y, zeros=zeros, exact=False).iloc[0]
    assert made["p"] == pytest.approx(right.pvalue, rel=1e-11)
    assert abs(made["z"]) == pytest.approx(abs(right.zstatistic), rel=1e-11)


def test_wilcoxon_refuses_unequal_lengths_and_unknown_options() -> None:
    with pytest.raises(InputError, match="wilcoxon: y"):
        analysis.wilcoxon([1.0, 2.0], [1.0])
    with pytest.raises(InputError, match="zeros"):
        analysis.wilcoxon([1.0, 2.0], [1.0, 3.0], zeros="drop")


def test_thirty_three_of_thirty_five() -> None:
    """33 of 35: R's binom.test and Wilson's interval."""
    made = analysis.binomial_choice(33, 35).iloc[0]
    right = stats.binomtest(33, 35)
    exact, wilson = right.proportion_ci(method="exact"), right.proportion_ci(method="wilson")
    assert [made["p"], made["exact_low"], made["exact_high"]] == pytest.approx(
        [right.pvalue, exact.low, exact.high], rel=1e-9
    )
    assert [made["wilson_low"], made["wilson_high"]] == pytest.approx([wilson.low, wilson.high], rel=1e-9)
    all_of_them = analysis.binomial_choice(35, 35).iloc[0]
    assert (all_of_them["exact_high"], all_of_them["wilson_high"]) == (1.0, 1.0)


def test_one_answer_a_participant_is_the_test_on_counts() -> None:
    table = pd.DataFrame({"who": range(35), "yes": [True] * 33 + [False] * 2})
    by_table = analysis.binomial_choice(table, choice="yes", observer="who").iloc[0]
    by_counts = analysis.binomial_choice(33, 35).iloc[0]
    for column in ("k", "n", "share", "p", "exact_low", "wilson_high"):
        assert by_table[column] == pytest.approx(by_counts[column], rel=1e-12)


def test_more_trials_of_the_same_people_are_not_more_people() -> None:
    rng = np.random.default_rng(4)
    share = rng.uniform(0.3, 0.9, 12)
    table = pd.DataFrame({"who": np.repeat(range(12), 50), "yes": rng.random(600) < np.repeat(share, 50)})
    made = analysis.binomial_choice(table, choice="yes", observer="who")
    means = table.groupby("who")["yes"].mean()
    assert made["p"].iloc[0] == pytest.approx(stats.ttest_1samp(means, 0.5).pvalue, rel=1e-10)
    assert made["n"].iloc[0] == 12
    pooled = made.attrs["pooled, not for inference"]
    assert (pooled["k"], pooled["n"]) == (int(table["yes"].sum()), 600)
    assert made["p"].iloc[0] > analysis.binomial_choice(pooled["k"], pooled["n"])["p"].iloc[0]


def test_likert_shares_add_up_and_neutral_is_the_middle() -> None:
    table = pd.DataFrame({"c": ["a"] * 5 + ["b"] * 3, "r": [-3, -1, 0, 2, 9, 3, 3, math.nan]})
    made = analysis.likert_summary(table, dv="r", by=["c"]).set_index("c")
    assert made.loc["a", ["n", "mean", "median"]].tolist() == [4, -0.5, -0.5]
    assert made.loc["a", ["disagree", "neutral", "agree"]].tolist() == [0.5, 0.25, 0.25]
    assert made.loc["b", "share_3"] == 1
    shares = made[[f"share_{c}" for c in range(-3, 4)]].sum(axis=1)
    np.testing.assert_allclose(shares, 1.0)
    assert set(made.attrs["dropped"]) == {"off_scale", "missing"}
    even = analysis.likert_summary(table, dv="r", by="c", scale=(0, 3))
    assert (even["neutral"] == 0).all()


def test_friedman_with_two_levels_is_cochrans_q_and_mcnemars_chi2() -> None:
    rng = np.random.default_rng(6)
    a, b = rng.integers(0, 2, 30), rng.integers(0, 2, 30)
    table = pd.DataFrame({"who": np.tile(range(30), 2), "c": ["a"] * 30 + ["b"] * 30, "yes": np.concatenate([a, b])})
    q = analysis.cochran_q(table, dv="yes", within="c", subject="who").iloc[0]
    f = analysis.friedman(table, dv="yes", within="c", subject="who").iloc[0]
    m = analysis.mcnemar(int(((a == 1) & (b == 0)).sum()), int(((a == 0) & (b == 1)).sum()), exact=False).iloc[0]
    assert q["statistic"] == pytest.approx(m["statistic"], rel=1e-12)
    assert f["chi2"] == pytest.approx(m["statistic"], rel=1e-12)
    assert q["p"] == pytest.approx(m["p"], rel=1e-12)


def test_mcnemar_of_agrestis_approval_ratings() -> None:
    """Agresti (1990) p. 350: 150 and 86 of 1,600 changed their mind: z^2 = (86 - 150)^2 / 236."""
    plain = analysis.mcnemar(86, 150, exact=False).iloc[0]
    assert plain["statistic"] == pytest.approx(64**2 / 236, rel=1e-13)
    corrected = analysis.mcnemar(86, 150, exact=False, correction=True).iloc[0]
    assert corrected["statistic"] == pytest.approx(63**2 / 236, rel=1e-13)
    exact = analysis.mcnemar(86, 150).iloc[0]
    assert exact["p"] == pytest.approx(stats.binomtest(86, 236).pvalue, rel=1e-12)


def test_dprime_of_detection_and_of_choice() -> None:
    made = analysis.dprime(80, 20, 30, 70).iloc[0]
    assert made["dprime"] == pytest.approx(stats.norm.ppf(0.8) - stats.norm.ppf(0.3), rel=1e-12)
    assert made["criterion"] == pytest.approx(-(stats.norm.ppf(0.8) + stats.norm.ppf(0.3)) / 2, rel=1e-12)
    assert analysis.dprime(80, 100)["dprime"].iloc[0] == pytest.approx(math.sqrt(2) * stats.norm.ppf(0.8), rel=1e-12)
    # Hacker & Ratcliff (1979), table: share correct .80 of four alternatives: d' = 1.89.
    assert analysis.dprime(80, 100, m=4)["dprime"].iloc[0] == pytest.approx(1.89, abs=0.005)
    assert analysis.dprime(80, 100, 4)["dprime"].iloc[0] == pytest.approx(1.89, abs=0.005)
    assert analysis.dprime(25, 100, m=4)["dprime"].iloc[0] == pytest.approx(0, abs=1e-9)
    assert analysis.dprime(100, 0, 3, 97)["dprime"].iloc[0] == math.inf
    bounded = analysis.dprime(100, 0, 3, 97, correction="loglinear").iloc[0]
    assert math.isfinite(bounded["dprime"])
    assert bounded["status"] == "ok"


def test_tost_is_two_one_sided_t_tests() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=15), rng.normal(size=15)
    made = analysis.tost(x, y, low=-1.0, high=1.0).iloc[0]
    low = stats.ttest_1samp(x - y, -1.0, alternative="greater")
    high = stats.ttest_1samp(x - y, 1.0, alternative="less")
    assert [made["t_low"], made["t_high"]] == pytest.approx([low.statistic, high.statistic], rel=1e-11)
    assert made["p"] == pytest.approx(max(low.pvalue, high.pvalue), rel=1e-10)
    interval = stats.ttest_1samp(x - y, 0.0).confidence_interval(0.90)
    assert [made["ci_low"], made["ci_high"]] == pytest.approx([interval.low, interval.high], rel=1e-10)


def test_a_nan_p_stays_out_of_the_family() -> None:
    np.testing.assert_allclose(analysis.adjust_p([0.01, math.nan, 0.02], "holm"), [0.02, math.nan, 0.02])
    np.testing.assert_array_equal(analysis.adjust_p([0.01, 0.2], "fdr_bh"), analysis.adjust_p([0.01, 0.2], "BH"))
    with pytest.raises(InputError, match="method"):
        analysis.adjust_p([0.1], "sidak")


def test_icc_of_shrout_and_fleiss() -> None:
    """Shrout & Fleiss (1979), tables 2 and 4: .17 .29 .71 .44 .62 .91."""
    scores = [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]]
    table = pd.DataFrame(
        [(i, j, v) for i, row in enumerate(scores) for j, v in enumerate(row)], columns=["i", "j", "v"]
    )
    made = analysis.agreement(table, item="i", rater="j", rating="v", n_boot=200).set_index("measure")
    published = {"ICC1": 0.17, "ICC2": 0.29, "ICC3": 0.71, "ICC1k": 0.44, "ICC2k": 0.62, "ICC3k": 0.91}
    for name, value in published.items():
        assert made.loc[name, "value"] == pytest.approx(value, abs=0.005)
    # psych::ICC: intervals of the single-rater forms.
    for name, low, high in (("ICC1", -0.13, 0.72), ("ICC2", 0.019, 0.76), ("ICC3", 0.34, 0.95)):
        assert made.loc[name, ["ci_low", "ci_high"]].tolist() == pytest.approx([low, high], abs=0.005)


def test_alpha_of_krippendorffs_example() -> None:
    """Krippendorff (2011), computing alpha, section C and after: nominal .743, ordinal .815, interval .849."""
    rows = {
        "A": "1 2 3 3 2 1 4 1 2 . . .", "B": "1 2 3 3 2 2 4 1 2 5 . 3",
        "C": ". 3 3 3 2 3 4 2 2 5 1 .", "D": "1 2 3 3 2 4 4 1 2 5 1 .",
    }  # fmt: skip
    table = pd.DataFrame(
        [(r, i, float(v)) for r, line in rows.items() for i, v in enumerate(line.split()) if v != "."],
        columns=["rater", "item", "v"],
    )
    made = analysis.agreement(table, item="item", rater="rater", rating="v", n_boot=200).set_index("measure")
    for name, value in (("alpha_nominal", 0.743), ("alpha_ordinal", 0.815), ("alpha_interval", 0.849)):
        assert made.loc[name, "value"] == pytest.approx(value, abs=0.0006)


def test_weiers_fixation_effect_used_a_pooled_error() -> None:
    """Weier et al. (2016): F = 3.46, p = .03; not with participants as the unit, but with trials pooled."""
    assert not analysis.check_reported("3.46", (2, 28), ".03")["consistent"].iloc[0]
    assert analysis.check_reported("3.46", (2, 1392), ".03")["consistent"].iloc[0]
    assert analysis.check_reported("2.20", 15, "<.05", kind="t")["consistent"].iloc[0]


@pytest.mark.parametrize("m", [3, 4, 8, 100])
@pytest.mark.parametrize("d", [-0.7, 0.5, 2.0, 4.0])
def test_share_correct_of_m_is_that_the_right_evidence_is_the_largest(m: int, d: float) -> None:
    right = integrate.quad(lambda z: stats.norm.pdf(z - d) * stats.norm.cdf(z) ** (m - 1), -12, 16, epsabs=1e-13)[0]
    assert proportion_correct(d, m) == pytest.approx(right, rel=1e-9)


def test_planned_dprime_and_chance_follow_the_number_of_pictures() -> None:
    plan = Plan((), 0.05, "holm", True)
    rows = [(who, float(k < right)) for who, right in (("x", 15), ("y", 12)) for k in range(20)]
    two = pd.DataFrame(rows, columns=["participant", "right"]).assign(condition="a|b", kind="forced_choice")
    four = two.assign(condition="a|b|c|c")
    test = Test("t", "dprime", dv="correct")
    for own, m in ((two, 2), (four, 4)):
        made = RUNNERS["dprime"](own, "right", test, plan)
        np.testing.assert_allclose(made["dprime"], analysis.dprime([15, 12], [20, 20], m=m)["dprime"])
        assert made["m"].tolist() == [m, m]
        chosen = RUNNERS["binomial_choice"](own, "right", replace(test, test="binomial_choice"), plan)
        assert chosen.attrs["p0"] == 1 / m
    both = pd.concat([two, four])
    assert RUNNERS["dprime"](both, "right", test, plan)["m"].tolist() == [2, 2, 4, 4]
    with pytest.raises(InputError, match="2 and 4 pictures"):
        RUNNERS["binomial_choice"](both, "right", replace(test, test="binomial_choice"), plan)
    with pytest.raises(InputError, match="one picture"):
        RUNNERS["dprime"](two.assign(condition="a"), "right", test, plan)
    matching = RUNNERS["dprime"](two.assign(kind="side_by_side"), "right", test, plan)
    assert "matching task" in matching.attrs["method"]
