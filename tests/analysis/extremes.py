"""The extremes that every statistics function must survive: tables, and how each function is called on them."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pandas as pd

import analysis

Table = pd.DataFrame


def study(n: int = 12, levels: int = 3, repetitions: int = 2, seed: int = 7) -> Table:
    """An ordinary study: ratings -3 ... 3 of ``levels`` conditions in two scenes, choices, and reaction times."""
    rng = np.random.default_rng(seed)
    rows = []
    for p, c, s, r in itertools.product(range(n), range(levels), range(2), range(repetitions)):
        rating = int(np.clip(round(0.6 * c + 0.4 * (p % 3) + rng.normal()), -3, 3))
        rows.append((f"p{p:02d}", f"c{c}", f"s{s}", r, rating, rating > 0, rng.normal(1 + 0.1 * c, 0.2)))
    table = pd.DataFrame(rows, columns=["participant", "condition", "scene", "repetition", "rating", "yes", "rt_s"])
    rivals = [f"c{(int(c[1]) + 1 + r) % levels}" for c, r in zip(table["condition"], table["repetition"], strict=True)]
    table["rival"] = rivals
    swap = rng.random(len(table)) < 0.45
    table["winner"] = np.where(swap, table["rival"], table["condition"])
    table["loser"] = np.where(swap, table["condition"], table["rival"])
    return table


def _with(table: Table, **columns: object) -> Table:
    return table.assign(**columns)


def _same_difference(table: Table) -> Table:
    """Every participant differs between conditions by the same 0.1 steps (not representable), and nothing else."""
    step = table["condition"].str[1].astype(int) * 0.1
    person = table["participant"].str[1:].astype(int) * 1.7
    rating = person + step
    return _with(table, rating=rating, yes=table["condition"] > "c0", rt_s=rating)


def _only_participants(table: Table) -> Table:
    person = table["participant"].str[1:].astype(int)
    return _with(table, rating=person * 0.37, yes=person % 2 == 0, rt_s=person * 0.37)


def _constant(table: Table) -> Table:
    return _with(table, rating=1, yes=True, rt_s=0.1, winner="c0", loser="c1")


def _empty_cells(table: Table) -> Table:
    """p03 never saw c1, and p05's ratings of c2 are missing."""
    table = table[~((table["participant"] == "p03") & (table["condition"] == "c1"))].copy()
    gone = (table["participant"] == "p05") & (table["condition"] == "c2")
    return _with(table, rating=table["rating"].astype(float).mask(gone), rt_s=table["rt_s"].mask(gone))


def _separated(table: Table) -> Table:
    """Everyone always prefers the higher condition and rates it so."""
    c = table["condition"].str[1].astype(int)
    higher = np.where(table["condition"] > table["rival"], table["condition"], table["rival"])
    lower = np.where(table["condition"] > table["rival"], table["rival"], table["condition"])
    return _with(table, rating=c - 1, yes=c == 2, rt_s=c * 1.0, winner=higher, loser=lower)


def _huge_effect(table: Table) -> Table:
    """So far apart that p is below 1e-308."""
    c = table["condition"].str[1].astype(int)
    jitter = np.random.default_rng(3).normal(size=len(table)) * 1e-5
    return _with(table, rating=c + jitter, rt_s=c + jitter)


def _unused_level(table: Table) -> Table:
    return _with(table, condition=pd.Categorical(table["condition"], ["unused", "c2", "c1", "c0", "never"]))


EXTREMES: dict[str, Callable[[], Table]] = {
    "ordinary": study,
    "constant": lambda: _constant(study()),
    "same_difference": lambda: _same_difference(study()),
    "only_participants_differ": lambda: _only_participants(study()),
    "one_participant": lambda: study(n=1),
    "two_participants": lambda: study(n=2),
    "one_level": lambda: study(levels=1),
    "more_levels_than_participants": lambda: study(n=4, levels=6),
    "empty_cells": lambda: _empty_cells(study()),
    "separated": lambda: _separated(study()),
    "huge_effect": lambda: _huge_effect(study(n=400)),
    "unused_category": lambda: _unused_level(study()),
    "no_rows": lambda: study().iloc[:0],
    "all_missing": lambda: _with(study(), rating=np.nan, yes=np.nan, rt_s=np.nan, winner=None, loser=None),
}


