"""Procedures that learn from the answers, each a generator that is sent them: staircases, QUEST+, active pairs.

`procedure` gives a participant's whole session in that form, fixed blocks included: ``trial = next(p)``, then
``trial = p.send(chosen)`` with the condition chosen (None: no answer), until it stops.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from protocols.blocks import WORD_KINDS, Block
from protocols.cells import block_cells
from protocols.design import TrialMaker, group_of, ordered_blocks, plan, stream
from protocols.study import Study, varied_name
from protocols.trial import Trial

Procedure = Generator[Trial, str | None, None]


def _logistic(x: Any) -> Any:
    from scipy.special import expit  # a fifth of a second, which most protocols need not wait for

    return expit(x)


@dataclass(frozen=True)
class StaircaseResult:
    """``threshold``: mean value at the reversals after the first two (nan where there are fewer than four);
    ``values``: what was shown; ``reversals``: values at which the direction changed."""

    threshold: float
    values: tuple[float, ...]
    reversals: tuple[float, ...]


def staircase(
    values: Sequence[float], down: int = 2, reversals: int = 8, trials: int = 60
) -> Generator[float, bool | None, StaircaseResult]:
    """1-up ``down``-down over ``values``, easiest first (Levitt 1971: 2-down settles at 70.7 % right, 3-down at 79.4).

    Yields a value, is sent whether the answer was right (None, no answer, counts as wrong). Stops after ``reversals``
    changes of direction or ``trials`` answers. A step beyond an end stays there and is no reversal.
    """
    at, run, direction = 0, 0, 0
    shown: list[float] = []
    turned: list[float] = []
    while len(shown) < trials and len(turned) < reversals:
        right = yield values[at]
        shown.append(values[at])
        run = run + 1 if right else 0
        step = 1 if run == down else -1 if not right else 0
        if step:
            run = 0
            if direction and step != direction:
                turned.append(values[at])
            direction = step
            at = min(max(at + step, 0), len(values) - 1)
    kept = turned[2:]
    return StaircaseResult(float(np.mean(kept)) if len(kept) >= 2 else math.nan, tuple(shown), tuple(turned))


@dataclass(frozen=True)
class QuestResult:
    """Posterior mean and SD of the threshold (where the logistic is 1/2) and mean of log10 slope; ``values`` shown."""

    threshold: float
    threshold_sd: float
    log10_slope: float
    values: tuple[float, ...]


def quest_plus(
    values: Sequence[float], guess: float = 0.5, lapse: float = 0.02, trials: int = 60
) -> Generator[float, bool | None, QuestResult]:
    """QUEST+ (Watson 2017): the value whose answer is expected to leave the least entropy over (threshold, slope).

    P(right) = guess + (1 - guess - lapse) logistic(slope (x - threshold)), x = place of the value from hard to easy on
    [0, 1] (values are easiest first). Flat prior: 41 thresholds over a range a quarter wider at each end, 15 slopes
    from 2 to 200 by ratio. ``threshold`` is given in the values' own unit, by interpolation.
    """
    x = np.linspace(1.0, 0.0, len(values))
    thresholds = np.linspace(-0.25, 1.25, 41)
    slopes = np.geomspace(2.0, 200.0, 15)
    right = _logistic(slopes[None, None, :] * (x[:, None, None] - thresholds[None, :, None]))
    right = guess + (1 - guess - lapse) * right  # (values, thresholds, slopes)
    posterior = np.full(right.shape[1:], 1 / right[0].size)
    shown: list[float] = []
    for _ in range(trials):
        # Expected entropy of the posterior for every value: both answers, weighted by their chance.
        expected = np.zeros(len(values))
        for likelihood in (right, 1 - right):
            joint = posterior * likelihood
            chance = joint.sum(axis=(1, 2))
            share = joint / chance[:, None, None]
            expected -= chance * np.sum(share * np.log(np.maximum(share, 1e-300)), axis=(1, 2))
        at = int(np.argmin(expected))
        answer = yield values[at]
        shown.append(values[at])
        if answer is not None:
            posterior = posterior * (right[at] if answer else 1 - right[at])
            posterior = posterior / posterior.sum()
    marginal = posterior.sum(axis=1)
    mean = float(marginal @ thresholds)
    sd = math.sqrt(max(float(marginal @ (thresholds - mean) ** 2), 0.0))
    order = np.argsort(x)
    # Places outside [0, 1] are continued along the outermost step.
    known, unit = x[order], np.asarray(values, float)[order]
    low, high = (unit[1] - unit[0]) / (known[1] - known[0]), (unit[-1] - unit[-2]) / (known[-1] - known[-2])
    value = float(np.interp(mean, known, unit)) + low * min(mean, 0.0) + high * max(mean - 1.0, 0.0)
    return QuestResult(
        value, sd * abs(float(unit[-1] - unit[0])), float(posterior.sum(axis=0) @ np.log10(slopes)), tuple(shown)
    )


@dataclass(frozen=True)
class PairResult:
    """Posterior means (sum 0) and SDs in logits, by name; ``pairs``: (winner, loser) of every answer."""

    mean: Mapping[str, float]
    sd: Mapping[str, float]
    pairs: tuple[tuple[str, str], ...]


def active_pairs(
    names: Sequence[str], trials: int, rng: np.random.Generator, prior_sd: float = 1.5
) -> Generator[tuple[str, str], str | None, PairResult]:
    """The pair whose answer is expected to tell most about the Bradley-Terry strengths (mutual information; the idea
    of ASAP, Mikhailiuk et al. 2021, with a Laplace approximation in place of message passing).

    Yields two names, is sent the winner's (None: no answer). Ties are broken at random. Prior: N(0, prior_sd^2) each.
    """
    n = len(names)
    index = {name: i for i, name in enumerate(names)}
    pairs = list(combinations(range(n), 2))
    wins = np.zeros((n, n))
    done: list[tuple[str, str]] = []
    for _ in range(trials):
        mean, covariance = _strengths(wins, prior_sd)
        gain = np.array([_information(mean, covariance, i, j) for i, j in pairs])
        best = np.flatnonzero(gain >= gain.max() - 1e-9)
        i, j = pairs[int(best[rng.integers(len(best))])]
        winner = yield names[i], names[j]
        if winner is not None:
            won, lost = (i, j) if index[winner] == i else (j, i)
            wins[won, lost] += 1
            done.append((names[won], names[lost]))
    mean, covariance = _strengths(wins, prior_sd)
    centred = mean - mean.mean()
    project = np.eye(n) - 1 / n
    spread = np.sqrt(np.diag(project @ covariance @ project))
    by_mean = dict(zip(names, map(float, centred), strict=True))
    return PairResult(by_mean, dict(zip(names, map(float, spread), strict=True)), tuple(done))


def _strengths(wins: np.ndarray, prior_sd: float) -> tuple[np.ndarray, np.ndarray]:
    """Mode and inverse Hessian of the log posterior (Newton; it is concave, so the steps converge)."""
    n = len(wins)
    theta = np.zeros(n)
    games = wins + wins.T
    for _ in range(50):
        p = _logistic(theta[:, None] - theta[None, :])
        gradient = wins.sum(axis=1) - (games * p).sum(axis=1) - theta / prior_sd**2
        weight = games * p * (1 - p)
        hessian = np.diag(weight.sum(axis=1) + 1 / prior_sd**2) - weight
        step = np.linalg.solve(hessian, gradient)
        theta = theta + step / max(1.0, float(np.abs(step).max()))
        if float(np.abs(step).max()) < 1e-10:
            break
    return theta, np.linalg.inv(hessian)


_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(21)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def _information(mean: np.ndarray, covariance: np.ndarray, i: int, j: int) -> float:
    """Mutual information (nats) between the answer of pair (i, j) and the strengths."""
    variance = float(covariance[i, i] + covariance[j, j] - 2 * covariance[i, j])
    p = _logistic(float(mean[i] - mean[j]) + math.sqrt(max(variance, 0.0)) * _NODES)
    return _entropy(float(_WEIGHTS @ p)) - float(_WEIGHTS @ np.array([_entropy(float(v)) for v in p]))


def _entropy(p: float) -> float:
    p = min(max(p, 1e-15), 1 - 1e-15)
    return -p * math.log(p) - (1 - p) * math.log(1 - p)


def procedure(study: Study, participant: int, seed: int | None = None) -> Procedure:
    """A participant's session as a generator; the same trials as `plan` where no block is adaptive."""
    seed = study.seed if seed is None else seed
    group = group_of(study, participant, seed)
    fixed = plan(study, participant, seed)
    index = 0
    for block in ordered_blocks(study, group, participant, seed):
        if block.kind in WORD_KINDS or block.adaptive is None:
            for trial in (trial for trial in fixed if trial.block == block.name):
                yield replace(trial, index=index)
                index += 1
            continue
        session = _adaptive_block(study, block, group, participant, seed)
        chosen: str | None = None
        trial = next(session)
        while True:
            chosen = yield replace(trial, index=index)
            index += 1
            try:
                trial = session.send(chosen)
            except StopIteration:
                break


