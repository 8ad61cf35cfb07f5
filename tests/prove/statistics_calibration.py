"""Null studies through every test: how often each rejects at the 5 % level, and how often 95 % intervals miss.

``python -m tests.prove.statistics_calibration [STUDIES]`` (default 1,000 a test and size) writes
``evidence/statistics_calibration.json`` and prints the table. Observers differ (random preference per participant and
technique, SD 0, 0.5, 1 logit; per scene and technique, SD 0, 0.3), lapse (3 %) and lean to one side (0.3 logit).
"""

from __future__ import annotations

import itertools
import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

import analysis

LOW, HIGH = 0.037, 0.065
SIZES = (12, 24)
TECHNIQUES, SCENES, REPETITIONS = 3, 4, 3
LAPSE, SIDE_BIAS = 0.03, 0.3


@dataclass(frozen=True)
class Observers:
    """How observers differ: SDs in logits of preference by technique, and by scene and technique."""

    preference_sd: float
    scene_sd: float


OBSERVERS = tuple(Observers(p, s) for p, s in itertools.product((0.0, 0.5, 1.0), (0.0, 0.3)))


def choices(n: int, observers: Observers, rng: np.random.Generator) -> pd.DataFrame:
    """Side-by-side choices among all pairs of techniques with no preference in the population."""
    own = observers.preference_sd * rng.standard_normal((n, TECHNIQUES))
    there = observers.scene_sd * rng.standard_normal((n, SCENES, TECHNIQUES))
    low, high = np.triu_indices(TECHNIQUES, 1)
    p, s, pair, _ = (v.ravel() for v in np.indices((n, SCENES, len(low), REPETITIONS)))
    a, b = low[pair], high[pair]
    left = rng.random(len(a)) < 0.5
    eta = own[p, a] - own[p, b] + there[p, s, a] - there[p, s, b] + SIDE_BIAS * np.where(left, 1.0, -1.0)
    won = np.where(rng.random(len(a)) < LAPSE, rng.random(len(a)) < 0.5, rng.random(len(a)) < special.expit(eta))
    winner, loser = np.where(won, a, b), np.where(won, b, a)
    return pd.DataFrame({
        "participant": p, "scene": s, "pair": pair, "winner": winner, "loser": loser,
        "first": np.where(left, a, b), "chosen": won.astype(int),
    })  # fmt: skip


def ratings(n: int, observers: Observers, rng: np.random.Generator) -> pd.DataFrame:
    """Likert ratings -3 ... 3 without an effect of technique; observers differ by offset and preference."""
    own = rng.standard_normal((n, 1)) + observers.preference_sd * rng.standard_normal((n, TECHNIQUES))
    there = observers.scene_sd * rng.standard_normal((n, SCENES, TECHNIQUES))
    p, s, t, _ = (v.ravel() for v in np.indices((n, SCENES, TECHNIQUES, REPETITIONS)))
    latent = own[p, t] + there[p, s, t] + rng.logistic(size=len(p))
    rating = np.digitize(latent, [-3.0, -1.8, -0.6, 0.6, 1.8, 3.0]) - 3
    labels = np.array([f"t{i}" for i in range(TECHNIQUES)], dtype=object)
    return pd.DataFrame({"participant": p, "scene": s, "technique": labels[t], "rating": rating, "latent": latent})


def means(table: pd.DataFrame, column: str = "rating") -> np.ndarray:
    """Participants by techniques."""
    return table.groupby(["participant", "technique"])[column].mean().unstack().to_numpy()


def _hit(result: pd.DataFrame, row: int = 0, column: str = "p") -> float:
    p = float(result[column].iloc[row])
    return math.nan if math.isnan(p) else float(p < 0.05)


def _missed(result: pd.DataFrame, row: int, low: str, high: str, truth: float = 0.0) -> float:
    found = result.iloc[row]
    return math.nan if math.isnan(found[low]) else float(not found[low] <= truth <= found[high])


