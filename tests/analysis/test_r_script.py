"""The exported analysis.R, run by R where it is installed: its tables are those of our functions."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest

import analysis
from analysis.comparisons import pair_table, with_winner
from analysis.csv_export import export_csv
from tests.analysis.fabricate import demo_study

OWN_EFFECTS = ["(1|participant)", "(1|participant:condition)", "(1|participant:scene)"]
SAVE = """source("analysis.R")
for (name in names(results)) {
  table <- results[[name]]
  file <- paste0(gsub("[^a-z_]+", "-", tolower(name)), ".csv")
  write.csv(if (is.data.frame(table)) table else unclass(table), file.path("%s", file))
}
"""


def _needs_r() -> str:
    program = shutil.which("Rscript")
    if program is None:
        pytest.skip("R is not installed")
    asked = "q(status = !all(sapply(c('afex', 'lme4'), requireNamespace, quietly = TRUE)))"
    if subprocess.run([program, "-e", asked], capture_output=True, check=False).returncode:
        pytest.skip("R has no afex or no lme4")
    return program


@pytest.fixture(scope="module")
def r_tables(tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, dict[str, pd.DataFrame]]:
    """(our table of kept trials, R's tables by name)."""
    program, folder = _needs_r(), tmp_path_factory.mktemp("r")
    demo_study(folder / "data", participants=9)
    export_csv([folder / "data"], folder / "csv")
    (folder / "made").mkdir()
    command = [program, "-e", SAVE % (folder / "made")]
    done = subprocess.run(command, cwd=folder / "csv", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    trials = analysis.load_sessions([folder / "data"])
    made = {path.stem: pd.read_csv(path, index_col=0) for path in (folder / "made").iterdir()}
    return trials[~trials["excluded"].astype(bool)].reset_index(drop=True), made


def rated(trials: pd.DataFrame) -> pd.DataFrame:
    return trials[np.isfinite(trials["rating_smooth"].astype(float))].reset_index(drop=True)


def test_anova_is_that_of_r(r_tables: tuple[pd.DataFrame, dict[str, pd.DataFrame]]) -> None:
    trials, made = r_tables
    theirs = made["smooth-anova"]
    ours = analysis.rm_anova(rated(trials), "rating_smooth", ["condition", "scene"], "participant").set_index("effect")
    assert set(theirs.index) == set(ours.index)
    ours = ours.loc[theirs.index]
    np.testing.assert_allclose(theirs["F"], ours["F"], rtol=1e-9)
    np.testing.assert_allclose(theirs["ges"], ours["eta2_generalized"], rtol=1e-9)
    np.testing.assert_allclose(theirs["pes"], ours["eta2_partial"], rtol=1e-9)
    corrected = np.where(ours["df1"] > 1, ours["p_gg"], ours["p"])
    np.testing.assert_allclose(theirs["Pr(>F)"], corrected, rtol=1e-7)


def test_pairs_and_friedman_are_those_of_r(r_tables: tuple[pd.DataFrame, dict[str, pd.DataFrame]]) -> None:
    trials, made = r_tables
    theirs = made["smooth-pairs-of-condition"]
    ours = analysis.posthoc_t(rated(trials), dv="rating_smooth", within="condition", subject="participant")
    assert theirs[["a", "b"]].to_numpy().tolist() == ours[["a", "b"]].to_numpy().tolist()
    for column, name in (("mean_diff", "mean_diff"), ("t", "t"), ("p", "p"), ("p_holm", "p_adjusted")):
        np.testing.assert_allclose(theirs[column], ours[name], rtol=1e-9)
    friedman = analysis.friedman(rated(trials), dv="rating_smooth", within="condition", subject="participant")
    np.testing.assert_allclose(made["smooth-friedman"]["chi2"], friedman["chi2"], rtol=1e-9)


def test_mixed_model_is_that_of_lmertest(r_tables: tuple[pd.DataFrame, dict[str, pd.DataFrame]]) -> None:
    trials, made = r_tables
    theirs = made["smooth-mixed-model"]
    ours = analysis.linear_mixed(rated(trials), "rating_smooth ~ condition * scene", random=OWN_EFFECTS)
    ours = ours.set_index("term").loc[theirs.index]
    # lme4's optimiser stops at 1e-6 or so of the variances
    np.testing.assert_allclose(theirs["Estimate"], ours["estimate"], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(theirs["Std. Error"], ours["se"], rtol=1e-3)
    np.testing.assert_allclose(theirs["df"], ours["df"], rtol=1e-2)


def test_choices_are_those_of_r(r_tables: tuple[pd.DataFrame, dict[str, pd.DataFrame]]) -> None:
    trials, made = r_tables
    chosen = with_winner(trials)
    ours = analysis.bradley_terry(chosen, winner="winner", loser="loser")
    theirs = made["choice-bradley-terry"]
    assert theirs["item"].tolist() == ours["item"].tolist()
    np.testing.assert_allclose(theirs["ability"], ours["ability"], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(theirs["se_of_trials"], ours["se"], rtol=1e-4, atol=1e-9)
    pairs = pair_table(chosen).set_index(["a", "b"])
    for row in made["choice-pairs"].itertuples():
        known = (row.a, row.b) in pairs.index
        own = pairs.loc[(row.a, row.b) if known else (row.b, row.a)]
        assert row.share == pytest.approx(own["share"] if known else 1 - own["share"], rel=1e-9)
        assert row.p == pytest.approx(own["p"], rel=1e-7)
