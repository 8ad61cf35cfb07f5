"""Logarithms of p against closed forms and exact rational arithmetic, far beyond the double's range."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from analysis import log_tails

LN10 = math.log(10)


@pytest.mark.parametrize("x", [0.5, 30.0, 700.0, 1400.0, 5e3, 1e6])
def test_chi2_of_two_and_four_df_has_a_closed_form(x: float) -> None:
    assert log_tails.log10_chi2(x, 2) == pytest.approx(-x / 2 / LN10, rel=1e-13)
    assert log_tails.log10_chi2(x, 4) == pytest.approx((-x / 2 + math.log1p(x / 2)) / LN10, rel=1e-13)


@pytest.mark.parametrize("f", [1.0, 1e3, 1e12, 1e200])
@pytest.mark.parametrize("df2", [3.0, 40.0, 1000.0])
def test_f_of_two_numerator_df_has_a_closed_form(f: float, df2: float) -> None:
    assert log_tails.log10_f(f, 2, df2) == pytest.approx(-df2 / 2 * math.log1p(2 * f / df2) / LN10, rel=1e-12)


def test_f_far_out_equals_its_leading_term() -> None:
    # I_x(a, b) -> x^a / (a B(a, b)) as x -> 0.
    a, b, f = 10.0, 1.5, 1e60
    x = 20.0 / (20.0 + 3.0 * f)
    leading = (a * math.log(x) - math.log(a) - (math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b))) / LN10
    assert log_tails.log10_f(f, 3, 20) == pytest.approx(leading, rel=1e-12)


@pytest.mark.parametrize("t", [0.3, 5.0, 1e5, 1e100, 1e160, 1e300])
def test_t_of_one_and_two_df_has_a_closed_form(t: float) -> None:
    one = math.log10(2 / math.pi * math.atan(1 / t))
    assert log_tails.log10_t(t, 1) == pytest.approx(one, rel=1e-12)
    if t < 1e150:
        two = math.log10(2 / (t * t + 2 + t * math.sqrt(t * t + 2)))
        assert log_tails.log10_t(t, 2) == pytest.approx(two, rel=1e-12)


@pytest.mark.parametrize("t", [35.0, 38.0, 60.0, 1e4])
def test_z_is_the_limit_of_t_and_chi2(t: float) -> None:
    assert log_tails.log10_z(t) == pytest.approx(log_tails.log10_chi2(t * t, 1), rel=1e-12)
    if t < 100:
        assert log_tails.log10_t(t, 1e12) == pytest.approx(log_tails.log10_z(t), rel=1e-6)


def test_the_tails_are_continuous_where_the_method_changes() -> None:
    for f in (lambda x: log_tails.log10_chi2(x, 7), lambda x: log_tails.log10_f(math.exp(x / 50), 3, 50)):
        x = np.linspace(1200, 1400, 401)
        second = np.diff([f(v) for v in x], 2)
        assert np.max(np.abs(second)) < 1e-3


@pytest.mark.parametrize(("k", "n", "p0"), [(0, 5, 0.5), (33, 35, 0.5), (2, 30, 0.25), (3, 4, 0.5), (400, 1500, 0.5)])
def test_binomial_equals_exact_rational_arithmetic(k: int, n: int, p0: float) -> None:
    p = Fraction(p0)
    mass = [math.comb(n, j) * p**j * (1 - p) ** (n - j) for j in range(n + 1)]
    exact = sum((m for m in mass if m <= mass[k]), Fraction(0))
    log10 = (math.log(exact.numerator) - math.log(exact.denominator)) / LN10
    assert log_tails.log10_binomial(k, n, p0) == pytest.approx(log10, rel=1e-10, abs=1e-12)


def test_where_p_does_not_underflow_its_logarithm_is_taken() -> None:
    assert 10 ** log_tails.log10_t(-2.3, 14) == pytest.approx(2 * stats.t.sf(2.3, 14))
    assert log_tails.p_f(3.0, 2, 20) == pytest.approx(stats.f.sf(3.0, 2, 20), rel=1e-13)
    assert log_tails.p_chi2(3.0, 2) == pytest.approx(math.exp(-1.5), rel=1e-14)
    assert log_tails.p_z(-1.959963984540054) == pytest.approx(0.05, rel=1e-12)
    assert log_tails.log10_t_upper(-1.0, 5) == pytest.approx(math.log10(stats.t.sf(-1.0, 5)), rel=1e-12)


def test_nan_stays_nan_and_infinity_is_certain() -> None:
    for function in (log_tails.log10_z, lambda v: log_tails.log10_t(v, 5), lambda v: log_tails.log10_f(v, 2, 5),
                     lambda v: log_tails.log10_chi2(v, 2)):  # fmt: skip
        assert math.isnan(function(math.nan))
        assert function(math.inf) == -math.inf
