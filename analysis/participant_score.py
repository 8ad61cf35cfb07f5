"""Tests and intervals whose unit is the participant, for threshold models with one random intercept.

The score of a coefficient at a value c, all else at its maximum there, is a sum of one contribution a participant.
Their own spread is its error (the robust, or generalised, score test: Boos 1992, Am. Stat. 46, 327; Rotnitzky & Jewell
1990, Biometrika 77, 485), so that participants who differ in an effect do not make it significant. With n contributions
T^2 = S^2 / sum of squares is n t^2 / (df + t^2) of their one-sample t, and t with df degrees of freedom is the cut-off
(of the small-sample forms in Guo et al. 2005, Stat. Med. 24, 3479, the exact one for normal contributions). The
interval holds every c that is not rejected.

What was compared, 20,000 null studies of 12 answers by each of 12 or 24 participants who differ by 0, 0.5 or 1 logit
(and by 0 or 0.3 per scene): this test rejects 4.7 to 5.3 %; the likelihood ratio against chi-square 4.1 to 6.5 %, since
it is conservative where the SD is 0 and liberal where it is not; the same against F(1, n - 1) 1.8 to 4.6 %; the
robust score against chi-square 4.2 to 5.1 %. The standard deviation is held where it is likeliest: taking its part out
of the score with the observed information rejects 7.8 % of a dozen participants who do not differ, and with the
expected one 5.0 to 7.4 % at coefficients of 1 and 2 logits, where this rejects 3.5 to 6.3 % (6,000 studies each).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import optimize, special

from analysis.log_tails import log10_t, p_t
from analysis.newton import uphill_step
from analysis.threshold_bounds import Bounds
from analysis.threshold_model import WIDE_SD, Quadrature, ThresholdFit

# With random intercepts this far apart (logits) nearly every participant always answers the same: more says no more.
MAX_SD = 20.0


@dataclass(frozen=True)
class TermTest:
    """``statistic`` (t, or the signed root of the deviance) at 0, its ``df``, p, and the interval of ``level``.

    An end of the interval is infinite where no value on that side is rejected; ``closed`` is then False. Nan where the
    contributions at 0 are all 0. ``converged``: there is a maximum at 0.
    """

    statistic: float
    df: float
    p: float
    log10_p: float
    ci_low: float
    ci_high: float
    converged: bool = True

    @property
    def closed(self) -> bool:
        """The interval has both ends."""
        return math.isfinite(self.ci_low) and math.isfinite(self.ci_high)


def rejected_from(statistic: Callable[[float], float], estimate: float, step: float, cut: float) -> float:
    """The value on ``step``'s side of the estimate where the statistic is ``cut`` in size; infinite where it never is.

    ``statistic`` is about 0 at the estimate; it may return nan where the model has no maximum: nothing is rejected
    there.
    """

    @cache
    def excess(value: float) -> float:
        size = abs(statistic(value))
        return -cut if math.isnan(size) else min(size, 1e6) - cut

    if excess(estimate) >= 0:
        return estimate
    inner, reach = estimate, step
    for _ in range(8):
        outer = estimate + reach
        if excess(outer) >= 0:
            return float(optimize.brentq(excess, inner, outer, xtol=1e-7 * abs(step)))
        inner, reach = outer, 2 * reach
    return math.copysign(math.inf, step)


Maximum = tuple[np.ndarray, np.ndarray, np.ndarray]
"""(phi, sd), and the participants' scores and the information there."""


