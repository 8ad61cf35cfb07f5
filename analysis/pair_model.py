"""Maximum likelihood of paired-comparison models: the fit behind Bradley-Terry and Thurstone.

P(i beats j) = F(a_i - a_j + order), F logistic or normal; with ties Davidson's (1970) model
P(tie) ~ nu sqrt(pi_i pi_j), pi = exp(a). Whether a finite maximum exists is decided on the graph of wins before
anything is fitted (Ford 1957; Zermelo 1929): it must be strongly connected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse, special
from scipy.sparse import csgraph

MAX_STEP = 2.0


@dataclass(frozen=True)
class Pairs:
    """Outcomes by ordered pair: ``first[r]`` met ``second[r]``; counts of wins of the first, of the second, and ties.

    ``order[r]``: +1 where the first item was presented first, -1 where the second was, 0 where it does not matter.
    """

    first: np.ndarray
    second: np.ndarray
    order: np.ndarray
    wins: np.ndarray
    losses: np.ndarray
    ties: np.ndarray

    def reweighted(self, wins: np.ndarray, losses: np.ndarray, ties: np.ndarray) -> Pairs:
        """The same pairs with other counts."""
        return Pairs(self.first, self.second, self.order, wins, losses, ties)


@dataclass(frozen=True)
class Fit:
    """Parameters (items 1 ... m - 1, then order effect, then log nu), their covariance, and how the search ended."""

    parameters: np.ndarray
    covariance: np.ndarray
    log_likelihood: float
    converged: bool


def components(pairs: Pairs, items: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Label of each item's compared-with component, its strong component, and reachability by wins (items, items)."""
    wins = np.zeros((items, items), dtype=bool)
    np.logical_or.at(wins, (pairs.first, pairs.second), (pairs.wins > 0) | (pairs.ties > 0))
    np.logical_or.at(wins, (pairs.second, pairs.first), (pairs.losses > 0) | (pairs.ties > 0))
    graph = sparse.csr_matrix(wins)
    _, weak = csgraph.connected_components(graph, directed=True, connection="weak")
    _, strong = csgraph.connected_components(graph, directed=True, connection="strong")
    reach = np.isfinite(csgraph.shortest_path(graph, directed=True, unweighted=True)) if items > 1 else np.eye(1) > 0
    return weak, strong, reach


def design(pairs: Pairs, items: int, with_order: bool) -> np.ndarray:
    """Rows of the linear predictor a_i - a_j (+ order), the first item fixed at 0."""
    rows = np.arange(len(pairs.first))
    x = np.zeros((len(rows), items + int(with_order)))
    x[rows, pairs.first] += 1.0
    x[rows, pairs.second] -= 1.0
    if with_order:
        x[:, items] = pairs.order
    return x[:, 1:]


