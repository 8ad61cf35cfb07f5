"""Likelihood of threshold models, P = F(a) - F(b), with or without a random intercept by adaptive quadrature.

An observation has an upper bound a = A phi - s u and a lower one b = B phi - s u, either of which may be infinite; u is
standard normal and shared by a group, s its standard deviation. Cumulative link models are of this form, and so is
binary regression (one bound, at 0). Integrals over u use adaptive Gauss-Hermite quadrature (Liu & Pierce 1994;
Pinheiro & Bates 1995); gradients come from Fisher's identity at the same nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize, sparse, special

from analysis.threshold_bounds import Bounds

# Random intercepts further apart than this make whole groups answer alike: integrands are no longer near normal, and
# nodes about their mode miss part of them. An even grid does not (its error falls as exp(-2 pi^2 / (SD step))).
WIDE_SD = 3.0


@dataclass(frozen=True)
class ThresholdFit:
    """Estimates, covariance (without the SD's row), log-likelihood; ``sd`` of the random intercept and its error."""

    phi: np.ndarray
    covariance: np.ndarray
    log_likelihood: float
    sd: float
    sd_se: float
    converged: bool


def fit_fixed(bounds: Bounds, start: np.ndarray, link: str) -> ThresholdFit:
    """Newton's method with step halving; the links' log-likelihoods are concave."""

    def evaluate(phi: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        a, b = bounds.at(phi)
        crossed = ~bounds.no_upper & ~bounds.no_lower & (a <= b)
        if crossed.any():
            return -math.inf, phi, np.zeros((0, 0))
        value, ga, gb, haa, hbb, hab = bounds.terms(a, b, link)
        u, l = bounds.upper, bounds.lower
        cross = u.T @ (hab[:, None] * l)
        hessian = u.T @ (haa[:, None] * u) + l.T @ (hbb[:, None] * l) + cross + cross.T
        return float(value.sum()), u.T @ ga + l.T @ gb, -hessian

    phi = start.copy()
    value, gradient, information = evaluate(phi)
    converged = False
    for _ in range(100):
        step = np.linalg.lstsq(information, gradient, rcond=None)[0]
        factor = min(1.0, 5.0 / max(float(np.max(np.abs(step), initial=0.0)), 1e-300))
        while factor > 1e-10:
            new = evaluate(phi + factor * step)
            if new[0] >= value - 1e-13 * abs(value):
                phi = phi + factor * step
                value, gradient, information = new
                break
            factor /= 2
        if float(np.max(np.abs(step), initial=0.0)) < 1e-9 * (1 + float(np.max(np.abs(phi), initial=0.0))):
            converged = True
            break
        if factor <= 1e-10:
            converged = float(np.max(np.abs(gradient))) < 1e-6 * (1 + abs(value))
            break
    covariance = np.linalg.pinv(information, hermitian=True)
    return ThresholdFit(phi, covariance, value, 0.0, 0.0, converged)


Nodes = tuple[np.ndarray, np.ndarray]
"""Values of each group's random intercept (groups, nodes), and their scale (groups,)."""
Expansion = tuple[float, np.ndarray, np.ndarray]


class Quadrature:
    """Log-likelihood and gradient of a model with one random intercept; keeps each group's mode between calls.

    ``wide``: a grid of 401 values from -8 to 8, the same for all groups, in place of nodes about each group's mode.
    """

    def __init__(self, bounds: Bounds, groups: np.ndarray, link: str, nodes: int, wide: bool = False) -> None:
        self.link, self.wide = link, wide
        order = np.argsort(groups, kind="stable")
        self.bounds = bounds.rows(order)
        self.codes = groups[order]
        self.starts = np.flatnonzero(np.diff(self.codes, prepend=-1))
        if wide:
            self.t = np.linspace(-8, 8, 401) / math.sqrt(2)
            self.log_weight = np.full(401, math.log(self.t[1] - self.t[0]))
        else:
            self.t, weight = special.roots_hermite(nodes)
            self.log_weight = np.log(weight) + self.t**2
        self.mode = np.zeros(len(self.starts))
        self.sum_upper, self.sum_lower = self._summing(self.bounds.upper), self._summing(self.bounds.lower)

    def _summing(self, columns: np.ndarray) -> sparse.csr_array:
        """(parameters * groups, rows): times the slopes by a bound, those by every parameter, summed over groups."""
        rows, parameters = columns.shape
        place = np.arange(parameters) * len(self.starts) + self.codes[:, None]
        where = np.nonzero(columns)
        entries = (columns[where], (place[where], where[0]))
        return sparse.csr_array(entries, shape=(parameters * len(self.starts), rows))

    def _sum(self, values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values, self.starts, axis=0)

    def _terms(self, a: np.ndarray, b: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, ...]:
        if shift.ndim == 2:
            a, b = a[:, None], b[:, None]
        return self.bounds.terms(a - shift, b - shift, self.link)

    def evaluate(self, phi: np.ndarray, sd: float) -> tuple[float, np.ndarray]:
        """Log-likelihood and its gradient by (phi, sd)."""
        points, tau = self.nodes(phi, sd)
        value, ga, gb, *_ = self._terms(*self.bounds.at(phi), sd * points[self.codes])
        joint = self._sum(value) - points**2 / 2 + self.log_weight
        posterior, total = _normalised(joint)
        log_likelihood = float(np.sum(total + np.log(tau) - 0.5 * math.log(math.pi)))
        posterior = posterior[self.codes]
        mean_a, mean_b = np.sum(posterior * ga, axis=1), np.sum(posterior * gb, axis=1)
        by_sd = -float(np.sum(posterior * (ga + gb) * points[self.codes]))
        gradient = self.bounds.upper.T @ mean_a + self.bounds.lower.T @ mean_b
        return log_likelihood, np.append(gradient, by_sd)

    def nodes(self, phi: np.ndarray, sd: float) -> Nodes:
        """Where the integrals are evaluated: about every group's mode at (phi, sd)."""
        u, curve = self._modes(*self.bounds.at(phi), sd)
        tau = 1 / np.sqrt(curve)
        return u[:, None] + math.sqrt(2) * tau[:, None] * self.t, tau

    def value(self, phi: np.ndarray, sd: float, nodes: Nodes) -> float:
        """The log-likelihood by given nodes; `expansion` by the same nodes has its derivatives."""
        points, tau = nodes
        (a, b), shift = self.bounds.at(phi), sd * points[self.codes]
        value = self.bounds.values(a[:, None] - shift, b[:, None] - shift, self.link)
        total = _normalised(self._sum(value) - points**2 / 2 + self.log_weight)[1]
        return float(np.sum(total + np.log(tau) - 0.5 * math.log(math.pi)))

    def expansion(self, phi: np.ndarray, sd: float, nodes: Nodes | None = None) -> tuple[float, np.ndarray, np.ndarray]:
        """Log-likelihood, every group's score by (phi, sd) (groups, parameters), and the observed information.

        Fisher's identity and Louis's (1982): score E[s], information -E[h] - Var(s), over a group's random intercept.
        ``nodes``: default those about the modes at (phi, sd).
        """
        upper, lower = self.bounds.upper, self.bounds.lower
        a, b = self.bounds.at(phi)
        points, tau = self.nodes(phi, sd) if nodes is None else nodes
        value, ga, gb, haa, hbb, hab = self._terms(a, b, sd * points[self.codes])
        joint = self._sum(value) - points**2 / 2 + self.log_weight
        posterior, total = _normalised(joint)
        # as sparse products: what is kept is (groups, nodes), never (rows, nodes, parameters)
        by_phi = (self.sum_upper @ ga + self.sum_lower @ gb).reshape(-1, *points.shape)
        slopes = np.concatenate([by_phi, -(self._sum(ga + gb) * points)[None]])
        scores = np.einsum("gk,dgk->gd", posterior, slopes)
        flat = slopes.reshape(len(slopes), -1)
        spread = (flat * posterior.ravel()) @ flat.T - scores.T @ scores
        weight = posterior[self.codes]
        by_a, by_b = np.sum(weight * haa, axis=1), np.sum(weight * hbb, axis=1)
        cross = upper.T @ (np.sum(weight * hab, axis=1)[:, None] * lower)
        weight = weight * points[self.codes]
        by_sd = -upper.T @ np.sum(weight * (haa + hab), axis=1) - lower.T @ np.sum(weight * (hbb + hab), axis=1)
        twice_sd = np.sum(weight * points[self.codes] * (haa + hbb + 2 * hab))
        of_phi = upper.T @ (by_a[:, None] * upper) + lower.T @ (by_b[:, None] * lower) + cross + cross.T
        curvature = np.block([[of_phi, by_sd[:, None]], [by_sd[None, :], np.full((1, 1), twice_sd)]])
        return float(np.sum(total + np.log(tau) - 0.5 * math.log(math.pi))), scores, -curvature - spread

    def _modes(self, a: np.ndarray, b: np.ndarray, sd: float) -> tuple[np.ndarray, np.ndarray]:
        """Most likely u of every group and the curvature there, by Newton's method (concave in u)."""
        if self.wide:
            return np.zeros(len(self.starts)), np.ones(len(self.starts))
        u = self.mode
        for _ in range(60):
            _, ga, gb, haa, hbb, hab = self._terms(a, b, sd * u[self.codes])
            slope = -sd * self._sum(ga + gb) - u
            curve = 1.0 - sd * sd * self._sum(haa + hbb + 2 * hab)
            step = slope / curve
            u = u + np.clip(step, -3.0, 3.0)
            if float(np.max(np.abs(step))) < 1e-7:
                # the next step is of the order of this one's square
                break
        self.mode = u
        return u, curve


def _normalised(joint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every group's (row's) probabilities of its nodes, and the logarithm of their sum."""
    top = joint.max(axis=1)
    weight = np.exp(joint - top[:, None])
    total = weight.sum(axis=1)
    return weight / total[:, None], top + np.log(total)


def fit_mixed(
    bounds: Bounds, groups: np.ndarray, fixed: ThresholdFit, link: str, nodes: int, thresholds: int
) -> ThresholdFit:
    """Maximum likelihood with a random intercept, from the fit without; the first ``thresholds`` of phi are ordered."""
    quadrature = Quadrature(bounds, groups, link, nodes)

    def natural(work: np.ndarray) -> np.ndarray:
        phi = work[:-1].copy()
        if thresholds > 1:
            phi[1:thresholds] = phi[0] + np.cumsum(np.exp(np.minimum(work[1:thresholds], 50.0)))
        return phi

    def objective(work: np.ndarray) -> tuple[float, np.ndarray]:
        if not float(np.max(np.abs(work))) < 300.0:
            # A search that runs away has no maximum: it ends on this plateau, not converged.
            return 1e10, np.zeros_like(work)
        value, gradient = quadrature.evaluate(natural(work), work[-1])
        turned = gradient.copy()
        if thresholds > 1:
            turned[0] = gradient[:thresholds].sum()
            turned[1:thresholds] = np.cumsum(gradient[1:thresholds][::-1])[::-1] * np.exp(work[1:thresholds])
        return -value, -turned

    start = np.append(fixed.phi, 0.7)
    if thresholds > 1:
        start[1:thresholds] = np.log(np.diff(fixed.phi[:thresholds]))
    for start[-1] in (0.7, 0.2):
        found = optimize.minimize(objective, start, jac=True, method="BFGS", options={"gtol": 1e-6, "maxiter": 500})
        theta = np.append(natural(found.x), abs(found.x[-1]))
        if theta[-1] >= 1e-3 and -found.fun > fixed.log_likelihood + 1e-9:
            break
        # The likelihood is level at SD 0, where a search may rest: its curvature says whether 0 is the maximum.
        if quadrature.expansion(fixed.phi, 0.0)[2][-1, -1] >= 0:
            break
    if theta[-1] > WIDE_SD:
        quadrature = Quadrature(bounds, groups, link, nodes, wide=True)
        found = optimize.minimize(objective, found.x, jac=True, method="BFGS", options={"gtol": 1e-6, "maxiter": 500})
        theta = np.append(natural(found.x), abs(found.x[-1]))
    if found.fun >= 1e10 or theta[-1] > 100.0:
        nothing = np.full(len(fixed.phi), math.nan)
        return ThresholdFit(nothing, np.diag(nothing), math.nan, math.inf, math.nan, False)
    if theta[-1] < 1e-3 or -found.fun <= fixed.log_likelihood + 1e-9:
        return ThresholdFit(fixed.phi, fixed.covariance, fixed.log_likelihood, 0.0, math.nan, fixed.converged)
    value, scores, information = quadrature.expansion(theta[:-1], theta[-1])
    for _ in range(4):
        # Newton's steps to the last digits.
        gradient = scores.sum(axis=0)
        step = np.linalg.lstsq(information, gradient, rcond=None)[0]
        trial = theta + step
        ordered = thresholds < 2 or bool(np.all(np.diff(trial[:thresholds]) > 0))
        if not ordered or trial[-1] <= 0 or float(np.max(np.abs(step))) > 1.0:
            break
        reached = quadrature.expansion(trial[:-1], trial[-1])
        if not np.max(np.abs(reached[1].sum(axis=0))) < np.max(np.abs(gradient)):
            break
        theta, (value, scores, information) = trial, reached
        if float(np.max(np.abs(step))) < 1e-9:
            break
    covariance = np.linalg.pinv(information, hermitian=True)
    converged = bool(np.max(np.abs(scores.sum(axis=0))) < 1e-4 * (1 + abs(value)) ** 0.5)
    sd_se = math.sqrt(max(float(covariance[-1, -1]), 0.0))
    return ThresholdFit(theta[:-1], covariance[:-1, :-1], value, float(theta[-1]), sd_se, converged)
