"""Function by extreme: the statuses of the rows, never a crash, never a nan that says ok. The table is the test."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

import analysis
from analysis.results import STATUSES
from stimuli.errors import InputError
from tests.analysis.extremes import CALLS, EXTREMES, study

# Statuses of each function's rows (o ok, z zero_error_variance, u undefined, s separated, d disconnected,
# n not_converged, b boundary, t too_few_subjects), in the order of EXTREMES.
LETTER = {"o": "ok", "z": "zero_error_variance", "u": "undefined", "s": "separated", "d": "disconnected",
          "n": "not_converged", "b": "boundary", "t": "too_few_subjects"}  # fmt: skip
TABLE = """
oneway_anova            o   u   o   o   o   o   u   o   o   z   o   o   t   t
rm_anova                o   u   uz  u   t   ot  ou  ot  o   uz  o   o   u   t
posthoc_t               o   u   z   u   t   o   u   o   o   z   o   o   u   t
aligned_rank_anova      o   u   uz  u   t   ot  ou  ot  o   uz  o   o   u   t
friedman                o   u   o   u   t   o   u   o   o   o   o   o   u   t
friedman_posthoc        o   u   z   u   t   o   u   o   o   z   z   o   u   t
wilcoxon                o   u   o   u   t   o   u   o   o   o   o   o   u   u
likert_summary          o   o   ou  o   o   o   o   o   o   o   u   o   u   u
describe                o   u   o   o   ou  o   o   o   o   u   o   o   u   u
binomial_choice         o   o   o   o   o   o   o   o   o   o   o   o   u   u
binomial_choice_table   o   z   z   o   t   o   o   o   o   z   o   o   u   u
binomial_mixed          o   s   s   n   t   b   ou  s   o   s   o   ob  u   u
bradley_terry           o   s   o   o   o   o   u   o   o   s   o   o   u   u
bradley_terry_observers o   s   o   o   t   o   u   o   o   s   o   o   u   u
thurstone               o   s   o   o   t   o   u   o   o   s   o   o   u   u
circular_triads         u   u   u   u   u   u   u   u   u   u   u   u   u   u
screen_observers        o   o   o   o   o   o   u   o   o   o   o   o   u   u
cumulative_link         o   u   o   o   s   o   ou  o   o   s   u   o   u   u
cumulative_link_mixed   o   u   n   n   t   b   ou  o   o   s   u   o   u   u
linear_mixed            b   uz  z   uz  t   b   bu  b   b   uz  b   b   u   u
linear                  o   uz  o   o   o   o   ou  o   o   uz  o   o   u   u
psychometric            o   u   s   u   u   o   u   o   o   s   o   o   u   u
tost                    o   z   z   z   t   o   z   o   o   z   o   o   t   t
mcnemar                 o   o   o   o   o   o   o   o   o   o   o   o   u   u
cochran_q               o   u   o   u   t   o   u   o   o   o   o   o   u   t
dprime                  o   b   o   o   o   o   o   o   o   o   o   o   u   u
agreement               o   u   oz  ouz ot  o   t   o   ot  oz  ou  o   t   t
"""
CASES = [
    (line.split()[0], extreme, {LETTER[letter] for letter in letters})
    for line in TABLE.strip().splitlines()
    for extreme, letters in zip(EXTREMES, line.split()[1:], strict=True)
]


@pytest.mark.parametrize(("function", "extreme", "statuses"), CASES, ids=[f"{f}-{e}" for f, e, _ in CASES])
def test_extreme_is_answered_with_its_status(function: str, extreme: str, statuses: set[str]) -> None:
    made = CALLS[function](EXTREMES[extreme]())
    assert set(made["status"]) == statuses
    assert set(made["status"]) <= set(STATUSES)
    assert (made.loc[made["status"] != "ok", "note"] != "").all()
    for column in made.columns.difference(["status", "note"]):
        silent = made[column].map(lambda v: isinstance(v, float) and math.isnan(v)) & (made["status"] == "ok")
        assert not silent.any(), column
    assert {"method", "n_subjects", "dropped"} <= set(made.attrs)


def test_participants_without_a_cell_are_named_with_the_cell() -> None:
    table = EXTREMES["empty_cells"]()
    made = analysis.rm_anova(table, dv="rating", within=["condition", "scene"], subject="participant")
    assert set(made.attrs["dropped"]) == {"p03", "p05"}
    assert "condition=c1" in made.attrs["dropped"]["p03"]
    assert "condition=c2" in made.attrs["dropped"]["p05"]
    assert made.attrs["n_subjects"] == 10
    rest = analysis.rm_anova(
        study()[~study()["participant"].isin(["p03", "p05"])], "rating", ["condition", "scene"], "participant"
    )
    np.testing.assert_allclose(made["F"], rest["F"], rtol=1e-12)


def test_an_unused_category_changes_nothing_but_the_order() -> None:
    plain = analysis.rm_anova(study(), "rating", "condition", "participant")
    unused = analysis.rm_anova(EXTREMES["unused_category"](), "rating", "condition", "participant")
    np.testing.assert_allclose(unused[["F", "p", "eps_gg"]], plain[["F", "p", "eps_gg"]], rtol=1e-12)
    pairs = analysis.posthoc_t(EXTREMES["unused_category"](), "rating", "condition", "participant")
    assert list(zip(pairs["a"], pairs["b"], strict=True)) == [("c2", "c1"), ("c2", "c0"), ("c1", "c0")]


def test_infinite_where_the_error_is_zero_and_zero_where_nothing_differs() -> None:
    made = analysis.posthoc_t(EXTREMES["same_difference"](), "rating", "condition", "participant")
    assert (made["t"] == -math.inf).all()
    assert (made["p"] == 0).all()
    assert (made["log10_p"] == -math.inf).all()
    made = analysis.rm_anova(EXTREMES["same_difference"](), "rating", "condition", "participant").iloc[0]
    assert (made["F"], made["p"], made["eta2_partial"]) == (math.inf, 0.0, 1.0)


def test_two_participants_by_three_levels() -> None:
    """Worked by hand in exact numbers: F = 31, p = 1 / 32, Greenhouse-Geisser 1 / 2."""
    table = pd.DataFrame({"s": [1, 1, 1, 2, 2, 2], "c": list("abc") * 2, "y": [1.0, 4, 6, 2, 4, 8]})
    y = table["y"].to_numpy().reshape(2, 3)
    level, person, grand = y.mean(axis=0), y.mean(axis=1), y.mean()
    error = y - level - person[:, None] + grand
    f = (2 * np.sum((level - grand) ** 2) / 2) / (np.sum(error**2) / 2)
    made = analysis.rm_anova(table, "y", "c", "s").iloc[0]
    assert made["F"] == pytest.approx(f, rel=1e-12)
    assert made["p"] == pytest.approx(1 / (1 + f), rel=1e-12)
    assert made["eps_gg"] == pytest.approx(0.5)
    assert made["status"] == "too_few_subjects"
    assert "Mauchly" in made["note"]


def test_p_far_below_the_smallest_double_has_its_logarithm() -> None:
    table = EXTREMES["huge_effect"]()
    made = analysis.rm_anova(table, "rating", "condition", "participant").iloc[0]
    assert made["p"] == 0
    assert -1e5 < made["log10_p"] < -1000
    assert analysis.binomial_choice(5000, 5000)["log10_p"].iloc[0] == pytest.approx(
        (1 - 5000) * math.log10(2), rel=1e-12
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda t: analysis.rm_anova(t, dv="score", within=["condition"], subject="participant"),
        lambda t: analysis.oneway_anova(t, dv="score", between="condition"),
        lambda t: analysis.posthoc_t(t, dv="score", within="condition", subject="participant"),
        lambda t: analysis.friedman(t, dv="score", within="condition", subject="participant"),
        lambda t: analysis.aligned_rank_anova(t, dv="score", within=["condition"], subject="participant"),
        lambda t: analysis.likert_summary(t, dv="score", by=["condition"]),
        lambda t: analysis.binomial_choice(t, choice="score", observer="participant"),
        lambda t: analysis.binomial_mixed(t, "score ~ condition", random="(1|participant)"),
        lambda t: analysis.bradley_terry(t, winner="score", loser="loser"),
        lambda t: analysis.thurstone(t, winner="score", loser="loser"),
        lambda t: analysis.cumulative_link(t, "score ~ condition"),
        lambda t: analysis.cumulative_link(t, "rating ~ score"),
        lambda t: analysis.linear_mixed(t, "rating ~ condition", random="(1|score)"),
        lambda t: analysis.psychometric(t, x="score", k="rating", n="rating"),
        lambda t: analysis.cochran_q(t, dv="score", within="condition", subject="participant"),
        lambda t: analysis.agreement(t, item="score", rater="participant", rating="rating"),
    ],
)
def test_a_wrong_column_is_a_value_error_that_names_it(call: object) -> None:
    assert callable(call)
    with pytest.raises(ValueError, match="'score'"):
        call(study(n=3))


def test_words_where_numbers_belong_are_named() -> None:
    with pytest.raises(InputError, match="column 'scene'"):
        analysis.rm_anova(study(n=3), dv="scene", within="condition", subject="participant")


def test_a_million_rows() -> None:
    rng = np.random.default_rng(0)
    n = 1_000_000
    table = pd.DataFrame({
        "participant": rng.integers(0, 24, n), "condition": rng.choice(["a", "b", "c", "d"], n),
        "rating": rng.integers(-3, 4, n), "rt_s": rng.normal(size=n), "winner": rng.integers(0, 3, n),
    })  # fmt: skip
    table["loser"] = (table["winner"] + rng.integers(1, 3, n)) % 3
    table["yes"] = table["rating"] > 0
    made = [
        analysis.oneway_anova(table, "rt_s", "condition"),
        analysis.rm_anova(table, "rating", "condition", "participant"),
        analysis.posthoc_t(table, "rating", "condition", "participant"),
        analysis.friedman(table, "rating", "condition", "participant"),
        analysis.aligned_rank_anova(table, "rating", "condition", "participant"),
        analysis.likert_summary(table, "rating", "condition"),
        analysis.binomial_choice(table, choice="yes", observer="participant"),
        analysis.wilcoxon(table["rt_s"][: n // 2], table["rt_s"][n // 2 :]),
        analysis.bradley_terry(table, "winner", "loser", observer="participant"),
        analysis.linear_mixed(table, "rt_s ~ condition", random="participant"),
        analysis.binomial_choice(500_300, n),
    ]
    assert all(set(result["status"]) <= {"ok", "boundary"} for result in made)