class ParticipantScore:
    """Score tests of single coefficients; keeps the last maximum as the next start."""

    def __init__(self, bounds: Bounds, groups: np.ndarray, fit: ThresholdFit, link: str, nodes: int, ordered: int):
        self.quadrature = Quadrature(bounds, groups, link, nodes, wide=fit.sd > WIDE_SD)
        self.ordered = ordered
        self.best = np.append(fit.phi, min(fit.sd, MAX_SD))
        self.start, self.along = self.best, np.zeros(len(fit.phi))
        self.se = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
        self.between = _constant_in_groups(bounds, groups)

    def df(self, k: int) -> int:
        """Participants less the columns that differ only between them, the intercept or thresholds as one."""
        n = len(self.quadrature.starts)
        columns = self.between[self.ordered :] if self.ordered else self.between
        spent = int(columns.sum()) + int(self.ordered > 0)
        return n - spent if self.between[k] else n - 1

    def test(self, k: int, level: float) -> TermTest:
        """Coefficient ``k`` against 0, and its interval."""
        df, estimate = self.df(k), float(self.best[k])
        self._begin()
        statistic = self.statistic(k, 0.0)
        if math.isnan(statistic):
            converged = self.start is not self.best
            return TermTest(math.nan, df, math.nan, math.nan, math.nan, math.nan, converged)
        cut = float(special.stdtrit(df, 0.5 + level / 2))
        ends = []
        for side in (-1.0, 1.0):
            self._begin()
            step = side * min(cut, 5.0) * float(self.se[k])
            ends.append(rejected_from(lambda c: self.statistic(k, c), estimate, step, cut))
        low, high = ends
        return TermTest(statistic, df, p_t(statistic, df), log10_t(statistic, df), low, high)

    def _begin(self) -> None:
        """The next search starts at the estimate."""
        self.start, self.along = self.best, np.zeros(len(self.best) - 1)

    def _start_at(self, k: int, value: float) -> np.ndarray:
        """The last maximum, its other coefficients moved along with coefficient ``k``: so that a far value is not
        sought from beside the ridge, where it may lead to another maximum."""
        start = self.start.copy()
        start[:-1] += self.along * (value - start[k])
        return start if np.all(np.diff(start[: self.ordered]) > 0) else self.start

    def statistic(self, k: int, value: float) -> float:
        """t of the participants' contributions to the score at ``value``; positive where the estimate is larger."""
        found = constrained(self.quadrature, self._start_at(k, value), [k], [value], self.ordered)
        if found is None:
            return math.nan
        self.start = found[0]
        contributions, rest, taken = _own_scores(found, [k])
        self.along = np.zeros(len(self.along))
        self.along[rest] = -taken[:, 0]
        own = contributions[:, 0]
        n, df = len(own), self.df(k)
        total, squares = float(own.sum()), float(own @ own)
        if not squares > 0:
            return math.nan
        left = n - total**2 / squares
        return math.copysign(math.inf if left <= 1e-12 * n else math.sqrt(df / left / squares) * abs(total), total)

    def joint(self, index: Sequence[int]) -> tuple[float, int, int] | None:
        """(F, df1, df2) of coefficients ``index`` against 0 together, None where participants are too few or the search
        does not end. F is T^2 = S' (sum of s s')^-1 S as Hotelling's: df2 T^2 / (df1 (n - T^2)); df2 = n - df1, or what
        terms between participants leave. One coefficient: t^2."""
        n, df1 = len(self.quadrature.starts), len(index)
        df2 = self.df(index[0]) if self.between[list(index)].all() else n - df1
        found = constrained(self.quadrature, self.best, index, [0.0] * df1, self.ordered) if df2 >= 1 else None
        if found is None:
            return None
        own, _, _ = _own_scores(found, index)
        total = own.sum(axis=0)
        t2 = float(total @ np.linalg.lstsq(own.T @ own, total)[0])
        left = n - t2
        return (math.inf if left <= 1e-12 * n else df2 * t2 / (df1 * left)), df1, df2


def _own_scores(found: Maximum, index: Sequence[int]) -> tuple[np.ndarray, list[int], np.ndarray]:
    """The participants' scores of the coefficients ``index`` without what the other coefficients take up of them (the
    SD is held, see above); the others, and what of each they take."""
    theta, scores, information = found
    rest = [j for j in range(len(theta) - 1) if j not in set(index)]
    if not rest:
        return scores[:, list(index)], rest, np.zeros((0, len(index)))
    taken = np.linalg.lstsq(information[np.ix_(rest, rest)], information[np.ix_(rest, list(index))])[0]
    return scores[:, list(index)] - scores[:, rest] @ taken, rest, taken


