"""Psychometric functions by maximum likelihood."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import optimize, special

from analysis.log_tails import p_chi2
from analysis.results import (
    NOT_CONVERGED,
    OK,
    SEPARATED,
    TOO_FEW_SUBJECTS,
    UNDEFINED,
    coded,
    numbers,
    one_of,
    require_columns,
    result_table,
)
from stimuli.errors import InputError, problem

LINKS = ("logit", "probit", "weibull", "cloglog")
COLUMNS = ["parameter", "estimate", "se", "ci_low", "ci_high"]


def _f(z: np.ndarray, link: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """F, 1 - F and the density."""
    z = np.clip(z, -700.0, 700.0)
    if link == "logit":
        p, q = special.expit(z), special.expit(-z)
        return p, q, p * q
    if link == "probit":
        return special.ndtr(z), special.ndtr(-z), np.exp(-z * z / 2) / math.sqrt(2 * math.pi)
    e = np.exp(np.minimum(z, 300.0))
    return -np.expm1(-e), np.exp(-e), e * np.exp(-e)


@dataclass(frozen=True)
class Levels:
    """Stimulus levels (standardised) with counts, and what the function is bounded by."""

    u: np.ndarray
    k: np.ndarray
    n: np.ndarray
    link: str
    guess: float
    lapse: float

    def probability(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """P, 1 - P and dP/dz."""
        f, rest, density = _f(z, self.link)
        span = 1 - self.guess - self.lapse
        return self.guess + span * f, self.lapse + span * rest, span * density

    def log_likelihood(self, alpha: Any, beta: Any) -> Any:
        """Log-likelihood (without coefficients) of z = alpha + beta u; arrays of parameters broadcast."""
        p, q, _ = self.probability(np.asarray(alpha)[..., None] + np.asarray(beta)[..., None] * self.u)
        return (special.xlogy(self.k, p) + special.xlogy(self.n - self.k, q)).sum(axis=-1)

    def slopes(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and expected information by (alpha, beta)."""
        p, q, density = self.probability(theta[0] + theta[1] * self.u)
        x = np.stack([np.ones_like(self.u), self.u])
        # Where P is 0 or 1 to the last digit an answer tells nothing about the parameters.
        known = (p > 1e-200) & (q > 1e-200) & (density > 1e-200)
        per_answer = np.where(known, density / np.where(known, p * q, 1.0), 0.0)
        return x @ ((self.k * q - (self.n - self.k) * p) * per_answer), (x * (self.n * density * per_answer)) @ x.T


def _maximum(levels: Levels, start: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, bool]:
    """(alpha, beta), expected information, converged: the best of a grid, refined by Fisher scoring."""
    middle = np.linspace(-2.5, 2.5, 41)
    steep = np.concatenate([np.geomspace(0.1, 60, 30), -np.geomspace(0.1, 60, 30)])
    t, b = (part.ravel() for part in np.meshgrid(middle, steep))
    with np.errstate(divide="ignore"):
        best = int(np.argmax(levels.log_likelihood(-b * t, b)))
    theta = np.array([-b[best] * t[best], b[best]])

    def objective(point: np.ndarray) -> float:
        value = float(levels.log_likelihood(point[0], point[1]))
        return -value if math.isfinite(value) else 1e300

    if start is None:
        found = optimize.minimize(objective, theta, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-10})
        theta, value = found.x, -found.fun
    else:
        # Near a known maximum Fisher scoring alone is enough.
        theta, value = start, -objective(start)
    converged = False
    for _ in range(200):
        gradient, information = levels.slopes(theta)
        step = np.linalg.lstsq(information, gradient, rcond=None)[0]
        factor = 1.0
        while factor > 1e-8 and -objective(theta + factor * step) < value - 1e-13 * abs(value):
            factor /= 2
        if factor <= 1e-8:
            converged = float(np.max(np.abs(step))) < 1e-5 * (1 + float(np.max(np.abs(theta))))
            break
        theta = theta + factor * step
        value = -objective(theta)
        if float(np.max(np.abs(step))) < 1e-12 * (1 + float(np.max(np.abs(theta)))):
            converged = True
            break
    return theta, levels.slopes(theta)[1], converged


