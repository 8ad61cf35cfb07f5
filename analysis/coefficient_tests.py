"""The maximum of a threshold model, and tests and intervals of its coefficients: by participants, deviance or Wald.

The profile-likelihood interval holds every value whose deviance from the maximum, all else at its own maximum there,
is below the chi-square quantile (Venzon & Moolgavkar 1988, Appl. Stat. 37, 87). Where answers are separated the
maximum lies at infinity, and the interval still has its finite end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from analysis.formula import RandomTerm
from analysis.laplace import fit_crossed
from analysis.log_tails import log10_z, p_z
from analysis.participant_score import ParticipantScore, TermTest, rejected_from
from analysis.results import BOUNDARY, NOT_CONVERGED, OK, TOO_FEW_SUBJECTS, UNDEFINED, ZERO_ERROR_VARIANCE
from analysis.threshold_bounds import Bounds, separation_direction
from analysis.threshold_model import ThresholdFit, fit_fixed, fit_mixed

PARTICIPANTS, LIKELIHOOD_RATIO, WALD = TESTS = ("participants", "likelihood_ratio", "wald")
STATISTICS = {PARTICIPANTS: ["t", "df"], LIKELIHOOD_RATIO: ["chi2"], WALD: []}
"""Columns that a test adds to Wald's."""
# Beyond this distance from 0 a probability is 1 to the last digit.
_FAR = 40.0


@dataclass(frozen=True)
class ThresholdModel:
    """Observations, random effects and how their likelihood is computed; ``start`` of the search."""

    bounds: Bounds
    random: list[RandomTerm]
    start: np.ndarray
    link: str
    nodes: int
    thresholds: int

    @property
    def one_intercept(self) -> bool:
        """One random intercept, by quadrature: the participant's."""
        return self.nodes > 1 and len(self.random) == 1 and bool((self.random[0].design == 1).all())

    @property
    def method(self) -> str:
        """How the likelihood is computed, in words."""
        if self.one_intercept:
            return f"adaptive Gauss-Hermite quadrature, {self.nodes} nodes"
        return "Laplace approximation" if self.random else "maximum likelihood"

    def maximum(self) -> tuple[ThresholdFit, dict[str, float]]:
        """The fit, and the random effects' standard deviations by name."""
        fit = fit_fixed(self.bounds, self.start, self.link)
        if self.one_intercept:
            fit = fit_mixed(self.bounds, self.random[0].codes, fit, self.link, self.nodes, self.thresholds)
            return fit, {self.random[0].name: fit.sd}
        return fit_crossed(self.bounds, self.random, fit, self.link, self.thresholds) if self.random else (fit, {})

    def known(self, k: int, value: float) -> ThresholdModel:
        """The model in which coefficient ``k`` is known."""
        return replace(self, bounds=self.bounds.known(k, value), start=np.delete(self.start, k))


def usual_test(model: ThresholdModel) -> str:
    """By participants where a random intercept makes them the unit, by deviance where there are several, else Wald."""
    if model.one_intercept:
        return PARTICIPANTS
    return LIKELIHOOD_RATIO if model.random else WALD


def put_tests(
    model: ThresholdModel, fit: ThresholdFit, rows: list[dict[str, object]], test: str, level: float = 0.95
) -> None:
    """Put the test's statistic, p and interval into ``rows``, one a coefficient; thresholds keep Wald's."""
    participants = None
    if test == PARTICIPANTS:
        codes = model.random[0].codes
        participants = ParticipantScore(model.bounds, codes, fit, model.link, model.nodes, model.thresholds)
    for k, row in enumerate(rows):
        if k < model.thresholds or row["status"] not in (OK, BOUNDARY):
            row |= {"t": row["z"], "df": math.inf} if participants else {"chi2": float(row["z"]) ** 2}  # type: ignore[arg-type]
            continue
        if participants:
            if participants.df(k) < 1:
                nothing = dict.fromkeys(("t", "p", "log10_p", "ci_low", "ci_high"), math.nan)
                row |= {**nothing, "df": participants.df(k), "status": TOO_FEW_SUBJECTS}
                row["note"] = "no more participants than coefficients that differ only between them"
                continue
            found = participants.test(k, level)
            row |= {"t": found.statistic, "df": found.df}
        else:
            found = _deviance_test(model, fit, k, level)
            row["chi2"] = found.statistic**2
        row |= {"p": found.p, "log10_p": found.log10_p, "ci_low": found.ci_low, "ci_high": found.ci_high}
        if (told := _told(found)) is not None:
            row["status"], row["note"] = told


def _told(found: TermTest) -> tuple[str, str] | None:
    """Status and note of a test that is not as usual."""
    if not found.converged:
        return NOT_CONVERGED, "the search for the maximum at 0 did not end"
    if math.isnan(found.statistic):
        return UNDEFINED, "no participant's answers lean to a side: t is 0 / 0"
    if math.isinf(found.statistic):
        return ZERO_ERROR_VARIANCE, "all participants lean to the same side equally: t is infinite"
    if not found.closed:
        sides = [side for side, end in (("below", found.ci_low), ("above", found.ci_high)) if math.isinf(end)]
        return BOUNDARY, f"no value {' or '.join(sides)} the estimate is rejected: the interval is open"
    return None


def _deviance_test(model: ThresholdModel, fit: ThresholdFit, k: int, level: float) -> TermTest:
    """Likelihood ratio against 0, and the profile-likelihood interval."""
    estimate, se = float(fit.phi[k]), math.sqrt(max(float(fit.covariance[k, k]), 0.0))

    def root(value: float) -> float:
        # the square root of chi-square on 1 df is the absolute value of z
        gain = 2 * (fit.log_likelihood - model.known(k, value).maximum()[0].log_likelihood)
        return math.copysign(math.sqrt(max(gain, 0.0)), estimate - value) if not math.isnan(gain) else math.nan

    cut = float(special.ndtri(0.5 + level / 2))
    at_zero = root(0.0)
    low, high = (rejected_from(root, estimate, side * cut * se, cut) for side in (-1.0, 1.0))
    return TermTest(at_zero, math.inf, p_z(at_zero), log10_z(at_zero), low, high, not math.isnan(at_zero))


def separated_test(model: ThresholdModel, k: int, towards: float, level: float = 0.95) -> TermTest | None:
    """One-sided: coefficient ``k`` grows without end ``towards`` a sign; None where the other terms separate too."""
    if separation_direction(model.known(k, 0.0).bounds) is not None:
        return None
    column = np.abs(np.column_stack([model.bounds.upper[:, k], model.bounds.lower[:, k]]))
    far = math.copysign(_FAR / float(column.max()), towards)
    best = model.known(k, far).maximum()[0].log_likelihood

    def root(value: float) -> float:
        gain = 2 * (best - model.known(k, value).maximum()[0].log_likelihood)
        return math.sqrt(max(gain, 0.0)) if not math.isnan(gain) else math.nan

    # inwards from where the answers are certain, in small steps: further in a random SD may have no maximum
    cut, inner, end = float(special.ndtri(0.5 + level / 2)), far, math.copysign(math.inf, -towards)
    for outer in np.concatenate([far * 0.85 ** np.arange(1, 30), far * -0.02 * np.arange(50)]):
        if root(float(outer)) >= cut:
            end = rejected_from(root, inner, float(outer) - inner, cut)
            break
        inner = float(outer)
    low, high = (end, math.inf) if towards > 0 else (-math.inf, end)
    at_zero = root(0.0)
    return TermTest(at_zero, math.inf, p_z(at_zero), log10_z(at_zero), low, high, not math.isnan(at_zero))
