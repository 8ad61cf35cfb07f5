"""The planned tests of analysis.R: the text without R, and where R is installed its tables beside our own."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from analysis.csv_export import export_csv
from analysis.exclusions import apply_exclusions, rules_of
from analysis.plan import plan_of, run_plan, with_scenes
from analysis.r_plan import HELPERS, text
from analysis.sessions import combine, read_sessions
from tests.analysis.fabricate import demo_study
from tests.analysis.test_r_script import SAVE, _needs_r

TESTS: list[dict[str, Any]] = [
    {"name": "anova", "test": "rm_anova", "question": "smooth", "within": ["condition", "scene"]},
    {"name": "pairs", "test": "posthoc_t", "question": "smooth", "within": ["condition"], "adjust": "fdr_bh"},
    {"name": "one scene", "test": "posthoc_t", "question": "smooth", "within": ["condition"],
     "where": {"scene": ["bar"]}, "adjust": "none"},
    {"name": "friedman", "test": "friedman", "question": "smooth", "within": ["condition"]},
    {"name": "equal", "test": "tost", "question": "smooth", "a": "tdrt_240", "b": "taa_240", "low": -0.5, "high": 1},
    {"name": "mixed", "test": "linear_mixed", "question": "smooth", "within": ["condition"]},
    {"name": "logit", "test": "binomial_mixed", "dv": "choice", "choice": "tdrt_240"},
    {"name": "ordinal", "test": "cumulative_link", "question": "smooth"},
    {"name": "share", "test": "binomial_choice", "dv": "choice", "choice": "tdrt_240"},
    {"name": "scale", "test": "bradley_terry", "dv": "choice"},
    {"name": "jods", "test": "thurstone", "dv": "choice", "unit": "jod"},
    {"name": "dprimes", "test": "dprime", "dv": "choice", "choice": "tdrt_240"},
    {"name": "shares", "test": "likert_summary", "question": "smooth", "separately_by": ["condition"]},
    {"name": "ranks", "test": "wilcoxon", "question": "smooth", "a": "tdrt_240", "b": "vanilla_60"},
    {"name": "raters", "test": "agreement", "question": "smooth"},
    {"name": "no \"such\" level", "test": "tost", "question": "smooth", "a": "x", "b": "y", "low": -1, "high": 1},
]  # fmt: skip


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, pd.DataFrame]]:
    """The folder with analysis.R, and our own table of every planned test."""
    folder = tmp_path_factory.mktemp("plan")
    demo_study(folder / "data", participants=9, analysis_plan={"tests": TESTS})
    export_csv([folder / "data"], folder / "csv")
    sessions = read_sessions([folder / "data"])
    kept = apply_exclusions(combine(sessions), rules_of(sessions), sessions).kept
    results = run_plan(with_scenes(plan_of(sessions, kept), kept), kept)
    return folder / "csv", {result.test.name: result.table for result in results}


@pytest.fixture(scope="module")
def r_tables(exported: tuple[Path, dict[str, pd.DataFrame]]) -> dict[str, pd.DataFrame]:
    program, (folder, _) = _needs_r(), exported
    made = folder.parent / "made"
    made.mkdir()
    save = SAVE.replace("table <- results[[name]]", "table <- results[[name]]\n  if (is.character(table)) next\n"
                        "  if (!is.data.frame(table) && is.list(table)) table <- table$terms")  # fmt: skip
    done = subprocess.run([program, "-e", save % made], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {path.stem: pd.read_csv(path, index_col=0) for path in made.iterdir()}


def without_strings(script: str) -> str:
    """R code without comments and strings."""
    lines = (re.sub(r'"(?:[^"\\]|\\.)*"', '""', line).partition("#")[0] for line in script.splitlines())
    return "\n".join(lines)


def test_the_script_is_whole_and_calls_only_what_it_defines(exported: tuple[Path, dict[str, pd.DataFrame]]) -> None:
    script = (exported[0] / "analysis.R").read_text(encoding="utf-8")
    code = without_strings(script)
    assert code.count('"') % 2 == 0
    opened: list[str] = []
    for character in code:
        if character in "([{":
            opened.append({"(": ")", "[": "]", "{": "}"}[character])
        elif character in ")]}":
            assert opened.pop() == character
    assert not opened
    defined = set(re.findall(r"^(\w+) <- function", script, flags=re.M))
    called = set(re.findall(r"\b((?:planned|own|chosen|asked|right|wide|person|as)_\w+)\(", without_strings(HELPERS)))
    called |= set(re.findall(r"^keep\(\"\", (\w+)\(", code, flags=re.M))
    assert called <= defined | {"as_factors"}
    for test in TESTS:
        assert re.sub(r"\s+", " ", test["name"]) in script
    assert "agreement is the report's own" in script
    assert "# not made: analysis plan" in script
    assert text('a"b\\c\nd') == '"a\\"b\\\\c d"'


def test_r_makes_the_tests_of_the_plan(
    exported: tuple[Path, dict[str, pd.DataFrame]], r_tables: dict[str, pd.DataFrame]
) -> None:
    ours = exported[1]

    def same(name: str, pairs: dict[str, str], rtol: float = 1e-9, key: str | None = None) -> None:
        theirs, own = r_tables[name], ours[name.replace("-", " ")]
        if key is not None:
            own = own.set_index(key).loc[theirs.index]
        for column, column_of_ours in pairs.items():
            np.testing.assert_allclose(theirs[column], own[column_of_ours], rtol=rtol, atol=1e-9, err_msg=name)

    same("anova", {"F": "F", "ges": "eta2_generalized"}, key="effect")
    same("pairs", {"mean_diff": "mean_diff", "t": "t", "p": "p", "p_adjusted": "p_adjusted"})
    same("one-scene", {"t": "t", "p_adjusted": "p_adjusted"})
    same("friedman", {"chi2": "chi2", "p": "p"})
    same("equal", {"mean_diff": "mean_diff", "t_low": "t_low", "t_high": "t_high", "p": "p"})
    same("share", {"share": "share", "p": "p"})
    same("scale", {"value": "ability"}, rtol=1e-6)
    same("jods", {"value": "scale"}, rtol=1e-6)
    same("dprimes", {"dprime": "dprime"}, rtol=1e-6)
    same("mixed", {"Estimate": "estimate"}, rtol=1e-6, key="term")
    same("logit", {"Estimate": "estimate"}, rtol=1e-3, key="term")
    assert (r_tables["ranks"]["p_normal"] < 0.05).all() == (ours["ranks"]["p"] < 0.05).all()
    if "ordinal" in r_tables:
        theirs, own = r_tables["ordinal"], ours["ordinal"].set_index("term")
        terms = [term for term in theirs.index if term in own.index]
        assert len(terms) >= 2
        np.testing.assert_allclose(theirs.loc[terms, "Estimate"], own.loc[terms, "estimate"], rtol=1e-3)
    means = [r_tables[name]["dv.mean"].iloc[0] for name in sorted(r_tables) if name.startswith("shares-")]
    assert sorted(means) == pytest.approx(sorted(ours["shares"]["mean"]))