def psychometric(
    table: pd.DataFrame,
    x: str,
    k: str,
    n: str,
    link: str = "logit",
    guess: float = 0.0,
    lapse: float = 0.0,
    observer: str | None = None,
) -> pd.DataFrame:
    """P = guess + (1 - guess - lapse) F(slope (x - threshold)): rows ``threshold`` and ``slope``.

    ``k`` of ``n`` answers at level ``x`` (rows of the same level add up). ``link``: logit, probit (threshold where
    F = 0.5), weibull (F = 1 - exp(-(x / threshold)^slope)) and cloglog (the same on x itself): threshold where
    F = 1 - 1/e. Standard errors from the expected information by the delta method, or, with ``observer``, by the
    jackknife over participants with t(n - 1). ``attrs``: log_likelihood, deviance, df_residual, p_gof. Answers that
    step from all to none between levels are ``separated``, answers that do not depend on x ``undefined``. Raises
    InputError for unknown names, counts that are not 0 <= k <= n, and x <= 0 with weibull.
    """
    one_of("psychometric", "link", link, LINKS)
    if not (0 <= guess < 1 and 0 <= lapse < 1 and guess + lapse < 1):
        raise InputError(problem("psychometric", "guess, lapse", (guess, lapse), "probabilities that leave room"))
    require_columns("psychometric", table, [x, k, n, *([observer] if observer else [])])
    at, correct, total = (numbers("psychometric", table, name) for name in (x, k, n))
    use = np.isfinite(at) & np.isfinite(correct) & np.isfinite(total) & (total > 0)
    person, _ = coded(table, observer) if observer else (np.zeros(len(table), dtype=np.int64), [0])
    use &= person >= 0
    if ((correct[use] < 0) | (correct[use] > total[use])).any():
        raise InputError(problem("psychometric", f"column {k!r}", "a count", f"between 0 and {n!r}"))
    if link == "weibull" and (at[use] <= 0).any():
        raise InputError(problem("psychometric", f"column {x!r}", "values not above 0", "positive levels (weibull)"))
    dropped = {"rows": f"{int((~use).sum())} rows without a level or answers"} if not use.all() else {}
    at, correct, total, person = at[use], correct[use], total[use], person[use]
    scale_of = np.log(at) if link == "weibull" else at
    method = f"Psychometric function ({link}, guess {guess:g}, lapse {lapse:g}) by maximum likelihood."
    n_subjects = len(np.unique(person)) if observer else 0
    trouble = _trouble(scale_of, correct, total, guess, lapse)
    if trouble:
        return _no_estimate(*trouble, method, n_subjects, dropped)
    shift, width = float(np.mean(scale_of)), float(np.ptp(scale_of)) / 2

    def fit(weight: np.ndarray, start: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, bool, Levels]:
        unique, index = np.unique(scale_of, return_inverse=True)
        levels = Levels(
            (unique - shift) / width,
            np.bincount(index, weights=correct * weight),
            np.bincount(index, weights=total * weight),
            link, guess, lapse,
        )  # fmt: skip
        return (*_maximum(levels, start), levels)

    theta, information, converged, levels = fit(np.ones(len(at)))
    p, fail, _ = levels.probability(theta[0] + theta[1] * levels.u)
    found = float(np.sum(special.xlogy(levels.k, p) + special.xlogy(levels.n - levels.k, fail)))
    level = min(max(float(levels.k.sum() / levels.n.sum()), guess), 1 - lapse)
    same = float(special.xlogy(levels.k.sum(), level) + special.xlogy((levels.n - levels.k).sum(), 1 - level))
    if not found > same + 1e-9 * (1 + abs(same)):
        return _no_estimate(UNDEFINED, "no level's answers differ from one share for all", method, n_subjects, dropped)
    if abs(theta[1]) > 200:
        note = "the answers step from the lowest to the highest share between two levels: the slope is not finite"
        return _no_estimate(SEPARATED, note, method, n_subjects, dropped, math.copysign(math.inf, theta[1]))
    # Only one level between floor and ceiling: it fixes one parameter, and the slope grows without end.
    about_slope = information[1, 1] - information[0, 1] ** 2 / max(information[0, 0], 1e-300)
    if abs(theta[1]) > 8 and not about_slope * theta[1] ** 2 > 1e-3:
        note = "at most one level lies between the lowest and the highest share: the slope is not finite"
        return _no_estimate(SEPARATED, note, method, n_subjects, dropped, math.copysign(math.inf, theta[1]))
    if abs(theta[1]) < 1e-6:
        return _no_estimate(UNDEFINED, "the answers do not depend on the level", method, n_subjects, dropped)
    values = _natural(theta, shift, width)
    covariance = _delta(theta, width) @ np.linalg.pinv(information, hermitian=True) @ _delta(theta, width).T
    quantile, status, note = float(special.ndtri(0.975)), OK, ""
    if not converged:
        status, note = NOT_CONVERGED, "the search for the maximum did not end"
    if observer:
        method += f" Jackknife over {n_subjects} participants."
        if n_subjects < 2:
            status, note = TOO_FEW_SUBJECTS, f"{n_subjects} participant: no inference about others"
            covariance = np.full((2, 2), math.nan)
        else:
            left_out = [fit((person != i).astype(float), theta)[0] for i in np.unique(person)]
            spread = np.array([_natural(theta_i, shift, width) for theta_i in left_out])
            covariance = np.cov(spread, rowvar=False) * (n_subjects - 1) ** 2 / n_subjects
            quantile = float(special.stdtrit(n_subjects - 1, 0.975))
    rows = []
    for j, name in enumerate(("threshold", "slope")):
        value, se = float(values[j]), float(np.sqrt(covariance[j, j]))
        low, high = value - quantile * se, value + quantile * se
        if link == "weibull" and j == 0:
            value, low, high = math.exp(value), math.exp(low), math.exp(high)
            se *= value
        rows.append({"parameter": name, "estimate": value, "se": se, "ci_low": low, "ci_high": high,
                     "status": status, "note": note})  # fmt: skip
    p, fail, _ = levels.probability(theta[0] + theta[1] * levels.u)
    share = levels.k / levels.n
    best = special.xlogy(levels.k, share) + special.xlog1py(levels.n - levels.k, -share)
    fitted = special.xlogy(levels.k, p) + special.xlogy(levels.n - levels.k, fail)
    deviance, df = 2 * float(np.sum(best - fitted)), len(share) - 2
    attrs = {
        "log_likelihood": float(np.sum(fitted + special.gammaln(levels.n + 1) - special.gammaln(levels.k + 1)
                                       - special.gammaln(levels.n - levels.k + 1))),
        "deviance": deviance, "df_residual": df, "p_gof": p_chi2(deviance, df) if df > 0 else 1.0,
    }  # fmt: skip
    return result_table(rows, COLUMNS, method=method, n_subjects=n_subjects, dropped=dropped, attrs=attrs)


