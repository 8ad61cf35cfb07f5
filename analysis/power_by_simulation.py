"""Power by simulation: whole studies are drawn and put through the test that will be used."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from analysis.anova import rm_anova
from analysis.equivalence import tost
from analysis.ordinal import cumulative_link
from analysis.paired_comparison import bradley_terry
from analysis.posthoc import posthoc_t
from analysis.preference import binomial_choice, exact_interval
from analysis.ranks import aligned_rank_anova, friedman
from analysis.results import OK, ZERO_ERROR_VARIANCE, one_of, result_table
from analysis.signed_ranks import wilcoxon
from stimuli.errors import InputError, problem

COLUMNS = ["n", "power", "mc_low", "mc_high", "simulations", "failed"]
Table = pd.DataFrame


@dataclass(frozen=True)
class StudyDesign:
    """A study of ratings or of choices between pairs of conditions, all within participants.

    ``trials``: ratings a condition, or choices a pair. Ratings: mean + ``sd_subject`` (participant) + ``sd_effect``
    (participant and condition) + ``sd_trial``, put on ``scale`` where one is given. Choices: chance logistic in the
    difference of utilities, which differ between participants by ``sd_effect`` logits a condition; ``lapse`` is
    the share of guesses, ``side_bias`` an advantage in logits of the side shown first. ``low``, ``high``: bounds of an
    equivalence test. ``level``: of the test.
    """

    trials: int = 1
    sd_subject: float = 1.0
    sd_effect: float = 0.0
    sd_trial: float = 1.0
    scale: tuple[int, int] | None = None
    lapse: float = 0.0
    side_bias: float = 0.0
    low: float = -0.5
    high: float = 0.5
    level: float = 0.05
    simulations: int = 1000


def rating_table(design: StudyDesign, effects: Mapping[str, float], n: int, rng: np.random.Generator) -> Table:
    """Ratings of ``n`` participants: columns participant, condition, rating."""
    names = list(effects)
    mean = np.array([effects[name] for name in names], dtype=float)
    shape = (n, len(names), design.trials)
    y = mean[:, None] + design.sd_subject * rng.standard_normal((n, 1, 1))
    y = y + design.sd_effect * rng.standard_normal((n, len(names), 1)) + design.sd_trial * rng.standard_normal(shape)
    if design.scale:
        y = np.clip(np.round(y), *design.scale)
    person, condition, _ = np.indices(shape)
    labels = np.array(names, dtype=object)
    return pd.DataFrame({"participant": person.ravel(), "condition": labels[condition.ravel()], "rating": y.ravel()})


def choice_table(design: StudyDesign, effects: Mapping[str, float], n: int, rng: np.random.Generator) -> Table:
    """Choices of ``n`` participants among all pairs: columns participant, winner, loser, first, chosen (the first
    condition in order of ``effects`` won)."""
    names = np.array(list(effects), dtype=object)
    own = np.array(list(effects.values()), dtype=float) + design.sd_effect * rng.standard_normal((n, len(names)))
    low, high = np.triu_indices(len(names), 1)
    shape = (n, len(low), design.trials)
    person, pair, _ = (part.ravel() for part in np.indices(shape))
    a, b = low[pair], high[pair]
    first = rng.random(len(a)) < 0.5
    eta = own[person, a] - own[person, b] + design.side_bias * np.where(first, 1.0, -1.0)
    guess = rng.random(len(a)) < design.lapse
    won = np.where(guess, rng.random(len(a)) < 0.5, rng.random(len(a)) < special.expit(eta))
    winner, loser = np.where(won, a, b), np.where(won, b, a)
    return pd.DataFrame({
        "participant": person, "winner": names[winner], "loser": names[loser],
        "first": names[np.where(first, a, b)], "chosen": won,
    })  # fmt: skip


def _means(table: Table) -> np.ndarray:
    """Mean rating (participants, conditions) of the first two conditions in sorted order."""
    return table.groupby(["participant", "condition"])["rating"].mean().unstack().to_numpy()[:, :2]


def _smallest(result: Table, column: str = "p") -> float:
    """The smallest usable p of a table; nan if there is none."""
    usable = result[result["status"].isin([OK, ZERO_ERROR_VARIANCE])][column].to_numpy(float)
    usable = usable[~np.isnan(usable)]
    return float(usable.min()) if len(usable) else math.nan


def _scale_p(result: Table, n: int) -> float:
    """Wald test that all abilities are equal, Hotelling's F where observers are the unit."""
    if not (result["status"] == OK).all() or n <= len(result):
        return math.nan
    ability, covariance = result["ability"].to_numpy()[1:], np.array(result.attrs["covariance"])[1:, 1:]
    k = len(ability)
    t2 = float(ability @ np.linalg.solve(covariance, ability))
    return float(special.fdtrc(k, n - k, t2 * (n - k) / (k * (n - 1))))


