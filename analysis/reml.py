"""The restricted likelihood of variance components, with analytic derivatives, and its maximum."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import linalg, optimize

from analysis.formula import RandomTerm
from analysis.newton import uphill_step


def _cross(a: RandomTerm, b: RandomTerm, m: int, k: int) -> np.ndarray:
    """Z_a' Z_b."""
    return np.bincount(a.codes * k + b.codes, weights=a.design * b.design, minlength=m * k).reshape(m, k)


def _by_group(term: RandomTerm, values: np.ndarray, size: int) -> np.ndarray:
    """Z' values."""
    return np.bincount(term.codes, weights=term.design * values, minlength=size)


class Reml:
    """Restricted likelihood of variances (residual first) for a response and an orthonormal design."""

    def __init__(self, y: np.ndarray, q: np.ndarray, random: list[RandomTerm]) -> None:
        self.n, self.p = q.shape
        sizes = [len(np.unique(term.codes)) for term in random]
        self.owner = np.repeat(np.arange(len(random)), sizes)
        # Cross-products of the incidence matrices by counting: Z itself (rows by groups) is never formed.
        zz = np.block([[_cross(a, b, m, k) for b, k in zip(random, sizes, strict=True)]
                       for a, m in zip(random, sizes, strict=True)])  # fmt: skip
        zq = np.vstack([np.stack([_by_group(t, c, m) for c in q.T], 1) for t, m in zip(random, sizes, strict=True)])
        zy = np.concatenate([_by_group(t, y, m) for t, m in zip(random, sizes, strict=True)])[:, None]
        qy = (q.T @ y)[:, None]
        gram = np.block([[zz, zq, zy], [zq.T, np.eye(self.p), qy], [zy.T, qy.T, np.array([[float(y @ y)]])]])
        # Z = U R' with orthonormal U: on its span V is K = s0 I + sum s_k R_k' R_k (of any sign), elsewhere s0 I.
        values, vectors = np.linalg.eigh(zz)
        kept = values > len(values) * 1e-15 * values[-1]
        roots = np.sqrt(values[kept])
        r = vectors[:, kept] * roots
        self.parts = [r[self.owner == j].T @ r[self.owner == j] for j in range(len(random))]
        self.inside = (vectors[:, kept] / roots).T @ gram[: len(zz)]
        self.outside = gram - self.inside.T @ self.inside
        self.outside[: len(zz)] = self.outside[:, : len(zz)] = 0.0

    def state(self, variances: np.ndarray) -> dict[str, Any]:
        """Restricted log-likelihood, its gradient and (negative) Hessian by the variances, and the coefficients.

        Variances may be negative; LinAlgError where V is not positive definite.
        """
        s0, s = variances[0], variances[1:]
        if not s0 > 0:
            raise np.linalg.LinAlgError("the residual variance is not positive")
        k_matrix = sum((v * part for v, part in zip(s, self.parts, strict=True)), s0 * np.eye(len(self.inside)))
        root = linalg.cholesky(k_matrix, lower=True, check_finite=False)
        # (Z X y)' V^-1 (Z X y) in one piece.
        half = linalg.solve_triangular(root, self.inside, lower=True, check_finite=False)
        whole = self.outside / s0 + half.T @ half
        q = len(self.owner)
        g, x = slice(0, q), slice(q, q + self.p)
        z_v_z, z_v_x, x_v_x = whole[g, g], whole[g, x], whole[x, x]
        z_v_y, x_v_y, y_v_y = whole[g, -1], whole[x, -1], float(whole[-1, -1])
        inverse = np.linalg.inv(x_v_x)
        beta = inverse @ x_v_y
        y_p_y = y_v_y - float(x_v_y @ beta)
        z_p_z, z_p_y = z_v_z - z_v_x @ inverse @ z_v_x.T, z_v_y - z_v_x @ beta
        log_det_v = (self.n - len(root)) * math.log(s0) + 2 * float(np.sum(np.log(np.diag(root))))
        value = -0.5 * (
            log_det_v + float(np.linalg.slogdet(x_v_x)[1]) + y_p_y + (self.n - self.p) * math.log(2 * math.pi)
        )
        k = len(s)
        block = [self.owner == j for j in range(k)]
        trace = np.array([float(np.trace(z_p_z[np.ix_(b, b)])) for b in block])
        square = np.array([float(z_p_y[b] @ z_p_y[b]) for b in block])
        tr_p, y_pp_y = (self.n - self.p - float(s @ trace)) / s0, (y_p_y - float(s @ square)) / s0
        gradient = 0.5 * np.concatenate([[y_pp_y - tr_p], square - trace])
        # Negative second derivatives; those with V = s0 I + sum s_k V_k itself are known and give the rest.
        hessian = np.zeros((k + 1, k + 1))
        for i in range(k):
            for j in range(k):
                part = z_p_z[np.ix_(block[i], block[j])]
                hessian[i + 1, j + 1] = float(z_p_y[block[i]] @ part @ z_p_y[block[j]]) - 0.5 * float(np.sum(part**2))
        with_v = square - 0.5 * trace
        hessian[0, 1:] = hessian[1:, 0] = (with_v - hessian[1:, 1:] @ s) / s0 if k else 0.0
        hessian[0, 0] = ((y_pp_y - 0.5 * tr_p) - float(s @ hessian[0, 1:])) / s0
        return {
            "value": value, "gradient": gradient, "information": hessian, "beta": beta, "covariance": inverse,
            "z_v_x": z_v_x, "x_v_x": x_v_x, "block": block, "y_p_y": y_p_y, "square": square, "trace": trace,
        }  # fmt: skip

    def covariance_slopes(self, state: dict[str, Any], variances: np.ndarray) -> list[np.ndarray]:
        """d Cov(beta) / d variance, residual first."""
        c = state["covariance"]
        by_random = []
        for b in state["block"]:
            zx = state["z_v_x"][b]
            by_random.append(c @ zx.T @ zx @ c)
        # Cov(beta) is homogeneous of degree 1 in the variances.
        weighted = sum((s * m for s, m in zip(variances[1:], by_random, strict=True)), np.zeros_like(c))
        return [(c - weighted) / variances[0], *by_random]


