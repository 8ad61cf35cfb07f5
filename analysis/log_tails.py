"""log10 of two-sided and upper-tail p values that never underflow.

Where the survival function is above 1e-280 its logarithm is taken; below, the incomplete beta and gamma functions are
computed on a logarithmic scale by their continued fractions (Abramowitz & Stegun 26.5.8, 6.5.31; modified Lentz).
"""

from __future__ import annotations

import math

import numpy as np
from scipy import special, stats

_LN10 = math.log(10.0)
_SAFE = 1e-280


def _log_beta_tail(a: float, b: float, log_x: float, log_1mx: float) -> float:
    """ln I_x(a, b) for x below (a + 1) / (a + b + 2)."""
    x = math.exp(log_x)
    tiny = 1e-300
    c, d = 1.0, 1.0 - (a + b) * x / (a + 1.0)
    d = 1.0 / (d if abs(d) > tiny else tiny)
    h = d
    for m in range(1, 10_000):
        for numerator in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            d = 1.0 + numerator * d
            c = 1.0 + numerator / c
            d = 1.0 / (d if abs(d) > tiny else tiny)
            c = c if abs(c) > tiny else tiny
            h *= d * c
        if abs(d * c - 1.0) < 1e-15:
            break
    return a * log_x + b * log_1mx - math.log(a) - float(special.betaln(a, b)) + math.log(h)


def _log_gamma_tail(a: float, x: float) -> float:
    """ln Q(a, x), the upper incomplete gamma function, for x above a + 1."""
    tiny = 1e-300
    b = x + 1.0 - a
    c, d = 1.0 / tiny, 1.0 / b
    h = d
    for i in range(1, 100_000):
        numerator = -i * (i - a)
        b += 2.0
        d = numerator * d + b
        d = 1.0 / (d if abs(d) > tiny else tiny)
        c = b + numerator / c
        c = c if abs(c) > tiny else tiny
        h *= d * c
        if abs(d * c - 1.0) < 1e-15:
            break
    return -x + a * math.log(x) - float(special.gammaln(a)) + math.log(h)


def _log10_f_from_log(log_f: float, df1: float, df2: float) -> float:
    """log10 P(F > f) far in the tail, from ln f."""
    log_ratio = math.log(df1) + log_f - math.log(df2)
    log_x = -float(np.logaddexp(0.0, log_ratio))
    log_1mx = -float(np.logaddexp(0.0, -log_ratio))
    return _log_beta_tail(df2 / 2, df1 / 2, log_x, log_1mx) / _LN10


def log10_f(f: float, df1: float, df2: float) -> float:
    """log10 P(F(df1, df2) > f); -inf only for an infinite f."""
    if math.isnan(f) or not (df1 > 0 and df2 > 0):
        return math.nan
    if math.isinf(f):
        return -math.inf
    p = float(special.fdtrc(df1, df2, f)) if f > 0 else 1.0
    return math.log10(p) if p > _SAFE else _log10_f_from_log(math.log(f), df1, df2)


def log10_t(t: float, df: float) -> float:
    """log10 of the two-sided p of Student's t."""
    if math.isnan(t) or not df > 0:
        return math.nan
    if math.isinf(t):
        return -math.inf
    p = 2.0 * float(special.stdtr(df, -abs(t)))
    return math.log10(p) if p > _SAFE else _log10_f_from_log(2.0 * math.log(abs(t)), 1.0, df)


def log10_t_upper(t: float, df: float) -> float:
    """log10 P(T > t), one-sided."""
    if math.isnan(t) or not df > 0:
        return math.nan
    if t <= 0 or math.isinf(t):
        return -math.inf if t == math.inf else math.log10(float(special.stdtr(df, -t)))
    return log10_t(t, df) - math.log10(2.0)


def log10_chi2(chi2: float, df: float) -> float:
    """log10 P(chi-square(df) > chi2)."""
    if math.isnan(chi2) or not df > 0:
        return math.nan
    if math.isinf(chi2):
        return -math.inf
    p = float(special.chdtrc(df, chi2)) if chi2 > 0 else 1.0
    return math.log10(p) if p > _SAFE else _log_gamma_tail(df / 2, chi2 / 2) / _LN10


def log10_z(z: float) -> float:
    """log10 of the two-sided p of a standard normal z."""
    if math.isnan(z):
        return math.nan
    return min(0.0, (float(special.log_ndtr(-abs(z))) + math.log(2.0)) / _LN10)


def p_z(z: float) -> float:
    """Two-sided p of a standard normal z."""
    return math.nan if math.isnan(z) else min(1.0, 2.0 * float(special.ndtr(-abs(z))))


def p_t(t: float, df: float) -> float:
    """Two-sided p of Student's t."""
    return math.nan if math.isnan(t) or not df > 0 else min(1.0, 2.0 * float(special.stdtr(df, -abs(t))))


def p_f(f: float, df1: float, df2: float) -> float:
    """P(F(df1, df2) > f)."""
    if math.isnan(f) or not (df1 > 0 and df2 > 0):
        return math.nan
    return 0.0 if math.isinf(f) else float(special.fdtrc(df1, df2, max(f, 0.0)))


def p_chi2(chi2: float, df: float) -> float:
    """P(chi-square(df) > chi2)."""
    if math.isnan(chi2) or not df > 0:
        return math.nan
    return 0.0 if math.isinf(chi2) else float(special.chdtrc(df, max(chi2, 0.0)))


def log10_binomial(k: int, n: int, p0: float) -> float:
    """log10 of the exact two-sided binomial p: all outcomes not more likely than ``k`` (R's binom.test)."""
    if n <= 0:
        return math.nan
    outcomes = np.arange(n + 1)
    log_pmf = stats.binom.logpmf(outcomes, n, p0)
    # Outcomes as likely as k up to 1e-7 belong to the tail, as in R.
    total = float(special.logsumexp(log_pmf[log_pmf <= log_pmf[k] + 1e-7])) if np.isfinite(log_pmf[k]) else -math.inf
    return min(0.0, total / _LN10)