Probe = Callable[[pd.DataFrame], dict[str, float]]


def _rm_anova(t: pd.DataFrame) -> dict[str, float]:
    made = analysis.rm_anova(t, "rating", ["technique", "scene"], "participant")
    return {"rm_anova p": _hit(made), "rm_anova p_gg": _hit(made, 0, "p_gg"), "rm_anova p_hf": _hit(made, 0, "p_hf")}


def _posthoc(t: pd.DataFrame) -> dict[str, float]:
    made = analysis.posthoc_t(t, "rating", "technique", "participant")
    return {
        "posthoc_t p": _hit(made),
        "posthoc_t interval": _missed(made, 0, "ci_low", "ci_high"),
        "posthoc_t dz interval": _missed(made, 0, "dz_low", "dz_high"),
        "posthoc_t family (holm)": float((made["p_adjusted"] < 0.05).any()),
    }


def _ranks(t: pd.DataFrame) -> dict[str, float]:
    y = means(t)
    return {
        "friedman p": _hit(analysis.friedman(t, "rating", "technique", "participant")),
        "friedman Iman-Davenport p": _hit(
            analysis.friedman(t, "rating", "technique", "participant"), 0, "iman_davenport_p"
        ),
        "wilcoxon exact p": _hit(analysis.wilcoxon(y[:, 0], y[:, 1], exact=True)),
        "wilcoxon normal p": _hit(analysis.wilcoxon(y[:, 0], y[:, 1], exact=False)),
        "aligned_rank_anova p": _hit(analysis.aligned_rank_anova(t, "rating", ["technique", "scene"], "participant")),
    }


def _tost(t: pd.DataFrame) -> dict[str, float]:
    y = means(t, "latent")
    edge = analysis.tost(y[:, 0] + 0.5, y[:, 1], low=-2.0, high=0.5)
    return {"tost p at the bound": _hit(edge)}


def _linear(t: pd.DataFrame) -> dict[str, float]:
    random = ["(1|participant)", "(1|participant:technique)"]
    made = analysis.linear_mixed(t, "latent ~ technique", random=random, variances="unbounded")
    held = analysis.linear_mixed(t, "latent ~ technique", random=random)
    joint = pd.DataFrame(made.attrs["f_tests"])
    return {
        "linear_mixed p": _hit(made, 1),
        "linear_mixed interval": _missed(made, 1, "ci_low", "ci_high"),
        "linear_mixed F": _hit(joint),
        # as lme4 has it, and as the function does unless asked: too seldom where participants judge alike
        "(linear_mixed, variances held at 0) p": _hit(held, 1),
    }


def _choice(t: pd.DataFrame) -> dict[str, float]:
    pair = t[t["pair"] == 0]
    made = analysis.binomial_choice(pair, choice="chosen", observer="participant")
    counts = analysis.binomial_choice(int(pair["chosen"].sum()), len(pair))
    return {
        "binomial_choice p": _hit(made),
        "binomial_choice exact interval": _missed(made, 0, "exact_low", "exact_high", 0.5),
        "binomial_choice wilson interval": _missed(made, 0, "wilson_low", "wilson_high", 0.5),
        "(pooled binomial, not ours) p": _hit(counts),
    }


def _scales(t: pd.DataFrame) -> dict[str, float]:
    bt = analysis.bradley_terry(t, "winner", "loser", observer="participant")
    jod = analysis.thurstone(t, "winner", "loser", observer="participant", n_boot=500)
    return {
        "bradley_terry interval": _missed(bt, 1, "ci_low", "ci_high"),
        "thurstone interval": _missed(jod, 1, "ci_low", "ci_high"),
    }