def maximise(reml: Reml, start: np.ndarray) -> tuple[np.ndarray, bool]:
    """Variances at the maximum, and convergence: L-BFGS-B on ratios of standard deviations, then Newton."""
    k = len(start) - 1

    def objective(work: np.ndarray) -> tuple[float, np.ndarray]:
        # The residual variance c that is best for given ratios has a closed form; V(c) = c V(1).
        state = reml.state(np.concatenate([[1.0], work**2]))
        y_p_y, df = max(state["y_p_y"], 1e-300), reml.n - reml.p
        c = y_p_y / df
        value = state["value"] + 0.5 * y_p_y - 0.5 * df * (math.log(c) + 1)
        return -value, -0.5 * (state["square"] / c - state["trace"]) * 2 * work

    best: tuple[float, np.ndarray] | None = None
    for ratio in (1.0, 0.1) if len(reml.owner) < 150 else (0.7,):
        start_at = np.full(k, ratio)
        for _ in range(1 + k):
            found = optimize.minimize(
                objective, start_at, jac=True, method="L-BFGS-B", bounds=[(0.0, 1e4)] * k,
                options={"ftol": 1e-11, "gtol": 1e-6, "maxiter": 500},
            )  # fmt: skip
            if best is None or found.fun < best[0]:
                best = (float(found.fun), found.x)
            # By standard deviations the likelihood is level at 0, and a search that touched 0 stays there: its slope
            # by the variance says whether 0 is the maximum.
            stuck = (found.x < 1e-4) & _rises(reml, found.x)
            if not stuck.any():
                break
            start_at = np.where(stuck, 0.3, found.x)
    assert best is not None
    ratios = np.concatenate([[1.0], best[1] ** 2])
    variances = ratios * max(reml.state(ratios)["y_p_y"], 1e-300) / (reml.n - reml.p)
    variances[1:][variances[1:] < 1e-8 * variances[0]] = 0.0
    free = variances > 0
    converged = False
    for _ in range(30):
        state = reml.state(variances)
        step = np.zeros(k + 1)
        step[free] = np.linalg.lstsq(state["information"][np.ix_(free, free)], state["gradient"][free], rcond=None)[0]
        trial = variances + step
        size = float(np.max(np.abs(step / np.where(free, variances, 1.0))))
        if size < 1e-7:
            converged = True
        if size < 1e-12 or not (trial[free] > 0).all() or size > 0.5:
            break
        if reml.state(trial)["value"] < state["value"] - 1e-9 * abs(state["value"]):
            break
        variances = trial
    gradient = reml.state(variances)["gradient"][free] * variances[free]
    return variances, converged or bool(np.max(np.abs(gradient)) < 1e-3)


def _rises(reml: Reml, ratios: np.ndarray) -> np.ndarray:
    """Which variances the profile likelihood would have larger, at these ratios of standard deviations."""
    state = reml.state(np.concatenate([[1.0], ratios**2]))
    slope = state["square"] * (reml.n - reml.p) / max(state["y_p_y"], 1e-300) - state["trace"]
    return np.asarray(slope > 1e-6 * np.abs(state["trace"]))


def below_zero(reml: Reml, variances: np.ndarray) -> np.ndarray | None:
    """The maximum over all variances with which V is positive definite, from one at which some are held at 0.

    None where the search does not end (the likelihood may have no maximum there).
    """
    theta = variances.copy()
    state = reml.state(theta)
    for _ in range(100):
        step = uphill_step(state["information"], state["gradient"])
        gain, factor = float(state["gradient"] @ step), 1.0
        while factor > 1e-8:
            try:
                reached = reml.state(theta + factor * step)
            except np.linalg.LinAlgError:
                reached = None
            if reached is not None and reached["value"] >= state["value"] - 1e-13 * abs(state["value"]):
                break
            factor /= 2
        else:
            return theta if gain < 1e-10 else None
        theta, state = theta + factor * step, reached
        if gain < 1e-16 * (1 + abs(state["value"])):
            return theta
    return None
