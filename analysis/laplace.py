"""Threshold models with several random intercepts (crossed or nested) by the Laplace approximation."""

from __future__ import annotations

import math

import numpy as np
from scipy import optimize

from analysis.formula import RandomTerm
from analysis.threshold_bounds import Bounds
from analysis.threshold_model import ThresholdFit


class Laplace:
    """Log-likelihood with random effects at their mode; keeps the mode between calls as the next start."""

    def __init__(self, bounds: Bounds, random: list[RandomTerm], link: str) -> None:
        self.bounds, self.link = bounds, link
        sizes = [len(term.levels) for term in random]
        self.z = np.zeros((len(bounds.upper), sum(sizes)))
        self.owner = np.repeat(np.arange(len(random)), sizes)
        for term, start in zip(random, np.cumsum([0, *sizes[:-1]]), strict=True):
            self.z[np.arange(len(term.codes)), start + term.codes] = term.design
        self.u = np.zeros(self.z.shape[1])

    def evaluate(self, phi: np.ndarray, sds: np.ndarray) -> float:
        """Laplace approximation of the log-likelihood."""
        a, b = self.bounds.at(phi)
        z = self.z * sds[self.owner]

        def terms(u: np.ndarray) -> tuple[np.ndarray, ...]:
            shift = z @ u
            return self.bounds.terms(a - shift, b - shift, self.link)

        u = self.u
        value, ga, gb, haa, hbb, hab = terms(u)
        joint = float(value.sum()) - float(u @ u) / 2
        for _ in range(50):
            gradient = -z.T @ (ga + gb) - u
            hessian = np.eye(len(u)) - z.T @ ((haa + hbb + 2 * hab)[:, None] * z)
            step = np.linalg.solve(hessian, gradient)
            if float(np.max(np.abs(step))) < 1e-9:
                break
            factor = 1.0
            while factor > 1e-6:
                trial = terms(u + factor * step)
                reached = float(trial[0].sum()) - float((u + factor * step) @ (u + factor * step)) / 2
                if reached >= joint - 1e-12 * abs(joint):
                    u, joint = u + factor * step, reached
                    value, ga, gb, haa, hbb, hab = trial
                    break
                factor /= 2
            else:
                break
        self.u = u
        hessian = np.eye(len(u)) - z.T @ ((haa + hbb + 2 * hab)[:, None] * z)
        return joint - 0.5 * float(np.linalg.slogdet(hessian)[1])


def fit_crossed(
    bounds: Bounds, random: list[RandomTerm], fixed: ThresholdFit, link: str, thresholds: int
) -> tuple[ThresholdFit, dict[str, float]]:
    """Maximise the Laplace approximation over fixed effects and standard deviations; SDs by the terms' names."""
    laplace = Laplace(bounds, random, link)
    m, size = len(random), len(fixed.phi)

    def natural(work: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phi = work[:size].copy()
        if thresholds > 1:
            phi[1:thresholds] = phi[0] + np.cumsum(np.exp(np.minimum(work[1:thresholds], 50.0)))
        return phi, work[size:]

    def objective(work: np.ndarray) -> float:
        return -laplace.evaluate(*natural(work))

    start = np.concatenate([fixed.phi, np.full(m, 0.5)])
    if thresholds > 1:
        start[1:thresholds] = np.log(np.diff(fixed.phi[:thresholds]))
    box = [(None, None)] * size + [(0.0, None)] * m
    for _ in range(1 + m):
        found = optimize.minimize(objective, start, method="L-BFGS-B", jac="3-point", bounds=box,
                                  options={"ftol": 1e-12, "gtol": 1e-6, "maxiter": 300})  # fmt: skip
        # The likelihood is level in an SD of 0, and a search that touched 0 stays there: is a small SD better?
        stuck = np.zeros(len(start), dtype=bool)
        for place in size + np.flatnonzero(found.x[size:] < 1e-3):
            stuck[place] = objective(np.where(np.arange(len(start)) == place, 0.1, found.x)) < found.fun - 1e-9
        if not stuck.any():
            break
        start = np.where(stuck, 0.3, found.x)
    phi, sds = natural(found.x)
    sds = np.where(sds < 1e-3, 0.0, sds)
    free = np.concatenate([np.ones(size, dtype=bool), sds > 0])
    theta = np.concatenate([phi, sds])

    def at(point: np.ndarray) -> float:
        full = theta.copy()
        full[free] = point
        return laplace.evaluate(full[:size], full[size:])

    hessian = _hessian(at, theta[free])
    covariance = np.linalg.pinv(-hessian, hermitian=True)[:size, :size]
    value = laplace.evaluate(phi, sds)
    converged = bool(
        found.success or float(np.max(np.abs(found.jac[:size]), initial=0.0)) < 1e-3 * math.sqrt(1 + abs(value))
    )
    names = {term.name: float(sd) for term, sd in zip(random, sds, strict=True)}
    return ThresholdFit(phi, covariance, value, float(sds[0]), math.nan, converged), names


def _hessian(function: object, point: np.ndarray) -> np.ndarray:
    """Central second differences."""
    assert callable(function)
    size, h = len(point), 1e-3
    steps = np.eye(size) * h * np.maximum(1.0, np.abs(point))
    middle = function(point)
    hessian = np.zeros((size, size))
    for i in range(size):
        up, down = function(point + steps[i]), function(point - steps[i])
        hessian[i, i] = (up - 2 * middle + down) / steps[i, i] ** 2
        for j in range(i):
            corners = [function(point + s * steps[i] + t * steps[j]) * s * t for s in (1, -1) for t in (1, -1)]
            hessian[i, j] = hessian[j, i] = sum(corners) / (4 * steps[i, i] * steps[j, j])
    return hessian