def _cumulative(t: pd.DataFrame) -> dict[str, float]:
    two = t[t["technique"] != "t2"]
    made = analysis.cumulative_link(two, "rating ~ technique", random="participant", test="participants")
    row = int(np.flatnonzero(made["term"] == "techniquet1")[0])
    three = analysis.cumulative_link(t, "rating ~ technique", random="participant", test="participants")
    together = pd.DataFrame(three.attrs["f_tests"] or [{"p": math.nan}])
    wald = special.chdtrc(1, float(made["z"].iloc[row]) ** 2)
    return {
        "cumulative_link p": _hit(made, row),
        "cumulative_link interval": _missed(made, row, "ci_low", "ci_high"),
        "cumulative_link term of two coefficients p": _hit(together),
        # what clmm prints: right only where participants do not differ in the effect
        "(cumulative_link Wald, not ours) p": float(wald < 0.05),
    }


def _binomial(t: pd.DataFrame) -> dict[str, float]:
    one = t[t["pair"] == 0]
    made = analysis.binomial_mixed(one, "chosen ~ 1", random="participant")
    wald = special.chdtrc(1, float(made["z"].iloc[0]) ** 2)
    return {
        "binomial_mixed p": _hit(made),
        "binomial_mixed interval": _missed(made, 0, "ci_low", "ci_high"),
        "(binomial_mixed Wald, not ours) p": float(wald < 0.05),
    }


def measured(n: int, observers: Observers, rng: np.random.Generator) -> pd.DataFrame:
    """Normal values with known effects: y of item i by rater j, with item and rater variance 1 and residual 1."""
    i, j = np.indices((n, 4))
    y = rng.standard_normal((n, 1)) + rng.standard_normal((1, 4)) + rng.standard_normal((n, 4))
    return pd.DataFrame({"item": i.ravel(), "rater": j.ravel(), "y": y.ravel(), "noise": rng.standard_normal(4 * n)})


def _effect_sizes(t: pd.DataFrame) -> dict[str, float]:
    """Intervals about effects that are not zero: d_z 0.8, eta squared, intraclass correlations."""
    n = t["item"].nunique()
    shifted = t.assign(y=t["noise"] + 0.5 * t["rater"])
    noncentrality = n * float(np.sum((0.5 * (np.arange(4) - 1.5)) ** 2))
    eta2 = noncentrality / (noncentrality + 4 * n - 4)
    one = analysis.oneway_anova(shifted, "y", "rater", eta2_level=0.95)
    noise = t["noise"].to_numpy().reshape(n, 4)
    pair = pd.DataFrame({"p": np.tile(range(n), 2), "c": np.repeat(["a", "b"], n)})
    pair["y"] = np.concatenate([noise[:, 0] * 1.0 + 0.8, np.zeros(n)])
    dz = analysis.posthoc_t(pair, "y", "c", "p")
    # Without rater variance all three forms have the same true value, 1 / 2.
    plain = t.assign(
        y=np.repeat(noise[:, 3], 4) + np.random.default_rng(int(1e9 * abs(noise[0, 0]))).normal(size=4 * n)
    )
    icc = analysis.agreement(plain, "item", "rater", "y", n_boot=2).set_index("measure")
    full = analysis.agreement(t, "item", "rater", "y", n_boot=2).set_index("measure")
    return {
        "eta2 95 % interval": _missed(one, 0, "eta2_low", "eta2_high", eta2),
        "dz interval at 0.8": _missed(dz, 0, "dz_low", "dz_high", 0.8),
        "ICC1 interval": _missed(icc.loc[["ICC1"]], 0, "ci_low", "ci_high", 0.5),
        "ICC3 interval": _missed(full.loc[["ICC3"]], 0, "ci_low", "ci_high", 0.5),
        "ICC2 interval (approximate)": _missed(full.loc[["ICC2"]], 0, "ci_low", "ci_high", 1 / 3),
    }


def detections(n: int, observers: Observers, rng: np.random.Generator) -> pd.DataFrame:
    """Psychometric data of participants whose thresholds differ about 0 by the preference SD."""
    own = observers.preference_sd * rng.standard_normal(n)
    p, level = (v.ravel() for v in np.indices((n, 7)))
    x = np.linspace(-3, 3, 7)[level]
    k = rng.binomial(20, special.expit(1.5 * (x - own[p])))
    return pd.DataFrame({"participant": p, "x": x, "k": k, "n": 20})


