"""Intervals of effect sizes by inverting noncentral F and t, without the far-tail nans of library functions."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy import optimize, special


def noncentral_f_cdf(f: float, df1: float, df2: float, noncentrality: float) -> float:
    """P(F'(df1, df2, noncentrality) <= f), a Poisson mixture of incomplete beta functions."""
    if f <= 0:
        return 0.0
    half = noncentrality / 2
    reach = 12 * math.sqrt(half) + 60
    j = np.arange(max(0, math.floor(half - reach)), math.ceil(half + reach) + 1)
    if half == 0:
        weight = (j == 0).astype(float)
    else:
        weight = np.exp(special.xlogy(j, half) - half - special.gammaln(j + 1))
        weight /= weight.sum()
    # I_x(a, b) with x = df1 f / (df1 f + df2), by its complement so that x near 1 keeps its digits.
    complement = df2 / (df1 * f + df2)
    return float(1.0 - np.sum(weight * special.betainc(df2 / 2, df1 / 2 + j, complement)))


def _solve(function: Callable[[float], float], low: float, high: float) -> float:
    """Root of a decreasing function between two bounds (the bound itself where the function has no root there)."""
    if function(low) <= 0:
        return low
    if function(high) >= 0:
        return high
    return float(optimize.brentq(function, low, high, xtol=1e-13, rtol=1e-14, maxiter=300))


def noncentrality_interval(f: float, df1: float, df2: float, level: float) -> tuple[float, float]:
    """Lowest and highest noncentrality for which the observed F is not extreme (Steiger 2004)."""
    tail = (1 - level) / 2
    if math.isinf(f):
        return math.inf, math.inf
    if df1 * f > 1e7:
        # lambda is large: the numerator is lambda itself, and only the error's chi-square varies.
        ratio = df1 * f / df2
        return ratio * float(special.chdtri(df2, 1 - tail)), ratio * float(special.chdtri(df2, tail))
    low = high = 0.0
    top = df1 * f + 100.0
    while noncentral_f_cdf(f, df1, df2, top) > tail:
        top *= 2
    if noncentral_f_cdf(f, df1, df2, 0.0) > 1 - tail:
        low = _solve(lambda x: noncentral_f_cdf(f, df1, df2, x) - (1 - tail), 0.0, top)
    if noncentral_f_cdf(f, df1, df2, 0.0) > tail:
        high = _solve(lambda x: noncentral_f_cdf(f, df1, df2, x) - tail, 0.0, top)
    return low, high


@lru_cache(maxsize=4096)
def eta2_interval(f: float, df1: float, df2: float, level: float = 0.90) -> tuple[float, float]:
    """Interval of partial eta squared, lambda / (lambda + df2) (Steiger 2004, as effectsize for R has it).

    The 90 % interval leaves out 0 exactly where the F test rejects at 5 %.
    """
    if math.isnan(f) or df1 <= 0 or df2 <= 0:
        return math.nan, math.nan
    low, high = noncentrality_interval(f, df1, df2, level)
    return _share(low, df2), _share(high, df2)


def _share(noncentrality: float, df2: float) -> float:
    return 1.0 if math.isinf(noncentrality) else noncentrality / (noncentrality + df2)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(240)


def noncentral_t_cdf(t: float, df: float, noncentrality: float) -> float:
    """P(T'(df, noncentrality) <= t) by quadrature over the scale s = sqrt(chi2 / df), or over z where t is large."""
    if t < 0:
        return 1.0 - noncentral_t_cdf(-t, df, -noncentrality)
    if t <= math.sqrt(2 * df):
        low = math.sqrt(float(special.chdtri(df, 1 - 1e-17)) / df) if df > 20 else 0.0
        high = math.sqrt(float(special.chdtri(df, 1e-17)) / df)
        s = low + (high - low) * (_NODES + 1) / 2
        density = np.exp(
            math.log(2) + (df / 2) * math.log(df / 2) - special.gammaln(df / 2)
            + special.xlogy(df - 1, s) - df * s * s / 2
        )  # fmt: skip
        return float(np.sum(_WEIGHTS * density * special.ndtr(t * s - noncentrality)) * (high - low) / 2)
    # P(T <= t) = P(Z + delta <= t s) = E over z of P(s >= (z + delta) / t).
    start = max(-9.5, min(9.5, -noncentrality))
    below = float(special.ndtr(start))
    z = start + (9.5 - start) * (_NODES + 1) / 2
    tail = special.chdtrc(df, df * ((z + noncentrality) / t) ** 2)
    return below + float(np.sum(_WEIGHTS * np.exp(-z * z / 2) * tail) * (9.5 - start) / 2 / math.sqrt(2 * math.pi))


def dz_interval(t: float, n: int, level: float = 0.95) -> tuple[float, float]:
    """Interval of d_z = t / sqrt(n) of a paired t test with n pairs, by the noncentral t distribution."""
    if math.isnan(t) or n < 2:
        return math.nan, math.nan
    if math.isinf(t):
        return t, t
    df, tail = n - 1, (1 - level) / 2
    if abs(t) > 1e7:
        scale = np.sqrt(np.array([special.chdtri(df, 1 - tail), special.chdtri(df, tail)]) / df) * t / math.sqrt(n)
        return float(scale.min()), float(scale.max())
    reach = 10.0 + 10.0 * abs(t)
    low = _solve(lambda x: noncentral_t_cdf(t, df, x) - (1 - tail), t - reach, t + reach)
    high = _solve(lambda x: noncentral_t_cdf(t, df, x) - tail, t - reach, t + reach)
    return low / math.sqrt(n), high / math.sqrt(n)
