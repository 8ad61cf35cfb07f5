"""Every function against right answers from R 4.2.2, NIST StRD and published tables (where they are to hand)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import analysis


class Reference:
    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def data(self, name: str) -> pd.DataFrame:
        return pd.read_csv(self.folder / "data" / f"{name}.csv")

    def expected(self, name: str) -> Any:
        return json.loads((self.folder / "expected" / f"{name}.json").read_text())["expected"]


@pytest.fixture(scope="module")
def reference(reference_data: Path) -> Reference:
    return Reference(reference_data)


RM_COLUMNS = {
    "df1": "df1", "df2": "df2", "SS": "ss", "SS_error": "ss_error", "F": "F", "p": "p", "log10_p": "log10_p",
    "eps_GG": "eps_gg", "eps_HF": "eps_hf", "p_GG": "p_gg", "p_HF": "p_hf", "mauchly_W": "mauchly_w",
    "mauchly_p": "mauchly_p", "partial_eta2": "eta2_partial", "generalised_eta2": "eta2_generalized",
}  # fmt: skip


@pytest.mark.parametrize(
    ("case", "file", "within", "dv"),
    [("c1_md_12_1", "md_12_1", ["angle", "noise"], "rt"), ("c2_md_11_5", "md_11_5", ["timecat"], "iq")],
)
def test_rm_anova_equals_afex(reference: Reference, case: str, file: str, within: list[str], dv: str) -> None:
    made = analysis.rm_anova(reference.data(file), dv=dv, within=within, subject="id").set_index("effect")
    effects = reference.expected(case)["effects"]
    assert set(made.index) == set(effects)
    for effect, numbers in effects.items():
        for name, column in RM_COLUMNS.items():
            if numbers[name] is not None:
                assert made.loc[effect, column] == pytest.approx(numbers[name], rel=1e-8), (effect, name)


def test_posthoc_t_of_students_sleep_data(reference: Reference) -> None:
    made = analysis.posthoc_t(reference.data("student_sleep"), dv="extra", within="drug", subject="subject").iloc[0]
    right = reference.expected("c8_student_sleep")
    found = [made["t"], made["df"], made["p"], made["mean_diff"], made["ci_low"], made["ci_high"], made["dz"]]
    wanted = [right["t"], right["df"], right["p"], right["mean_diff"], *right["ci95"], right["cohen_dz"]]
    assert found == pytest.approx(wanted, rel=1e-10)


def citations(reference: Reference) -> pd.DataFrame:
    d = reference.data("bt_citations")
    ab = pd.DataFrame({"winner": d["item_a"], "loser": d["item_b"], "count": d["wins_a"]})
    ba = pd.DataFrame({"winner": d["item_b"], "loser": d["item_a"], "count": d["wins_b"]})
    return pd.concat([ab, ba], ignore_index=True)


def test_bradley_terry_of_journal_citations(reference: Reference) -> None:
    right = reference.expected("e1_bt_citations")
    made = analysis.bradley_terry(citations(reference), winner="winner", loser="loser", count="count")
    table = made.set_index("item")
    for item, ability in right["bradley_terry"]["ability_ref0"].items():
        assert table.loc[item, "ability"] == pytest.approx(ability, rel=1e-8)
        assert table.loc[item, "se"] == pytest.approx(right["bradley_terry"]["se_ref0"][item], rel=1e-7)
        assert table.loc[item, "jod"] == pytest.approx(right["bradley_terry"]["jod_ref0"][item], rel=1e-8)
    for ours, theirs in (("log_likelihood", "logLik_binomial"), ("deviance", "deviance"), ("p_gof", "p_gof")):
        assert made.attrs[ours] == pytest.approx(right["bradley_terry"][theirs], rel=1e-8)
    assert made.attrs["df_residual"] == right["bradley_terry"]["df_residual"]
    pairs = analysis.compare_items(made).set_index(["a", "b"])
    for pair in right["bt_pairs"]:
        for ours, theirs in (("diff", "diff"), ("se", "se"), ("z", "z"), ("p", "p"), ("p_adjusted", "p_holm")):
            assert pairs.loc[(pair["a"], pair["b"]), ours] == pytest.approx(pair[theirs], rel=1e-6)


def test_bradley_terry_of_single_rows_equals_that_of_counts(reference: Reference) -> None:
    counted = citations(reference)
    rows = counted.loc[counted.index.repeat(counted["count"])].reset_index(drop=True)
    one = analysis.bradley_terry(rows, winner="winner", loser="loser")
    other = analysis.bradley_terry(counted, winner="winner", loser="loser", count="count")
    np.testing.assert_allclose(one["ability"], other["ability"], rtol=1e-10)


def test_thurstone_by_maximum_likelihood(reference: Reference) -> None:
    right = reference.expected("e1_bt_citations")["thurstone_v_ml"]
    made = analysis.thurstone(citations(reference), winner="winner", loser="loser", count="count").set_index("item")
    for item in right["jod_ref0"]:
        assert made.loc[item, "scale"] == pytest.approx(right["jod_ref0"][item], rel=1e-8)
        assert made.loc[item, "se"] == pytest.approx(right["se_jod_ref0"][item], rel=1e-6)
    assert made.attrs["log_likelihood"] == pytest.approx(right["logLik_binomial"], rel=1e-9)


def test_thurstone_of_guilfords_vegetables(reference: Reference) -> None:
    shares = reference.data("thurstone_vegetables").set_index("item")
    order = pd.CategoricalDtype(list(shares.columns))
    rows = [(c, r, shares.loc[r, c]) for r in shares.index for c in shares.columns if r != c]
    table = pd.DataFrame(rows, columns=["winner", "loser", "count"]).astype({"winner": order, "loser": order})
    made = analysis.thurstone(table, "winner", "loser", count="count", unit="z", method="mean_z").set_index("item")
    for item, value in reference.expected("e3_thurstone_vegetables")["case_v_mean_z"].items():
        assert made.loc[item, "scale"] == pytest.approx(value, rel=1e-8)


@pytest.mark.parametrize(
    ("case", "file", "subject"),
    [("rounding_times", "rounding_times", "runner"), ("likert", "likert_friedman", "subject")],
)
def test_friedman_with_ties_and_its_posthoc_tests(reference: Reference, case: str, file: str, subject: str) -> None:
    right = reference.expected("f1_friedman")[case]
    table = reference.data(file).melt(subject, var_name="condition", value_name="y")
    made = analysis.friedman(table, dv="y", within="condition", subject=subject)
    for ours, theirs in (
        ("chi2", "chi2"), ("df", "df"), ("p", "p"), ("log10_p", "log10_p"), ("kendall_w", "kendall_W"),
        ("iman_davenport_F", "iman_davenport_F"), ("iman_davenport_p", "iman_davenport_p"),
    ):  # fmt: skip
        assert made[ours].iloc[0] == pytest.approx(right[theirs], rel=1e-9)
    assert made.attrs["mean_ranks"] == pytest.approx(right["mean_ranks"])
    pairs = analysis.friedman_posthoc(table, "y", "condition", subject)
    found = {frozenset((r.a, r.b)): r for r in pairs.itertuples()}
    for pair in right["pairs"]:
        row = found[frozenset((pair["a"], pair["b"]))]
        assert [row.conover_t, row.conover_p, row.nemenyi_q] == pytest.approx(
            [pair["conover_t"], pair["conover_p"], pair["nemenyi_q"]], rel=1e-8
        )
        assert row.nemenyi_p == pytest.approx(pair["nemenyi_p"], rel=1e-5)


@pytest.mark.parametrize(
    ("case", "formula", "link"),
    [
        ("logit", "rating ~ temp + contact", "logit"),
        ("probit", "rating ~ temp + contact", "probit"),
        ("interaction", "rating ~ temp * contact", "logit"),
    ],
)
def test_cumulative_link_of_the_wine_data(reference: Reference, case: str, formula: str, link: str) -> None:
    right = reference.expected("g1_clm_wine")[case]
    made = analysis.cumulative_link(reference.data("wine"), formula, link=link).set_index("term")
    assert set(made.index) == set(right["coef"])
    for term, numbers in right["coef"].items():
        for column in ("estimate", "se", "z", "p"):
            assert made.loc[term, column] == pytest.approx(numbers[column], rel=1e-6), (term, column)
    assert made.attrs["log_likelihood"] == pytest.approx(right["logLik"], rel=1e-10)


def test_cumulative_link_mixed_of_the_wine_data(reference: Reference) -> None:
    """Published: Christensen, tutorial on clmm2, adaptive Gauss-Hermite with 10 points."""
    made = analysis.cumulative_link(reference.data("wine"), "rating ~ temp + contact", random="(1|judge)", nodes=10)
    table = made.set_index("term")
    published = {
        "contactyes": (1.8334, 0.5122), "tempwarm": (3.0619, 0.5951), "1|2": (-1.6235, 0.6834),
        "2|3": (1.5128, 0.6044), "3|4": (4.2271, 0.8090), "4|5": (6.0862, 0.9719),
    }  # fmt: skip
    for term, (estimate, se) in published.items():
        assert table.loc[term, "estimate"] == pytest.approx(estimate, abs=6e-5)
        assert table.loc[term, "se"] == pytest.approx(se, abs=6e-5)
    assert made.attrs["log_likelihood"] == pytest.approx(-81.53, abs=0.005)
    laplace = analysis.cumulative_link(reference.data("wine"), "rating ~ temp + contact", random="judge", nodes=1)
    assert laplace.set_index("term").loc["tempwarm", "estimate"] == pytest.approx(3.0630, abs=6e-5)
    assert laplace.attrs["log_likelihood"] == pytest.approx(-81.57, abs=0.005)


def test_profile_intervals_of_the_wine_data(reference: Reference) -> None:
    right = reference.expected("g1_clm_wine")["profile_ci95"]
    made = analysis.cumulative_link(reference.data("wine"), "rating ~ temp + contact", test="likelihood_ratio")
    made = made.set_index("term")
    for term, interval in right.items():
        low, high = interval.values() if isinstance(interval, dict) else interval
        assert tuple(made.loc[term, ["ci_low", "ci_high"]]) == pytest.approx((low, high), rel=1e-4)


@pytest.mark.parametrize("name", ["SiRstv", "SmLs01", "SmLs07"])
def test_oneway_anova_of_nist(reference: Reference, name: str) -> None:
    right = reference.expected("h1_nist_anova")[name]
    row = analysis.oneway_anova(reference.data(f"nist_{name}"), dv="response", between="treatment").iloc[0]
    assert row["F"] == pytest.approx(right["F_exact_on_doubles"], rel=1e-12)
    assert row["ss"] == pytest.approx(right["ss_between_exact_on_doubles"], rel=1e-12)
    assert row["ss_error"] == pytest.approx(right["ss_within_exact_on_doubles"], rel=1e-12)
    assert (row["df1"], row["df2"]) == (right["df_between"], right["df_within"])
    assert row["eta2"] == pytest.approx(right["r_squared"], rel=1e-4)


@pytest.mark.parametrize(("name", "formula"), [("longley", "y ~ x1 + x2 + x3 + x4 + x5 + x6"), ("norris", "y ~ x")])
def test_linear_model_of_nist(reference: Reference, name: str, formula: str) -> None:
    right = reference.expected("i1_nist_linear")[name]
    made = analysis.linear_mixed(reference.data(f"nist_{name}"), formula)
    for row, numbers in zip(made.itertuples(), right["coef"].values(), strict=True):
        assert row.estimate == pytest.approx(numbers["estimate"], rel=1e-9)
        assert row.se == pytest.approx(numbers["se"], rel=1e-9)
    assert made.attrs["sigma"] == pytest.approx(right["residual_sd"], rel=1e-9)
    assert made.attrs["r_squared"] == pytest.approx(right["r_squared"], rel=1e-9)
    assert made.attrs["F"] == pytest.approx(right["F"], rel=1e-9)


def test_adjusted_p_values(reference: Reference) -> None:
    for case in reference.expected("k1_p_adjust").values():
        for method in ("holm", "hochberg", "hommel", "bonferroni", "BH", "BY"):
            made = analysis.adjust_p(case["p"], method)
            np.testing.assert_allclose(made, case[method], rtol=1e-12, err_msg=method)
