"""Models and tests beside R's own, on unbalanced data made here, where Rscript and the packages are installed."""

from __future__ import annotations

import shutil
import subprocess
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import analysis

PACKAGES = ("lme4", "lmerTest", "ordinal", "afex", "sandwich", "coin")
# Every result is written as NAME.csv with R's own column names.
PROGRAM = """
suppressPackageStartupMessages({library(lmerTest); library(ordinal); library(afex); library(sandwich); library(coin)})
d <- read.csv("trials.csv", stringsAsFactors = TRUE)
d$r <- factor(d$rating)
save <- function(name, table) write.csv(as.data.frame(table), paste0(name, ".csv"))
nested <- lmer(y ~ tech + (1 | p) + (1 | p:tech), d)
save("nested", coef(summary(nested)))
save("nested_f", anova(nested))
crossed <- lmer(y ~ tech * group + x + (1 | p) + (1 | scene), d)
save("crossed", coef(summary(crossed)))
save("crossed_f", anova(crossed))
save("binomial", coef(summary(glmer(hit ~ tech + x + (1 | p), d, family = binomial, nAGQ = 21))))
save("ordinal", coef(summary(clmm(r ~ tech + x + (1 | p), data = d, nAGQ = 21))))
save("probit", coef(summary(clmm(r ~ tech + x + (1 | p), data = d, nAGQ = 21, link = "probit"))))
save("fixed", coef(summary(clm(r ~ tech * x, data = d))))
wide <- read.csv("cells.csv", stringsAsFactors = TRUE)
model <- aov_ez("p", "y", wide, within = c("tech", "scene"), between = "group",
                anova_table = list(correction = "none", es = c("ges", "pes")))
save("anova", model$anova_table)
save("anova_corrected", unclass(summary(model)$pval.adjustments))
signed <- read.csv("signed.csv")
of <- function(...) wilcoxsign_test(a ~ b, signed, ...)
save("wilcoxon", data.frame(p = c(pvalue(of(zero.method = "Wilcoxon", distribution = "exact")),
                                  pvalue(of(zero.method = "Pratt", distribution = "exact")),
                                  pvalue(of(zero.method = "Pratt")))))
chosen <- read.csv("choices.csv")
items <- c("A", "B", "C", "D")
x <- sapply(items, function(item) (chosen$winner == item) - (chosen$loser == item))[, -1]
fit <- glm(rep(1, nrow(chosen)) ~ 0 + x, family = binomial)
save("bradley_terry", data.frame(ability = coef(fit), se = sqrt(diag(vcov(fit))),
                                 robust = sqrt(diag(vcovCL(fit, cluster = chosen$p, type = "HC0")))))
"""


def _trials() -> pd.DataFrame:
    rng = np.random.default_rng(7)
    p, s, t, _ = (v.ravel() for v in np.indices((14, 4, 3, 2)))
    own = rng.normal(size=14)[p] + 0.6 * rng.normal(size=(14, 3))[p, t] + 0.5 * rng.normal(size=4)[s]
    latent = own + 0.5 * t + rng.logistic(size=len(p))
    table = pd.DataFrame({
        "p": [f"p{v:02d}" for v in p], "scene": [f"s{v}" for v in s], "tech": [f"t{v}" for v in t],
        "group": np.where(p % 5 < 2, "old", "young"), "y": latent, "x": rng.normal(size=len(p)),
        "rating": np.digitize(latent, [-2, -1, 0, 1, 2, 3]) + 1, "hit": (latent > 0.5).astype(int),
    })  # fmt: skip
    return table[rng.random(len(table)) > 0.25].reset_index(drop=True)


def _cells() -> pd.DataFrame:
    rng = np.random.default_rng(21)
    p, t, s = (v.ravel() for v in np.indices((13, 4, 3)))
    y = rng.normal(size=13)[p] + rng.normal(size=(13, 4))[p, t] + 0.4 * t * (p % 3) + rng.normal(size=len(p))
    return pd.DataFrame({
        "p": [f"p{v:02d}" for v in p], "tech": [f"t{v}" for v in t], "scene": [f"s{v}" for v in s],
        "group": np.array(["a", "b", "c"])[np.minimum(p % 5, 2)], "y": y,
    })  # fmt: skip


def _choices() -> pd.DataFrame:
    rng = np.random.default_rng(5)
    p, pair, _ = (v.ravel() for v in np.indices((11, 6, 3)))
    low, high = np.triu_indices(4, 1)
    a, b = low[pair], high[pair]
    won = rng.random(len(a)) < 1 / (1 + np.exp(0.4 * (b - a) + 0.5 * rng.normal(size=11)[p]))
    names = np.array(list("ABCD"))
    return pd.DataFrame({"p": p, "winner": names[np.where(won, a, b)], "loser": names[np.where(won, b, a)]})


