"""Paired-comparison scales: what separates them, ties, order, observers, and their bootstrap."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pandas as pd
import pytest
from scipy import optimize, special, stats

import analysis
from stimuli.errors import InputError


def comparisons(seed: int = 1, observers: int = 12, items: int = 4, repetitions: int = 3) -> pd.DataFrame:
    """Choices with an order effect of 0.5 logits, 20 % ties, and utilities 0, 0.4, 0.8, ..."""
    rng = np.random.default_rng(seed)
    rows = []
    for o, (i, j), _ in itertools.product(
        range(observers), itertools.combinations(range(items), 2), range(repetitions)
    ):
        first = int(rng.choice([i, j]))
        p = special.expit(0.4 * (i - j) + 0.5 * (1 if first == i else -1))
        won, lost = (i, j) if rng.random() < p else (j, i)
        rows.append((o, f"t{won}", f"t{lost}", f"t{first}", rng.random() < 0.2))
    return pd.DataFrame(rows, columns=["who", "won", "lost", "first", "tie"])


def davidson(table: pd.DataFrame) -> optimize.OptimizeResult:
    """The likelihood written down as it stands in Davidson (1970), with an order effect, maximised by brute force."""
    items = sorted(set(table["won"]) | set(table["lost"]))
    w, l = (table[c].map(items.index).to_numpy() for c in ("won", "lost"))
    order = np.where(table["first"] == table["won"], 1.0, -1.0)

    def negative(theta: np.ndarray) -> float:
        a = np.append(0.0, theta[: len(items) - 1])
        up = np.exp((a[w] - a[l] + order * theta[-2]) / 2)
        tie = np.exp(theta[-1])
        total = up + 1 / up + tie
        return -float(np.sum(np.log(np.where(table["tie"], tie, up) / total)))

    return optimize.minimize(negative, np.zeros(len(items) + 1), method="BFGS", options={"gtol": 1e-9})


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_ties_and_order_effect_maximise_davidsons_likelihood() -> None:
    table = comparisons()
    made = analysis.bradley_terry(table, "won", "lost", ties="tie", order_effect=True)
    right = davidson(table)
    np.testing.assert_allclose(made["ability"][1:], right.x[:3], atol=1e-5)
    assert made.attrs["order_effect"]["estimate"] == pytest.approx(right.x[-2], abs=1e-5)
    assert made.attrs["tie_parameter"]["estimate"] == pytest.approx(right.x[-1], abs=1e-5)
    assert made.attrs["log_likelihood_bernoulli"] == pytest.approx(-right.fun, abs=1e-8)
    named = analysis.bradley_terry(table, "won", "lost", ties="davidson", order_effect=True)
    np.testing.assert_array_equal(named["ability"], made["ability"])
    flagged = table.assign(first=(table["first"] == table["won"]).astype(int))
    same = analysis.bradley_terry(flagged, "won", "lost", ties="tie", order_effect="first")
    np.testing.assert_allclose(same["ability"], made["ability"], atol=1e-9)


def test_an_order_effect_needs_a_column_that_tells_the_order() -> None:
    with pytest.raises(InputError, match="first"):
        analysis.bradley_terry(comparisons().drop(columns="first"), "won", "lost", order_effect=True)


def test_all_or_nothing_has_no_scale() -> None:
    table = pd.DataFrame([("a", "b")] * 20 + [("b", "c")] * 20 + [("a", "c")] * 20, columns=["won", "lost"])
    for made, value in (
        (analysis.bradley_terry(table, "won", "lost"), "ability"),
        (analysis.thurstone(table, "won", "lost"), "scale"),
    ):
        assert (made["status"] == "separated").all()
        assert made[value].tolist() == [0.0, -math.inf, -math.inf]
        assert made.attrs["separation"] is True


def test_items_that_never_met_are_disconnected() -> None:
    table = pd.DataFrame([("a", "b"), ("b", "a"), ("c", "d"), ("d", "c")], columns=["won", "lost"])
    made = analysis.bradley_terry(table, "won", "lost")
    assert (made["status"] == "disconnected").all()
    assert made["ability"].isna().tolist() == [False, False, True, True]


def test_one_pair_has_the_closed_form() -> None:
    table = pd.DataFrame({"won": ["a", "b"], "lost": ["b", "a"], "n": [30, 10]})
    made = analysis.bradley_terry(table, "won", "lost", count="n").set_index("item")
    assert made.loc["b", "ability"] == pytest.approx(-math.log(3), rel=1e-10)
    assert made.loc["b", "jod"] == pytest.approx(-1, rel=1e-10)
    assert made.loc["b", "se"] == pytest.approx(math.sqrt(1 / 30 + 1 / 10), rel=1e-9)
    jod = analysis.thurstone(table, "won", "lost", count="n").set_index("item")
    assert jod.loc["b", "scale"] == pytest.approx(-1, rel=1e-9)


def test_observers_are_the_unit_of_the_errors() -> None:
    table = comparisons()
    ten_fold = pd.concat([table] * 10, ignore_index=True)
    once, again = (analysis.bradley_terry(t, "won", "lost", observer="who") for t in (table, ten_fold))
    np.testing.assert_allclose(once["se"], again["se"], rtol=1e-8)
    naive = analysis.bradley_terry(ten_fold, "won", "lost")
    assert (naive["se"][1:] < once["se"][1:] / 2).all()


def test_the_bootstrap_agrees_with_the_sandwich_and_repeats_itself() -> None:
    table = comparisons(observers=40)
    one = analysis.thurstone(table, "won", "lost", observer="who", unit="z")
    other = analysis.thurstone(table, "won", "lost", observer="who", unit="z")
    pd.testing.assert_frame_equal(one, other)
    logits = analysis.bradley_terry(table, "won", "lost", observer="who")
    # Probit errors are those of logits times the ratio of the scales, near 0.6.
    ratio = (one["se"][1:] / logits["se"][1:]).to_numpy()
    assert np.all((ratio > 0.55) & (ratio < 0.72))
    moved = analysis.thurstone(table, "won", "lost", observer="who", unit="z", seed=1)
    np.testing.assert_allclose(moved["se"][1:], one["se"][1:], rtol=0.08)


def test_probit_scale_equals_the_generalised_linear_model() -> None:
    import statsmodels.api as sm

    table = comparisons(observers=30)
    x = np.stack([(table["won"] == f"t{i}").astype(float) - (table["lost"] == f"t{i}") for i in (1, 2, 3)], axis=1)
    sign = np.where(np.arange(len(x)) % 2, 1.0, -1.0)
    fit = sm.GLM(
        (sign > 0).astype(float), x * sign[:, None], family=sm.families.Binomial(sm.families.links.Probit())
    ).fit()
    made = analysis.thurstone(table, "won", "lost", unit="z")
    np.testing.assert_allclose(made["scale"][1:], fit.params, rtol=1e-6)
    np.testing.assert_allclose(made["se"][1:], fit.bse, rtol=1e-5)


def test_circular_triads_are_counted_and_outliers_flagged() -> None:
    rows = [("x", a, b) for a, b in (("a", "b"), ("b", "c"), ("c", "a"))]
    rows += [("y", a, b) for a, b in (("a", "b"), ("b", "c"), ("a", "c"))]
    made = analysis.circular_triads(pd.DataFrame(rows, columns=["who", "won", "lost"]), "won", "lost", "who")
    assert made["circular"].tolist() == [1, 0]
    assert made["consistency"].tolist() == [0.0, 1.0]
    rng = np.random.default_rng(0)
    rows = []
    for who, (i, j), _ in itertools.product(range(15), itertools.combinations(range(4), 2), range(6)):
        right = rng.random() < special.expit(2.0 * (i - j)) if who else rng.random() < special.expit(2.0 * (j - i))
        rows.append((who, f"t{i if right else j}", f"t{j if right else i}"))
    screened = analysis.screen_observers(pd.DataFrame(rows, columns=["who", "won", "lost"]), "won", "lost", "who")
    assert screened.loc[screened["flagged"], "observer"].tolist() == [0]


def test_differences_use_their_covariance() -> None:
    made = analysis.bradley_terry(comparisons(), "won", "lost")
    pairs = analysis.compare_items(made)
    against_first = pairs[pairs["a"] == "t0"]
    np.testing.assert_allclose(-against_first["diff"], made["ability"][1:], rtol=1e-12)
    np.testing.assert_allclose(against_first["se"], made["se"][1:], rtol=1e-12)
    np.testing.assert_allclose(pairs["p"], 2 * stats.norm.sf(pairs["z"].abs()), rtol=1e-9)


def test_an_item_that_one_observer_compared_has_no_interval() -> None:
    alone = pd.DataFrame({"won": ["t9", "t9", "t1", "t9", "t1"], "lost": ["t1", "t1", "t9", "t1", "t9"]})
    both = pd.concat([comparisons(observers=8)[["who", "won", "lost"]], alone.assign(who=0)])
    for made, value in (
        (analysis.bradley_terry(both, "won", "lost", observer="who"), "ability"),
        (analysis.thurstone(both, "won", "lost", observer="who", n_boot=50), "scale"),
    ):
        row = made.iloc[-1]
        assert (row["item"], row["status"]) == ("t9", "too_few_subjects")
        assert np.isfinite(row[value])
        assert np.isnan(row[["se", "ci_low", "ci_high"]].to_numpy(dtype=float)).all()
        assert set(made["status"][:-1]) == {"ok"}