def _psychometric(t: pd.DataFrame) -> dict[str, float]:
    made = analysis.psychometric(t, "x", "k", "n", observer="participant")
    return {"psychometric threshold interval": _missed(made, 0, "ci_low", "ci_high")}


# (name, table, probe, observers it is right for, share of the studies that it is given)
PROBES: tuple[tuple[str, Callable[..., pd.DataFrame], Probe, Callable[[Observers], bool], float], ...] = (
    ("rm_anova", ratings, _rm_anova, lambda o: True, 1.0),
    ("posthoc_t", ratings, _posthoc, lambda o: True, 1.0),
    ("ranks", ratings, _ranks, lambda o: True, 1.0),
    ("tost", ratings, _tost, lambda o: True, 1.0),
    ("linear_mixed", ratings, _linear, lambda o: True, 1.0),
    ("binomial_choice", choices, _choice, lambda o: True, 1.0),
    ("scales", choices, _scales, lambda o: True, 1.0),
    ("effect_sizes", measured, _effect_sizes, lambda o: o == Observers(0.0, 0.0), 1.0),
    ("psychometric", detections, _psychometric, lambda o: o.scene_sd == 0, 1.0),
    ("cumulative_link", ratings, _cumulative, lambda o: True, 1.0),
    ("binomial_mixed", choices, _binomial, lambda o: True, 1.0),
)


def calibrate(studies: int, seed: int = 0, only: str | None = None, sizes: tuple[int, ...] = SIZES) -> pd.DataFrame:
    """Rejection (or miss) rates: columns what, n, preference_sd, scene_sd, rate, studies, within."""
    rows: list[dict[str, Any]] = []
    for index, (name, make, probe, fits, share) in enumerate(PROBES):
        if only not in (None, name):
            continue
        for observers, n in itertools.product(OBSERVERS, sizes):
            if not fits(observers):
                continue
            found: dict[str, list[float]] = {}
            for study in range(max(1, round(studies * share))):
                key = (index, OBSERVERS.index(observers), n, study)
                rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
                for what, value in probe(make(n, observers, rng)).items():
                    found.setdefault(what, []).append(value)
            for what, values in found.items():
                rate = float(np.nanmean(values))
                rows.append({
                    "what": what, "n": n, "preference_sd": observers.preference_sd, "scene_sd": observers.scene_sd,
                    "rate": rate, "studies": len(values), "no_answer": int(np.isnan(values).sum()),
                    "within": LOW <= rate <= HIGH,
                })  # fmt: skip
    return pd.DataFrame(rows)


def summary(table: pd.DataFrame) -> Mapping[str, Any]:
    """Pooled over observers: the rate of each (what, n), with the Monte Carlo standard error."""
    pooled = table.groupby(["what", "n"]).agg(rate=("rate", "mean"), studies=("studies", "sum")).reset_index()
    pooled["mc_se"] = np.sqrt(pooled["rate"] * (1 - pooled["rate"]) / pooled["studies"])
    return {"pooled": pooled.to_dict("records"), "cells": table.to_dict("records")}


def prove() -> None:
    """Full-length evidence."""
    studies = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    only = sys.argv[2] if len(sys.argv) > 2 else None
    table = calibrate(studies, only=only)
    wide = table.assign(
        observers=[f"{p:g}/{s:g}" for p, s in zip(table["preference_sd"], table["scene_sd"], strict=True)]
    )
    print(wide.pivot_table(index=["what", "n"], columns="observers", values="rate").round(3).to_string())
    folder = Path("evidence")
    folder.mkdir(exist_ok=True)
    name = "statistics_calibration" + (f"_{only}" if only else "")
    (folder / f"{name}.json").write_text(json.dumps(summary(table), indent=1))


if __name__ == "__main__":
    prove()
