"""Every function of interfaces.md, called as its table says: the columns, a status in every row, and the attrs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

import analysis
from analysis.results import STATUSES
from tests.analysis.extremes import study

Call = Callable[[pd.DataFrame], pd.DataFrame]
RATED = {"dv": "rating", "within": "condition", "subject": "participant"}


def _levels(t: pd.DataFrame) -> pd.DataFrame:
    x = t["condition"].str[1].astype(float)
    return pd.DataFrame({"level": x, "k": t["yes"].astype(int), "n": 1}).groupby("level", as_index=False).sum()


def _one_each(t: pd.DataFrame) -> pd.DataFrame:
    return t[(t["scene"] == "s0") & (t["repetition"] == 0)]


def _grouped(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(group=np.where(t["participant"] < "p06", "a", "b"))


ANOVA = "effect df1 df2 ss ss_error F p log10_p"
REPEATED = f"{ANOVA} eps_gg eps_hf p_gg p_hf mauchly_w mauchly_p eta2_partial eta2_generalized"
INTERVALS = "eta2_partial_low eta2_partial_high eta2_generalized_low eta2_generalized_high"
TERMS = "term estimate se z p log10_p"
SCALE = "item scale se ci_low ci_high"
CHOICE = "k n share p log10_p exact_low exact_high wilson_low wilson_high"
X, Y = np.array([2.0, 3, 1, 4, 2, 5]), np.array([1.0, 3, 2, 1, 1, 2])

# name, call in the words of interfaces.md, columns
CALLS: list[tuple[str, Call, str]] = [
    ("oneway_anova", lambda t: analysis.oneway_anova(t, dv="rating", between="condition"), f"{ANOVA} eta2"),
    (
        "rm_anova",
        lambda t: analysis.rm_anova(t, dv="rating", within=["condition", "scene"], subject="participant"),
        f"{REPEATED} {INTERVALS}",
    ),
    (
        "rm_anova",
        lambda t: analysis.rm_anova(
            _grouped(t), dv="rating", within=["condition"], subject="participant", between=["group"]
        ),
        REPEATED,
    ),
    (
        "posthoc_t",
        lambda t: analysis.posthoc_t(t, **RATED, adjust="holm"),
        "a b mean_diff ci_low ci_high t df p p_adjusted log10_p dz",
    ),
    (
        "aligned_rank_anova",
        lambda t: analysis.aligned_rank_anova(t, dv="rating", within=["condition", "scene"], subject="participant"),
        "effect df1 df2 F p log10_p",
    ),
    ("friedman", lambda t: analysis.friedman(t, **RATED), "chi2 df p log10_p kendall_w"),
    ("wilcoxon", lambda t: analysis.wilcoxon(X, Y, zeros="pratt", exact=True), "statistic z p log10_p n_used"),
    ("wilcoxon", lambda t: analysis.wilcoxon(X, Y, zeros="wilcox", exact=False), "statistic z p log10_p n_used"),
    (
        "likert_summary",
        lambda t: analysis.likert_summary(t, dv="rating", by=["condition"], scale=(-3, 3)),
        "condition n mean sd median disagree neutral agree",
    ),
    ("binomial_choice", lambda t: analysis.binomial_choice(33, 35, p0=0.5), CHOICE),
    ("binomial_choice", lambda t: analysis.binomial_choice(t, choice="yes", observer="participant", p0=0.5), CHOICE),
    ("binomial_mixed", lambda t: analysis.binomial_mixed(t, "yes ~ condition", random="(1|participant)"), TERMS),
    (
        "bradley_terry",
        lambda t: analysis.bradley_terry(
            t, winner="winner", loser="loser", ties=None, order_effect=False, observer=None
        ),
        "item ability se ci_low ci_high jod",
    ),
    ("thurstone", lambda t: analysis.thurstone(t, winner="winner", loser="loser", unit="jod"), SCALE),
    (
        "thurstone",
        lambda t: analysis.thurstone(t, winner="winner", loser="loser", observer="participant", unit="z", n_boot=100),
        SCALE,
    ),
    (
        "cumulative_link",
        lambda t: analysis.cumulative_link(t, "rating ~ condition", random=None, link="logit"),
        TERMS,
    ),
    (
        "cumulative_link",
        lambda t: analysis.cumulative_link(t, "rating ~ condition", random="(1|participant)", link="probit"),
        TERMS,
    ),
    (
        "linear_mixed",
        lambda t: analysis.linear_mixed(t, "rt_s ~ condition", random="(1|participant)"),
        "term estimate se df t p log10_p",
    ),
    (
        "linear_mixed",
        lambda t: analysis.linear_mixed(t, "rt_s ~ condition", random=["(1|participant)", "(1|scene)"]),
        "term estimate se df t p",
    ),
    (
        "psychometric",
        lambda t: analysis.psychometric(_levels(t), x="level", k="k", n="n", link="logit", guess=0.0, lapse=0.0),
        "parameter estimate se ci_low ci_high",
    ),
    (
        "tost",
        lambda t: analysis.tost(X, Y, low=-1.0, high=1.0),
        "mean_diff ci_low ci_high t_low t_high df p log10_p",
    ),
    ("mcnemar", lambda t: analysis.mcnemar(10, 3, exact=True), "statistic df p log10_p"),
    ("mcnemar", lambda t: analysis.mcnemar(10, 3, exact=False), "statistic df p log10_p"),
    (
        "cochran_q",
        lambda t: analysis.cochran_q(_one_each(t), dv="yes", within="condition", subject="participant"),
        "statistic df p log10_p",
    ),
    ("dprime", lambda t: analysis.dprime(20, 5, 8, 17), "dprime se criterion"),
    ("dprime", lambda t: analysis.dprime(20, 25, m=3), "dprime se criterion"),
    (
        "agreement",
        lambda t: analysis.agreement(_one_each(t), item="condition", rater="participant", rating="rating"),
        "measure value ci_low ci_high",
    ),
]
WITH_SUBJECTS = (
    *("rm_anova", "posthoc_t", "aligned_rank_anova", "friedman", "binomial_mixed", "cochran_q"),
    *("linear_mixed", "agreement"),
)
IDS = [f"{name}-{i}" for i, (name, _, _) in enumerate(CALLS)]


@pytest.mark.parametrize(("name", "call", "columns"), CALLS, ids=IDS)
def test_called_as_the_table_says(name: str, call: Call, columns: str) -> None:
    made = call(study())
    assert isinstance(made, pd.DataFrame)
    assert [column for column in columns.split() if column not in made] == []
    assert set(made["status"]) <= set(STATUSES)
    assert (made.loc[made["status"] != "ok", "note"] != "").all()
    assert made.attrs["method"].strip()
    # 0 where the call names no participants
    assert made.attrs["n_subjects"] >= 0
    if name in WITH_SUBJECTS:
        assert made.attrs["n_subjects"] == 12
    assert "dropped" in made.attrs
    if {"p", "log10_p"} <= set(made):
        known = made["p"] > 1e-300
        np.testing.assert_allclose(np.log10(made.loc[known, "p"]), made.loc[known, "log10_p"], rtol=1e-6, atol=1e-9)


def test_every_name_of_the_interface_is_called_here_and_public() -> None:
    listed = (
        *("rm_anova", "oneway_anova", "posthoc_t", "aligned_rank_anova", "friedman", "wilcoxon", "likert_summary"),
        *("binomial_choice", "binomial_mixed", "bradley_terry", "thurstone", "cumulative_link", "linear_mixed"),
        *("psychometric", "tost", "mcnemar", "cochran_q", "dprime", "agreement"),
    )
    assert {name for name, _, _ in CALLS} == set(listed)
    assert {*listed, "load_sessions", "power", "adjust_p"} <= set(analysis.__all__)


def test_likert_summary_has_a_share_per_category() -> None:
    made = analysis.likert_summary(study(), dv="rating", by=["condition"], scale=(-3, 3))
    shares = [column for column in made if column.startswith("share_")]
    assert len(shares) == 7
    np.testing.assert_allclose(made[shares].sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(made[["disagree", "neutral", "agree"]].sum(axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("observer", [None, "participant"])
def test_the_first_item_is_the_origin(observer: str | None) -> None:
    """First in sorted order, or in the order of a categorical column."""
    table = study()
    for made, value in (
        (analysis.bradley_terry(table, winner="winner", loser="loser", observer=observer), "ability"),
        (analysis.thurstone(table, winner="winner", loser="loser", observer=observer, n_boot=50), "scale"),
    ):
        assert made["item"].iloc[0] == "c0"
        assert made[value].iloc[0] == 0.0
        assert made[value].iloc[1:].ne(0).all()
    order = pd.CategoricalDtype(["c2", "c0", "c1"])
    turned = analysis.bradley_terry(table.astype({"winner": order, "loser": order}), winner="winner", loser="loser")
    assert turned["item"].tolist() == ["c2", "c0", "c1"]
    assert turned["ability"].iloc[0] == 0.0


def test_attrs_of_models_hold_the_likelihood() -> None:
    table = study()
    fit = analysis.bradley_terry(table, winner="winner", loser="loser")
    assert fit.attrs["log_likelihood"] < 0 <= fit.attrs["deviance"]
    assert "separation" in fit.attrs
    assert analysis.cumulative_link(table, "rating ~ condition").attrs["log_likelihood"] < 0


def test_adjust_p_gives_an_array() -> None:
    made = analysis.adjust_p([0.01, np.nan, 0.02], "holm")
    assert isinstance(made, np.ndarray)
    np.testing.assert_allclose(made, [0.02, np.nan, 0.02], rtol=1e-12)


def test_participants_who_were_dropped_are_named_with_the_reason() -> None:
    table = study()
    gone = table[~((table["participant"] == "p03") & (table["condition"] == "c1"))]
    for made in (
        analysis.rm_anova(gone, dv="rating", within=["condition"], subject="participant"),
        analysis.friedman(gone, **RATED),
        analysis.aligned_rank_anova(gone, dv="rating", within=["condition", "scene"], subject="participant"),
    ):
        assert set(made.attrs["dropped"]) == {"p03"}
        assert "c1" in made.attrs["dropped"]["p03"]