def _terms(
    eta: np.ndarray, log_nu: float | None, link: str, w: np.ndarray, l: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Per row: log-likelihood, d/d eta, -d2/d eta2, d/d log nu, -d2/d eta d log nu, -d2/d log nu 2."""
    zero = np.zeros_like(eta)
    if link == "probit":
        log_p, log_q = special.log_ndtr(eta), special.log_ndtr(-eta)
        log_density = -eta * eta / 2 - 0.5 * math.log(2 * math.pi)
        up, down = np.exp(log_density - log_p), np.exp(log_density - log_q)
        value = special.xlogy(w, 1.0) + w * log_p + l * log_q
        return value, w * up - l * down, w * up * (up + eta) + l * down * (down - eta), zero, zero, zero
    # Davidson's tie has weight nu exp(0) between exp(+-eta / 2); without ties log nu is minus infinity.
    terms = np.stack([eta / 2, -eta / 2, np.full_like(eta, -np.inf if log_nu is None else log_nu)])
    total = special.logsumexp(terms, axis=0)
    p_win, p_loss, p_tie = np.exp(terms - total)
    n = w + l + t
    value = w * terms[0] + l * terms[1] - n * total
    if log_nu is not None:
        value = value + t * log_nu
    half = (p_win - p_loss) / 2
    grad = (w - l) / 2 - n * half
    curve = n * ((p_win + p_loss) / 4 - half**2)
    return value, grad, curve, t - n * p_tie, -n * half * p_tie, n * p_tie * (1 - p_tie)


def _expected_probit(eta: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Expected -d2/d eta2 of n normal-ogive answers: n phi^2 / (Phi (1 - Phi))."""
    log_density = -eta * eta / 2 - 0.5 * math.log(2 * math.pi)
    return n * np.exp(2 * log_density - special.log_ndtr(eta) - special.log_ndtr(-eta))


def fit_pairs(pairs: Pairs, x: np.ndarray, link: str, with_ties: bool, start: np.ndarray | None = None) -> Fit:
    """Newton's method with step halving (the log-likelihood is concave)."""
    size = x.shape[1] + int(with_ties)
    theta = np.zeros(size) if start is None else start.copy()
    w, l, t = pairs.wins, pairs.losses, pairs.ties

    def evaluate(theta: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        log_nu = float(theta[-1]) if with_ties else None
        value, grad, curve, g_nu, cross, c_nu = _terms(x @ theta[: x.shape[1]], log_nu, link, w, l, t)
        gradient = x.T @ grad
        information = x.T @ (curve[:, None] * x)
        if with_ties:
            side = x.T @ cross
            gradient = np.append(gradient, g_nu.sum())
            information = np.block([[information, side[:, None]], [side[None, :], np.array([[c_nu.sum()]])]])
        return float(value.sum()), gradient, information

    value, gradient, information = evaluate(theta)
    converged = False
    for _ in range(200):
        step = np.linalg.lstsq(information, gradient, rcond=None)[0]
        longest = float(np.max(np.abs(step), initial=0.0))
        if longest > MAX_STEP:
            step *= MAX_STEP / longest
        factor = 1.0
        while factor > 1e-8:
            trial = theta + factor * step
            new = evaluate(trial)
            if new[0] >= value - 1e-12 * abs(value):
                theta, (value, gradient, information) = trial, new
                break
            factor /= 2
        if longest <= 1e-10 * (1 + float(np.max(np.abs(theta), initial=0.0))) or factor <= 1e-8:
            converged = True
            break
    if link == "probit":
        # Standard errors from the expected information, as a generalised linear model has them.
        information = x.T @ (_expected_probit(x @ theta, w + l)[:, None] * x)
    covariance = np.linalg.pinv(information, hermitian=True) if size else np.zeros((0, 0))
    return Fit(theta, covariance, value, converged and float(np.max(np.abs(theta), initial=0.0)) < 25.0)


def scores(pairs: Pairs, x: np.ndarray, link: str, theta: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Score of each observer at ``theta``; ``counts`` (observers, 3, rows) of wins, losses, ties. (observers, size)."""
    with_ties = len(theta) > x.shape[1]
    log_nu = float(theta[-1]) if with_ties else None
    _, grad, _, g_nu, _, _ = _terms(
        x @ theta[: x.shape[1]], log_nu, link, counts[:, 0], counts[:, 1], counts[:, 2]
    ) if link == "probit" else _stacked(x @ theta[: x.shape[1]], log_nu, counts)  # fmt: skip
    found = grad @ x
    return np.hstack([found, g_nu.sum(axis=1, keepdims=True)]) if with_ties else found


def _stacked(eta: np.ndarray, log_nu: float | None, counts: np.ndarray) -> tuple[np.ndarray, ...]:
    made = [_terms(eta, log_nu, "logit", *person) for person in counts]
    return tuple(np.array([terms[k] for terms in made]) for k in range(6))


def fit_many(x: np.ndarray, link: str, wins: np.ndarray, losses: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Fits without ties to many sets of counts at once, (sets, rows) -> (sets, parameters); nan where one diverges.

    Newton's method for all sets together, with steps cut to ``MAX_STEP``: what a bootstrap asks for.
    """
    theta = np.tile(start, (len(wins), 1))
    if not len(start):
        return theta
    active = np.arange(len(wins))
    for _ in range(60):
        eta = theta[active] @ x.T
        _, grad, curve, *_ = _terms(eta, None, link, wins[active], losses[active], np.zeros_like(eta))
        gradient = grad @ x
        information = np.einsum("br,ri,rj->bij", curve, x, x)
        diagonal = np.einsum("bii->bi", information)
        diagonal += 1e-10 * (1e-3 + diagonal.max(axis=1, keepdims=True))
        step = np.linalg.solve(information, gradient[..., None])[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        theta[active] += step * np.minimum(1.0, MAX_STEP / np.maximum(longest, 1e-300))
        moving = (longest[:, 0] > 1e-8) & (np.abs(theta[active]).max(axis=1) < 20.0)
        active = active[moving]
        if not len(active):
            break
    diverged = ~(np.abs(theta).max(axis=1) < 12.0)
    diverged[active] = True
    theta[diverged] = np.nan
    return theta


def saturated_deviance(pairs: Pairs, x: np.ndarray, theta: np.ndarray, link: str, with_ties: bool) -> tuple[float, int]:
    """Deviance against the model with a free probability per pair and order, and its degrees of freedom."""
    log_nu = float(theta[-1]) if with_ties else None
    value, *_ = _terms(x @ theta[: x.shape[1]], log_nu, link, pairs.wins, pairs.losses, pairs.ties)
    n = pairs.wins + pairs.losses + pairs.ties
    with np.errstate(divide="ignore", invalid="ignore"):
        best = sum(special.xlogy(c, np.where(n > 0, c / n, 1.0)) for c in (pairs.wins, pairs.losses, pairs.ties))
    deviance = 2 * float(np.sum(best - value))
    return max(deviance, 0.0), int((n > 0).sum()) * (2 if with_ties else 1) - len(theta)


def log_coefficients(pairs: Pairs) -> float:
    """Sum of the logarithms of the binomial (multinomial) coefficients."""
    n = pairs.wins + pairs.losses + pairs.ties
    parts = special.gammaln(pairs.wins + 1) + special.gammaln(pairs.losses + 1) + special.gammaln(pairs.ties + 1)
    return float(np.sum(special.gammaln(n + 1) - parts))
