"""Terms of several coefficients tested together, the participant as the unit."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import analysis


def answers(people: int, repetitions: int = 3, effect: float = 0.6, own_sd: float = 0.5, seed: int = 0) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    p, t, s, _ = (v.ravel() for v in np.indices((people, 3, 2, repetitions)))
    latent = rng.normal(size=people)[p] + own_sd * rng.normal(size=(people, 3))[p, t] + effect * t * (1 + s)
    latent = latent + rng.logistic(size=len(p))
    return pd.DataFrame({
        "who": p, "tech": np.array(["a", "b", "c"])[t], "scene": np.array(["x", "y"])[s],
        "group": np.array(["g", "h"])[p % 2], "rating": np.digitize(latent, [-1, 0, 1, 2]), "yes": latent > 0.7,
    })  # fmt: skip


def f_tests(table: pd.DataFrame, formula: str, **options: object) -> pd.DataFrame:
    fit = analysis.binomial_mixed if formula.startswith("yes") else analysis.cumulative_link
    made = fit(table, formula, random="who", test="participants", **options)  # type: ignore[operator]
    return pd.DataFrame(made.attrs["f_tests"], columns=["term", "df1", "df2", "F", "p", "log10_p"]).set_index("term")


@pytest.mark.parametrize("response", ["rating", "yes"])
def test_the_order_of_levels_says_nothing(response: str) -> None:
    table = answers(14)
    renamed = table.replace({"tech": {"a": "z"}, "scene": {"x": "zz"}, "group": {"g": "zzz"}})
    for formula in (f"{response} ~ tech * scene", f"{response} ~ tech * group + scene"):
        one, other = f_tests(table, formula), f_tests(renamed, formula)
        assert {"tech", "scene"} <= set(one.index)
        pd.testing.assert_frame_equal(one, other, rtol=1e-5)


def test_one_coefficient_is_its_own_t_squared() -> None:
    table = answers(11)
    table["first"], table["second"] = table["tech"] == "b", table["tech"] == "c"
    table["y"] = np.where(table["scene"] == "y", 0.5, -0.5)
    made = analysis.cumulative_link(table, "rating ~ tech + y", random="who", test="participants")
    together = pd.DataFrame(made.attrs["f_tests"]).set_index("term").loc["y"]
    single = made.set_index("term").loc["y"]
    assert (together["df1"], together["df2"]) == (1, single["df"])
    assert together["F"] == pytest.approx(single["t"] ** 2, rel=1e-6)
    assert together["p"] == pytest.approx(single["p"], rel=1e-6)


def test_many_participants_who_do_not_differ_get_the_likelihood_ratio() -> None:
    table = answers(300, own_sd=0.0, effect=0.12, seed=3)
    whole = analysis.cumulative_link(table, "rating ~ tech", random="who", test="participants")
    without = analysis.cumulative_link(table, "rating ~ 1", random="who")
    ratio = 2 * (whole.attrs["log_likelihood"] - without.attrs["log_likelihood"])
    test = whole.attrs["f_tests"][0]
    assert (test["df1"], test["df2"]) == (2, 298)
    assert 2 * test["F"] == pytest.approx(ratio, rel=0.15)
    assert ratio > stats.chi2.isf(0.05, 2)


def test_terms_between_participants_have_their_degrees_of_freedom() -> None:
    found = f_tests(answers(12), "rating ~ tech * group")
    assert found["df1"].to_dict() == {"tech": 2, "group": 1, "tech:group": 2}
    assert found["df2"].to_dict() == {"tech": 10, "group": 10, "tech:group": 10}


def test_what_participants_are_too_few_for_is_not_told() -> None:
    assert f_tests(answers(2), "rating ~ tech").empty
    assert f_tests(answers(3, seed=1), "rating ~ tech")["df2"].tolist() == [1]


def test_a_term_of_one_coefficient_is_told_once() -> None:
    assert f_tests(answers(10), "rating ~ scene").empty
    assert f_tests(answers(10), "yes ~ 1").empty


def test_missing_cells_leave_no_test_over_the_levels() -> None:
    table = answers(10).query("not (tech == 'c' and scene == 'y')")
    assert f_tests(table, "rating ~ tech * scene").empty
    assert f_tests(table, "rating ~ tech + scene")["df1"].to_dict() == {"tech": 2, "scene": 1}