def _tost_p(means: np.ndarray, design: StudyDesign) -> float:
    return float(tost(means[:, 0], means[:, 1], low=design.low, high=design.high)["p"].iloc[0])


# Test name -> (which table it takes, p of a simulated table).
TESTS: dict[str, tuple[str, Callable[[Table, StudyDesign], float]]] = {
    "rm_anova": ("rating", lambda t, d: float(rm_anova(t, "rating", "condition", "participant")["p_gg"].iloc[0])),
    "posthoc_t": ("rating", lambda t, d: _smallest(posthoc_t(t, "rating", "condition", "participant"), "p_adjusted")),
    "aligned_rank_anova": (
        "rating", lambda t, d: float(aligned_rank_anova(t, "rating", "condition", "participant")["p"].iloc[0])),
    "friedman": ("rating", lambda t, d: float(friedman(t, "rating", "condition", "participant")["p"].iloc[0])),
    "wilcoxon": ("rating", lambda t, d: float(wilcoxon(*_means(t).T)["p"].iloc[0])),
    "tost": ("rating", lambda t, d: _tost_p(_means(t), d)),
    "cumulative_link": ("rating", lambda t, d: _smallest(_terms(t))),
    "binomial_choice": (
        "choice", lambda t, d: float(binomial_choice(t, choice="chosen", observer="participant")["p"].iloc[0])),
    "bradley_terry": (
        "choice",
        lambda t, d: _scale_p(bradley_terry(t, "winner", "loser", observer="participant"), t["participant"].nunique())),
}  # fmt: skip


def _terms(table: Table) -> Table:
    """Rows of conditions (not thresholds) of the cumulative link mixed model, Bonferroni-adjusted."""
    made = cumulative_link(table, "rating ~ condition", random="participant", test="participants")
    made = made[~made["term"].str.contains("|", regex=False)].copy()
    made.loc[made["status"] == "boundary", "status"] = OK
    made["p"] = np.minimum(made["p"] * len(made), 1.0)
    return made


def power(
    design: StudyDesign | Mapping[str, Any] | Callable[[int, np.random.Generator], Table],
    test: str | Callable[[Table], float],
    n: int | Sequence[int],
    effects: Mapping[str, float] | Sequence[float] | float,
    seed: int = 0,
) -> pd.DataFrame:
    """Power of ``test`` at each number of participants ``n``, by simulation; one row an n.

    ``design``: a ``StudyDesign``, a mapping of its fields, or a function (n, generator) -> long table (``effects``
    is then its own business; pass {}). ``test``: a name of ``TESTS`` or a function table -> p value. ``effects``:
    condition -> mean rating or utility in logits; a sequence names conditions c1, c2, ...; one number is the
    difference of two. ``mc_low``, ``mc_high``: exact 95 % interval of the simulation. A study whose test has no p
    counts as not significant and in ``failed``. Every (n, simulation) has its own stream of ``seed``. Raises
    InputError for unknown names or fields.
    """
    settings = StudyDesign()
    if isinstance(design, Mapping):
        known = [field.name for field in fields(StudyDesign)]
        for name in design:
            one_of("power", "design", name, known)
        settings = StudyDesign(**design)
    elif isinstance(design, StudyDesign):
        settings = design
    if isinstance(effects, int | float):
        effects = [0.0, float(effects)]
    if not isinstance(effects, Mapping):
        effects = {f"c{i + 1}": float(value) for i, value in enumerate(effects)}
    if not callable(design) and len(effects) < 2:
        raise InputError(problem("power", "effects", f"{len(effects)} conditions", "at least two"))
    kind, decide = ("", None) if callable(test) else TESTS[one_of("power", "test", test, tuple(TESTS))]
    sizes = [n] if isinstance(n, int | np.integer) else list(n)
    rows = []
    for size in sizes:
        if size < 1:
            raise InputError(problem("power", "n", size, "at least one participant"))
        hits = failed = 0
        for simulation in range(settings.simulations):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(size), simulation)))
            if callable(design):
                table = design(int(size), rng)
            else:
                make = choice_table if kind == "choice" else rating_table
                table = make(settings, effects, int(size), rng)
            p = test(table) if callable(test) else decide(table, settings)  # type: ignore[misc]
            failed += math.isnan(p)
            hits += p < settings.level
        low, high = exact_interval(hits, settings.simulations)
        rows.append({"n": int(size), "power": hits / settings.simulations, "mc_low": low, "mc_high": high,
                     "simulations": settings.simulations, "failed": failed, "status": OK,
                     "note": f"{failed} simulated studies had no p" if failed else ""})  # fmt: skip
    named = test if isinstance(test, str) else getattr(test, "__name__", "the given test")
    method = f"Power of {named} at the {settings.level:g} level, {settings.simulations} simulated studies, seed {seed}."
    return result_table(rows, COLUMNS, method=method, n_subjects=max(sizes, default=0))