def _adaptive_block(study: Study, block: Block, group: Mapping[str, str], participant: int, seed: int) -> Procedure:
    """One procedure a combination of factors, in random turn until all have stopped."""
    varied = block.adaptive
    if varied is None:
        return
    rng = stream(seed, "adaptive", block.name, participant)
    maker = TrialMaker(study, block, group, participant, seed)
    cells = {(tuple(cell.levels.items()), cell.members): cell for cell in block_cells(study, block, group)}
    runs = list(dict.fromkeys(levels for levels, _ in cells))
    trackers: dict[tuple[tuple[str, str], ...], Generator[Any, Any, Any]] = {}
    asked: dict[tuple[tuple[str, str], ...], object] = {}
    for levels in runs:
        if varied.kind == "staircase":
            trackers[levels] = staircase(varied.values, varied.down, varied.reversals, varied.trials)
        elif varied.kind == "quest_plus":
            trackers[levels] = quest_plus(varied.values, 0.5, varied.lapse, varied.trials)
        else:
            of = study.expand(block.compare.of if block.compare else [])
            trackers[levels] = active_pairs(of, varied.trials, rng)
        asked[levels] = next(trackers[levels])
    repetition = 0
    while runs:
        levels = runs[int(rng.integers(len(runs)))]
        wanted = asked[levels]
        if isinstance(wanted, tuple):
            members = wanted if (levels, wanted) in cells else wanted[::-1]
        else:
            members = (varied_name(str(varied.test), float(wanted)), str(varied.standard))  # type: ignore[arg-type]
        order = members if rng.integers(2) else members[::-1]
        chosen = yield maker.trial(cells[levels, members], order, repetition)
        repetition += 1
        sent = chosen if varied.kind == "active_pairs" else None if chosen is None else chosen == varied.standard
        try:
            asked[levels] = trackers[levels].send(sent)
        except StopIteration:
            runs.remove(levels)
