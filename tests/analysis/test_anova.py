"""ANOVA, post-hoc tests and effect sizes against independent computations."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import analysis
from analysis import effect_sizes
from analysis.anova import sphericity
from tests.analysis.extremes import study


def mixed_design(sizes: tuple[int, ...], seed: int = 3) -> pd.DataFrame:
    """``sizes[g]`` participants in group g; factors a (2) and b (3) within."""
    rng = np.random.default_rng(seed)
    rows = []
    person = 0
    for g, size in enumerate(sizes):
        for _ in range(size):
            person += 1
            own = rng.normal()
            for a, b in itertools.product(range(2), range(3)):
                rows.append((f"p{person}", f"g{g}", f"a{a}", f"b{b}", own + 0.5 * a + 0.3 * b * g + rng.normal()))
    return pd.DataFrame(rows, columns=["p", "g", "a", "b", "y"])


def test_a_within_factor_of_two_levels_is_a_paired_t_test() -> None:
    table = mixed_design((9,))
    made = analysis.rm_anova(table, "y", ["a"], "p").iloc[0]
    wide = table.groupby(["p", "a"])["y"].mean().unstack()
    t = stats.ttest_rel(wide["a0"], wide["a1"])
    assert made["F"] == pytest.approx(t.statistic**2, rel=1e-12)
    assert made["p"] == pytest.approx(t.pvalue, rel=1e-10)
    assert (made["eps_gg"], made["eps_hf"], made["mauchly_w"], made["mauchly_p"]) == (1, 1, 1, 1)


def test_a_between_factor_is_the_one_way_anova_of_participants_means() -> None:
    table = mixed_design((5, 8, 6))
    made = analysis.rm_anova(table, "y", ["a", "b"], "p", between=["g"]).set_index("effect").loc["g"]
    means = table.groupby(["p", "g"], as_index=False)["y"].mean()
    right = stats.f_oneway(*[part["y"] for _, part in means.groupby("g")])
    assert made["F"] == pytest.approx(right.statistic, rel=1e-11)
    assert (made["df1"], made["df2"]) == (2, 16)
    one = analysis.oneway_anova(means, "y", "g").iloc[0]
    assert one["F"] == pytest.approx(right.statistic, rel=1e-11)
    assert one["log10_p"] == pytest.approx(math.log10(right.pvalue), rel=1e-9)


def test_unbalanced_groups_are_tested_as_type_three() -> None:
    """Each within effect by group is a type III test on contrast scores (here of one contrast: a)."""
    import statsmodels.formula.api as smf
    from statsmodels.stats.anova import anova_lm

    table = mixed_design((4, 7))
    rng = np.random.default_rng(1)
    people = sorted(table["p"].unique())
    table["h"] = table["p"].map(dict(zip(people, rng.choice(["x", "y"], len(people)), strict=True)))
    made = analysis.rm_anova(table, "y", ["a"], "p", between=["g", "h"]).set_index("effect")
    wide = table.groupby(["p", "g", "h", "a"])["y"].mean().unstack().reset_index()
    wide["d"] = (wide["a1"] - wide["a0"]) / math.sqrt(2)
    wide["m"] = (wide["a1"] + wide["a0"]) / math.sqrt(2)
    both = "C(g, Sum):C(h, Sum)"
    of_slope = {"Intercept": "a", "C(g, Sum)": "g:a", "C(h, Sum)": "h:a", both: "g:h:a"}
    of_mean = {"C(g, Sum)": "g", "C(h, Sum)": "h", both: "g:h"}
    for score, effects in (("d", of_slope), ("m", of_mean)):
        right = anova_lm(smf.ols(f"{score} ~ C(g, Sum) * C(h, Sum)", wide).fit(), typ=3)
        for theirs, ours in effects.items():
            assert made.loc[ours, "F"] == pytest.approx(right.loc[theirs, "F"], rel=1e-9), ours


def test_three_within_factors_give_seven_effects_that_share_the_total() -> None:
    rng = np.random.default_rng(8)
    index = np.array(list(itertools.product(range(6), range(2), range(3), range(4))))
    table = pd.DataFrame(index, columns=["p", "a", "b", "c"]).assign(y=rng.normal(size=len(index)))
    made = analysis.rm_anova(table, "y", ["a", "b", "c"], "p")
    assert made["effect"].tolist() == ["a", "b", "c", "a:b", "a:c", "b:c", "a:b:c"]
    total = float(np.sum((table["y"] - table["y"].mean()) ** 2))
    people = 24 * float(np.sum((table.groupby("p")["y"].mean() - table["y"].mean()) ** 2))
    assert made["ss"].sum() + made["ss_error"].sum() + people == pytest.approx(total, rel=1e-12)
    last = made.iloc[-1]
    assert (last["df1"], last["df2"], last["status"]) == (6, 30, "too_few_subjects")
    assert 1 / 6 <= last["eps_gg"] <= 1


def test_epsilons_of_a_spherical_and_of_a_one_dimensional_error() -> None:
    assert sphericity(np.eye(3), 30)["eps_gg"] == pytest.approx(1)
    assert sphericity(np.eye(3), 30)["mauchly_w"] == pytest.approx(1)
    assert sphericity(np.eye(3), 30)["mauchly_p"] == pytest.approx(1)
    flat = sphericity(np.diag([1.0, 0, 0]), 30)
    assert flat["eps_gg"] == pytest.approx(1 / 3)
    assert flat["eps_hf"] == pytest.approx(1 / 3)
    assert flat["mauchly_w"] == 0


def test_repetitions_are_averaged_and_told() -> None:
    table = study()
    averaged = table.groupby(["participant", "condition"], as_index=False)["rating"].mean()
    one = analysis.rm_anova(table, "rating", "condition", "participant")
    other = analysis.rm_anova(averaged, "rating", "condition", "participant")
    np.testing.assert_allclose(one["F"], other["F"], rtol=1e-12)
    assert "up to 4 repetitions a cell averaged" in one.attrs["method"]
    assert "one value a cell" in other.attrs["method"]


@pytest.mark.parametrize("nc", [0.0, 0.7, 12.0, 150.0])
@pytest.mark.parametrize(("f", "df1", "df2"), [(0.3, 1, 9), (2.5, 3, 42), (9.0, 18, 252)])
def test_noncentral_f_where_scipys_is_right(f: float, df1: float, df2: float, nc: float) -> None:
    right = stats.ncf.cdf(f, df1, df2, nc) if nc else stats.f.cdf(f, df1, df2)
    assert effect_sizes.noncentral_f_cdf(f, df1, df2, nc) == pytest.approx(right, abs=1e-12)


@pytest.mark.parametrize("nc", [-3.0, 0.0, 1.5, 8.0])
@pytest.mark.parametrize(("t", "df"), [(-2.0, 5), (0.0, 14), (1.2, 1), (4.3, 14), (9.0, 30), (40.0, 3)])
def test_noncentral_t_where_scipys_is_right(t: float, df: float, nc: float) -> None:
    right = stats.nct.cdf(t, df, nc) if nc else stats.t.cdf(t, df)
    assert effect_sizes.noncentral_t_cdf(t, df, nc) == pytest.approx(right, abs=1e-10)


def test_published_intervals_of_effect_sizes() -> None:
    """The example of the reporting conventions: F(3, 42) = 29.57 and t(14) = -4.29."""
    assert effect_sizes.eta2_interval(29.57, 3, 42) == pytest.approx((0.53, 0.76), abs=0.005)
    assert effect_sizes.dz_interval(-4.29, 15) == pytest.approx((-1.74, -0.45), abs=0.005)


def test_intervals_have_no_nan_far_out_and_are_continuous_there() -> None:
    for f in np.geomspace(1e-12, 1e30, 60):
        low, high = effect_sizes.eta2_interval(float(f), 3, 42)
        assert 0 <= low <= high <= 1
    near, far = effect_sizes.eta2_interval(3.3e6, 3, 42), effect_sizes.eta2_interval(3.4e6, 3, 42)
    assert 1 - near[0] == pytest.approx((1 - far[0]) * 3.4 / 3.3, rel=1e-3)
    for t in np.geomspace(1e-9, 1e20, 40):
        low, high = effect_sizes.dz_interval(float(t), 12)
        assert low < t / math.sqrt(12) < high
    assert effect_sizes.dz_interval(9.9e6, 12)[0] == pytest.approx(
        effect_sizes.dz_interval(1.01e7, 12)[0] * 0.99 / 1.01, rel=1e-4
    )


def test_eta2_interval_excludes_zero_exactly_where_f_rejects_at_five_percent() -> None:
    critical = stats.f.isf(0.05, 2, 28)
    assert effect_sizes.eta2_interval(critical * 1.001, 2, 28)[0] > 0
    assert effect_sizes.eta2_interval(critical * 0.999, 2, 28)[0] == 0


def test_posthoc_adjusts_over_all_pairs_and_keeps_the_direction() -> None:
    table = study(levels=4)
    made = analysis.posthoc_t(table, "rating", "condition", "participant", adjust="holm")
    assert len(made) == 6
    np.testing.assert_allclose(made["p_adjusted"], analysis.adjust_p(made["p"], "holm"), rtol=1e-14)
    wide = table.groupby(["participant", "condition"])["rating"].mean().unstack()
    for row in made.itertuples():
        right = stats.ttest_rel(wide[row.a], wide[row.b])
        interval = right.confidence_interval()
        assert [row.t, row.p, row.ci_low, row.ci_high] == pytest.approx(
            [right.statistic, right.pvalue, interval.low, interval.high], rel=1e-9
        )


def test_aligned_rank_transform_by_its_definition() -> None:
    """Two factors: strip the cell mean, add the effect back, rank, and look only at that effect."""
    table = mixed_design((10,)).astype({"a": "category", "b": "category"})
    made = analysis.aligned_rank_anova(table, "y", ["a", "b"], "p").set_index("effect")
    cell = table.groupby(["a", "b"], observed=True)["y"].transform("mean")
    of_a = table.groupby("a", observed=True)["y"].transform("mean")
    of_b = table.groupby("b", observed=True)["y"].transform("mean")
    grand = table["y"].mean()
    for effect, estimate in (("a", of_a - grand), ("b", of_b - grand), ("a:b", cell - of_a - of_b + grand)):
        aligned = table.assign(r=stats.rankdata(np.round(table["y"] - cell + estimate, 8)))
        right = analysis.rm_anova(aligned, "r", ["a", "b"], "p").set_index("effect").loc[effect]
        assert made.loc[effect, "F"] == pytest.approx(right["F"], rel=1e-10)
        assert made.loc[effect, "df2"] == right["df2"]