def _two(table: Table) -> tuple[np.ndarray, np.ndarray]:
    """One mean rating a participant at the first and the last condition."""
    means = table.groupby(["participant", "condition"], observed=True)["rating"].mean().unstack()
    if means.shape[1] == 0:
        return np.zeros(0), np.zeros(0)
    return means.iloc[:, 0].to_numpy(float), means.iloc[:, -1].to_numpy(float)


def _counts(table: Table) -> tuple[int, int]:
    yes = table["yes"].dropna().astype(bool)
    return int(yes.sum()), len(yes)


def _levels(table: Table) -> Table:
    """yes by condition as k of n at x = 0, 1, 2."""
    known = table.dropna(subset=["yes"])
    x = known["condition"].astype(str).str[1].astype(float)
    made = pd.DataFrame({"x": x, "k": known["yes"].astype(float), "n": 1.0})
    return made.groupby("x", as_index=False).sum()


def _first_trial(table: Table) -> Table:
    return table[(table["scene"] == "s0") & (table["repetition"] == 0)] if "repetition" in table else table


CALLS: dict[str, Callable[[Table], pd.DataFrame]] = {
    "oneway_anova": lambda t: analysis.oneway_anova(t, dv="rating", between="condition"),
    "rm_anova": lambda t: analysis.rm_anova(t, dv="rating", within=["condition", "scene"], subject="participant"),
    "posthoc_t": lambda t: analysis.posthoc_t(t, dv="rating", within="condition", subject="participant"),
    "aligned_rank_anova": lambda t: analysis.aligned_rank_anova(
        t, dv="rating", within=["condition", "scene"], subject="participant"
    ),
    "friedman": lambda t: analysis.friedman(t, dv="rating", within="condition", subject="participant"),
    "friedman_posthoc": lambda t: analysis.friedman_posthoc(t, "rating", "condition", "participant"),
    "wilcoxon": lambda t: analysis.wilcoxon(*_two(t)),
    "likert_summary": lambda t: analysis.likert_summary(t, dv="rating", by=["condition"]),
    "describe": lambda t: analysis.describe(t, "rating", ["condition"]),
    "binomial_choice": lambda t: analysis.binomial_choice(*_counts(t)),
    "binomial_choice_table": lambda t: analysis.binomial_choice(t, choice="yes", observer="participant"),
    "binomial_mixed": lambda t: analysis.binomial_mixed(t, "yes ~ condition", random="(1|participant)"),
    "bradley_terry": lambda t: analysis.bradley_terry(t, winner="winner", loser="loser"),
    "bradley_terry_observers": lambda t: analysis.bradley_terry(t, "winner", "loser", observer="participant"),
    "thurstone": lambda t: analysis.thurstone(t, winner="winner", loser="loser", observer="participant", n_boot=50),
    "circular_triads": lambda t: analysis.circular_triads(t, "winner", "loser", "participant"),
    "screen_observers": lambda t: analysis.screen_observers(t, "winner", "loser", "participant"),
    "cumulative_link": lambda t: analysis.cumulative_link(t, "rating ~ condition"),
    "cumulative_link_mixed": lambda t: analysis.cumulative_link(t, "rating ~ condition", random="participant", nodes=7),
    "linear_mixed": lambda t: analysis.linear_mixed(t, "rt_s ~ condition", random="(1|participant)"),
    "linear": lambda t: analysis.linear_mixed(t, "rt_s ~ condition"),
    "psychometric": lambda t: analysis.psychometric(_levels(t), x="x", k="k", n="n"),
    "tost": lambda t: analysis.tost(*_two(t), low=-0.5, high=0.5),
    "mcnemar": lambda t: analysis.mcnemar(_counts(t)[0], _counts(t)[1] - _counts(t)[0]),
    "cochran_q": lambda t: analysis.cochran_q(_first_trial(t), dv="yes", within="condition", subject="participant"),
    "dprime": lambda t: analysis.dprime(*_counts(t)),
    "agreement": lambda t: analysis.agreement(t, item="condition", rater="participant", rating="rating", n_boot=50),
}