@pytest.fixture(scope="module")
def by_r(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, pd.DataFrame], dict[str, pd.DataFrame]]:
    """(the tables given to R, R's results by name)."""
    program = shutil.which("Rscript")
    if program is None:
        pytest.skip("R is not installed")
    asked = ", ".join(f"'{name}'" for name in PACKAGES)
    script = f"q(status = !all(sapply(c({asked}), requireNamespace, quietly = TRUE)))"
    if subprocess.run([program, "-e", script], capture_output=True, check=False).returncode:
        pytest.skip(f"R has not all of {', '.join(PACKAGES)}")
    folder = Path(tmp_path_factory.mktemp("r"))
    rng = np.random.default_rng(2)
    signed = pd.DataFrame({"a": rng.integers(-2, 4, 15), "b": rng.integers(-3, 3, 15)})
    given = {"trials": _trials(), "cells": _cells(), "signed": signed, "choices": _choices()}
    for name, table in given.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    (folder / "run.R").write_text(PROGRAM)
    done = subprocess.run([program, "run.R"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return given, {path.stem: pd.read_csv(path, index_col=0) for path in folder.glob("*.csv") if path.stem not in given}


By = tuple[dict[str, pd.DataFrame], dict[str, pd.DataFrame]]


@pytest.mark.parametrize(
    ("name", "formula", "random"),
    [("nested", "y ~ tech", ["(1|p)", "(1|p:tech)"]), ("crossed", "y ~ tech * group + x", ["(1|p)", "(1|scene)"])],
)
def test_linear_mixed_is_that_of_lmertest(by_r: By, name: str, formula: str, random: list[str]) -> None:
    given, theirs = by_r
    made = analysis.linear_mixed(given["trials"], formula, random=random)
    wanted = theirs[name].loc[made["term"]]
    # lme4 ends its search by a tolerance of about 1e-5.
    for ours, column in (("estimate", "Estimate"), ("se", "Std. Error"), ("df", "df"), ("p", "Pr(>|t|)")):
        np.testing.assert_allclose(made[ours], wanted[column], rtol=2e-3, atol=1e-5)
    tests = pd.DataFrame(made.attrs["f_tests"]).set_index("term")
    wanted = theirs[f"{name}_f"].loc[tests.index]
    for ours, column in (("df1", "NumDF"), ("df2", "DenDF"), ("F", "F value"), ("p", "Pr(>F)")):
        np.testing.assert_allclose(tests[ours], wanted[column], rtol=3e-3)


@pytest.mark.parametrize(
    ("name", "fit"),
    [
        ("binomial", partial(analysis.binomial_mixed, formula="hit ~ tech + x", random="(1|p)", test="wald")),
        ("ordinal", partial(analysis.cumulative_link, formula="rating ~ tech + x", random="(1|p)")),
        ("probit", partial(analysis.cumulative_link, formula="rating ~ tech + x", random="(1|p)", link="probit")),
        ("fixed", partial(analysis.cumulative_link, formula="rating ~ tech * x")),
    ],
)
def test_choices_and_ratings_are_those_of_lme4_and_ordinal(by_r: By, name: str, fit: partial[pd.DataFrame]) -> None:
    given, theirs = by_r
    made = fit(given["trials"])
    wanted = theirs[name].loc[made["term"]]
    for ours, column in (("estimate", "Estimate"), ("se", "Std. Error"), ("p", "Pr(>|z|)")):
        np.testing.assert_allclose(made[ours], wanted[column], rtol=2e-3, atol=5e-5)


def test_mixed_anova_of_unequal_groups_is_that_of_afex(by_r: By) -> None:
    given, theirs = by_r
    made = analysis.rm_anova(given["cells"], "y", ["tech", "scene"], "p", between="group").set_index("effect")
    wanted = theirs["anova"].loc[made.index]
    pairs = [("df1", "num Df"), ("df2", "den Df"), ("F", "F"), ("p", "Pr(>F)"), ("eta2_partial", "pes")]
    for ours, column in [*pairs, ("eta2_generalized", "ges")]:
        np.testing.assert_allclose(made[ours], wanted[column], rtol=1e-9)
    corrected = theirs["anova_corrected"]
    for ours, column in (("eps_gg", "GG eps"), ("p_gg", "Pr(>F[GG])"), ("p_hf", "Pr(>F[HF])")):
        np.testing.assert_allclose(made.loc[corrected.index, ours], corrected[column], rtol=1e-9)


def test_signed_ranks_with_ties_and_zeros_are_those_of_coin(by_r: By) -> None:
    given, theirs = by_r
    x, y = given["signed"]["a"], given["signed"]["b"]
    made = [
        analysis.wilcoxon(x, y, exact=True),
        analysis.wilcoxon(x, y, exact=True, zeros="pratt"),
        analysis.wilcoxon(x, y, exact=False, zeros="pratt"),
    ]
    np.testing.assert_allclose([float(one["p"].iloc[0]) for one in made], theirs["wilcoxon"]["p"], rtol=1e-9)


def test_bradley_terry_and_its_errors_over_observers_are_those_of_glm_and_sandwich(by_r: By) -> None:
    given, theirs = by_r
    wanted = theirs["bradley_terry"]
    plain = analysis.bradley_terry(given["choices"], "winner", "loser").iloc[1:]
    robust = analysis.bradley_terry(given["choices"], "winner", "loser", observer="p").iloc[1:]
    np.testing.assert_allclose(plain["ability"], wanted["ability"], rtol=1e-7)
    np.testing.assert_allclose(plain["se"], wanted["se"], rtol=1e-5)
    np.testing.assert_allclose(robust["se"], wanted["robust"], rtol=1e-5)
