"""Power against the noncentral t, and null studies through every test (a fraction of the full-length evidence)."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import analysis
from stimuli.errors import InputError
from tests.prove import statistics_calibration as calibration


def test_power_of_a_paired_t_test_is_that_of_the_noncentral_t() -> None:
    n, effect, sd = 16, 0.8, math.sqrt(2)
    nc = effect / sd * math.sqrt(n)
    critical = stats.t.isf(0.025, n - 1)
    exact = stats.nct.sf(critical, n - 1, nc) + stats.nct.cdf(-critical, n - 1, nc)
    made = analysis.power({"simulations": 400}, "posthoc_t", n, effect, seed=2).iloc[0]
    assert made["mc_low"] <= exact <= made["mc_high"]
    assert made["n"] == n


def test_power_takes_any_study_and_any_test_and_repeats_itself() -> None:
    def draw(n: int, rng: np.random.Generator) -> pd.DataFrame:
        return pd.DataFrame({"y": rng.normal(0.6, 1.0, n)})

    def p_of(table: pd.DataFrame) -> float:
        return float(stats.ttest_1samp(table["y"], 0).pvalue)

    one = analysis.power(draw, p_of, [10, 40], {}, seed=1)
    pd.testing.assert_frame_equal(one, analysis.power(draw, p_of, [10, 40], {}, seed=1))
    assert one["power"][1] > one["power"][0]
    with pytest.raises(InputError, match="design"):
        analysis.power({"trails": 3}, "posthoc_t", 10, 0.5)
    with pytest.raises(InputError, match="test"):
        analysis.power({}, "t-test", 10, 0.5)


# Tests and intervals whose level is exact or near it; discrete ones may only be below.
CONSERVATIVE = ("exact interval", "wilcoxon exact", "family")


@pytest.mark.parametrize("name", [probe[0] for probe in calibration.PROBES])
def test_null_studies_are_rejected_at_the_level(name: str) -> None:
    studies = {
        "cumulative_link": 10,
        "binomial_mixed": 6,
        "scales": 10,
        "linear_mixed": 4,
        "ranks": 10,
        "effect_sizes": 40,
        "psychometric": 6,
    }.get(name, 20)
    table = calibration.calibrate(studies, seed=11, only=name)
    for what, part in table.groupby("what"):
        total = int(part["studies"].sum())
        rate = float((part["rate"] * part["studies"]).sum() / total)
        if "not ours" in str(what):
            # A pooled binomial rejects far too often where observers differ: what ours must not do.
            assert part.loc[part["preference_sd"] == 1.0, "rate"].mean() > 0.15
            continue
        # Four standard errors of a simulation of this length around the 5 % level.
        margin = 4 * math.sqrt(0.05 * 0.95 / total)
        assert rate < 0.05 + margin, (what, rate, total)
        if not any(word in str(what) for word in CONSERVATIVE):
            assert rate > 0.05 - margin, (what, rate, total)


def test_importing_analysis_loads_nothing_until_asked() -> None:
    code = (
        "import sys, analysis; assert 'pandas' not in sys.modules; analysis.adjust_p; "
        "heavy = {'drjit', 'mitsuba', 'moderngl', 'glfw', 'statsmodels'} & set(sys.modules); assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_public_name_is_there() -> None:
    for name in analysis.__all__:
        assert callable(getattr(analysis, name)), name
    with pytest.raises(AttributeError, match="no attribute 'anova'"):
        _ = analysis.does_not_exist if hasattr(analysis, "does_not_exist") else analysis.__getattr__("anova")