def constrained(
    quadrature: Quadrature, start: np.ndarray, index: Sequence[int], values: Sequence[float], ordered: int
) -> Maximum | None:
    """The largest likelihood with phi[index] = ``values`` and sd up to ``MAX_SD``; None where the search does not
    end."""
    theta = start.copy()
    theta[list(index)] = values
    free = [j for j in range(len(theta) - 1) if j not in set(index)]
    if theta[-1] == 0:
        found = _climbed(quadrature, theta, free, ordered)
        # at SD 0 the likelihood is level in it: its curvature says whether more is better
        if found is None or found[2][-1, -1] >= 0:
            return found
        theta = found[0].copy()
        theta[-1] = 0.3
    for sd in (theta[-1], 1.0, 4.0):
        # with answers that are nearly all alike the quadrature is rough far out: begin again nearer
        theta[-1] = sd
        found = _climbed(quadrature, theta, [*free, len(theta) - 1], ordered)
        if found is not None:
            break
    if found is not None and found[0][-1] < 1e-3:
        theta = found[0].copy()
        theta[-1] = 0.0
        return _climbed(quadrature, theta, free, ordered)
    return found


def _climbed(quadrature: Quadrature, theta: np.ndarray, free: list[int], ordered: int) -> Maximum | None:
    """Newton's method from ``theta`` over its ``free`` entries, with step halving: to where the scores' sums are 0.

    A step is judged by the likelihood at the nodes that gave it, and the nodes follow then. (By nodes that move along
    the score is not quite the likelihood's slope: with few of them a search for the highest value went on for hundreds
    of evaluations, and often found no end.)
    """
    nodes = quadrature.nodes(theta[:-1], theta[-1])
    value, scores, information = quadrature.expansion(theta[:-1], theta[-1], nodes)
    for _ in range(60):
        if theta[-1] == MAX_SD and scores[:, -1].sum() > 0:
            free = [j for j in free if j < len(theta) - 1]
        gradient = scores.sum(axis=0)[free]
        step = uphill_step(information[np.ix_(free, free)], gradient)
        gain, factor = float(gradient @ step), 1.0
        if gain < 1e-18:
            return theta, scores, information
        while factor > 1e-6:
            trial = theta.copy()
            trial[free] += factor * step
            # the likelihood does not know the sign of the standard deviation
            trial[-1] = min(abs(trial[-1]), MAX_SD)
            ordinary = np.all(np.diff(trial[:ordered]) > 0)
            if ordinary and quadrature.value(trial[:-1], trial[-1], nodes) >= value - 1e-12 * (1 + abs(value)):
                break
            factor /= 2
        else:
            # nothing higher: as near as the quadrature tells, a thirtieth of a standard error at most
            return (theta, scores, information) if gain < 1e-3 else None
        theta, nodes = trial, quadrature.nodes(trial[:-1], trial[-1])
        value, scores, information = quadrature.expansion(theta[:-1], theta[-1], nodes)
        if gain < 1e-10 and factor == 1.0:
            # the next step is of the order of this one's square
            return theta, scores, information
    return None


def _constant_in_groups(bounds: Bounds, groups: np.ndarray) -> np.ndarray:
    """Which parameters' columns have one value in every group: what differs between participants only."""
    x = np.where(bounds.no_upper[:, None], bounds.lower, bounds.upper)
    order = np.argsort(groups, kind="stable")
    starts = np.flatnonzero(np.diff(groups[order], prepend=-1))
    low, high = np.minimum.reduceat(x[order], starts), np.maximum.reduceat(x[order], starts)
    return np.asarray((high - low <= 1e-9 * np.abs(x).max(axis=0)).all(axis=0))