def _natural(theta: np.ndarray, shift: float, width: float) -> np.ndarray:
    """(threshold, slope) of z = alpha + beta (x - shift) / width."""
    return np.array([shift - width * theta[0] / theta[1], theta[1] / width])


def _delta(theta: np.ndarray, width: float) -> np.ndarray:
    return np.array([[-width / theta[1], width * theta[0] / theta[1] ** 2], [0.0, 1 / width]])


def _trouble(x: np.ndarray, k: np.ndarray, n: np.ndarray, guess: float, lapse: float) -> tuple[str, str] | None:
    """Why no function can be fitted, if so."""
    if len(np.unique(x)) < 2:
        return UNDEFINED, "fewer than two levels"
    unique, index = np.unique(x, return_inverse=True)
    share = np.bincount(index, weights=k) / np.bincount(index, weights=n)
    if np.ptp(share) == 0:
        return UNDEFINED, "the share of answers is the same at every level: no threshold"
    floor, ceiling = share <= guess, share >= 1 - lapse
    if (floor | ceiling).all() and abs(int(np.diff(ceiling.astype(int)).sum())) == 1 and len(unique) >= 2:
        steps = int(np.abs(np.diff(ceiling.astype(int))).sum())
        if steps == 1 and (guess == 0 or floor[~ceiling].all()):
            return SEPARATED, "the answers step from none to all between two levels: the slope is not finite"
    return None


def _no_estimate(
    status: str, note: str, method: str, n_subjects: int, dropped: dict[Any, str], slope: float = math.nan
) -> pd.DataFrame:
    empty = dict.fromkeys(COLUMNS[1:], math.nan) | {"status": status, "note": note}
    if status == SEPARATED and math.isnan(slope):
        slope = math.inf
    rows = [{"parameter": "threshold", **empty}, {"parameter": "slope", **empty, "estimate": slope}]
    return result_table(rows, COLUMNS, method=method, n_subjects=n_subjects, dropped=dropped)
