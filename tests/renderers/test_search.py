"""What a tradeoff tries: the same number of trials for all, the papers' operating points, and equal rays."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction
from typing import Any

import numpy as np

from renderers.catalogue import CATALOGUE
from renderers.clip_frames import technique_params
from renderers.search import GOLD_SHARE, Setting, equal_rays_per_s, settings_of, tuned_to_equal_rays

SIZE, RATE = (64, 48), Fraction(240)
QUARTER = 64 * 48 / 4 * 240


def test_no_setting_is_measured_twice() -> None:
    settings = settings_of(list(CATALOGUE), SIZE, RATE, [], 100, 0)
    complete = [(s.technique, s.rate_hz, repr(technique_params(s.technique, s.params))) for s in settings]
    assert len(set(complete)) == len(complete)


def test_every_technique_is_searched_with_the_same_number_of_trials() -> None:
    settings = settings_of(list(CATALOGUE), SIZE, RATE, [], 3, 7)
    trials = Counter(s.technique for s in settings if s.origin == "knob")
    for name, known in CATALOGUE.items():
        free = {knob: values for knob, values in known.knobs.items() if knob != "samples_per_s"}
        points = int(np.prod([len(values) for values in free.values()])) if free else 0
        # the default may be one of the points that were drawn, and is then not measured again
        assert min(3, points) - 1 <= trials[name] <= min(3, points), name


def test_the_search_is_seeded() -> None:
    def tried(seed: int) -> list[str]:
        return [s.label for s in settings_of(["taa", "temporally_dense"], SIZE, RATE, [], 4, seed)]

    assert tried(1) == tried(1)
    assert tried(1) != tried(2)


def test_every_technique_is_tried_where_its_paper_used_it() -> None:
    settings = settings_of(list(CATALOGUE), SIZE, RATE, [], 2, 0)
    own = {s.technique: s.params for s in settings if s.origin == "default"}
    assert set(own) == set(CATALOGUE) - {"reference"}
    assert own["adaptive_frameless"] == {"samples_per_s": 4e5}  # Table 1 of Dayal et al. 2005
    assert own["temporally_dense"] == own["foveated"] == {}
    knobs = [s.params for s in settings if s.technique == "adaptive_frameless" and s.origin == "knob"]
    assert all(params["samples_per_s"] == 4e5 for params in knobs)


def test_baselines_have_the_rays_of_temporally_dense() -> None:
    settings = settings_of(list(CATALOGUE), SIZE, RATE, [], 0, 0)
    baselines = {s.label: s for s in settings if s.origin == "baseline"}
    assert equal_rays_per_s(SIZE, RATE) == QUARTER
    assert baselines["vanilla at 60 Hz"].rate_hz == 60
    assert baselines["taa at 60 Hz"].rate_hz == 60
    assert any(s.technique == "temporally_dense" and s.params == {"reproject": False} for s in baselines.values())
    budgeted = {s.technique for s in baselines.values() if s.params.get("samples_per_s") == QUARTER}
    assert budgeted == {"framed_low_resolution", "framed_low_rate", "adaptive_frameless", "traditional_frameless"}


def test_budgets_reach_the_techniques_that_have_one() -> None:
    settings = settings_of(["traditional_frameless", "vanilla"], SIZE, RATE, [1e5, 4e5], 2, 0)
    assert [s.params.get("samples_per_s") for s in settings if s.technique == "traditional_frameless"] == [1e5, 4e5]


def test_the_gold_standards_own_kind_is_tried_with_far_fewer_samples() -> None:
    tried = [s.params["spp"] for s in settings_of(["reference"], SIZE, RATE, [], 100, 0, reference_spp=64)]
    assert tried
    assert max(tried) * GOLD_SHARE <= 64


def row(technique: str, error: float, primary_per_s: float, origin: str = "default", **params: Any) -> dict[str, Any]:
    return {
        "technique": technique, "params": params, "content_hz": 240.0, "rmse_eyes": error, "origin": origin,
        "primary_per_s": primary_per_s,
    }  # fmt: skip


def test_the_best_found_of_each_technique_is_tried_again_at_equal_rays() -> None:
    rows = [
        row("temporally_dense", 5, QUARTER),
        row("taa", 5, 4 * QUARTER),
        row("taa", 4, 4 * QUARTER, "knob", alpha=0.2),
        row("taa", 1, 16 * QUARTER, "budget", alpha=0.05),
        row("checkerboard", 4, 2 * QUARTER),
        row("foveated", 4, 2.2 * QUARTER),
        row("adaptive_frameless", 9, 4e5, samples_per_s=4e5),
        row("adaptive_frameless", 7, 4e5, "knob", samples_per_s=4e5, filter_volume=2.0),
        row("reference", 1, 64 * QUARTER, "knob", spp=16),
    ]
    assert tuned_to_equal_rays(rows, SIZE, RATE) == [
        Setting("taa", {"alpha": 0.2}, Fraction(60), "baseline"),
        Setting("checkerboard", {}, Fraction(120), "baseline"),
        Setting("foveated", {}, Fraction(80), "baseline"),
        Setting("adaptive_frameless", {"samples_per_s": QUARTER, "filter_volume": 2.0}, RATE, "baseline"),
    ]


def test_what_was_measured_at_equal_rays_is_not_tried_again() -> None:
    rows = [row("temporally_dense", 5, QUARTER), row("vanilla", 5, 4 * QUARTER)]
    rows.append({**row("vanilla", 8, QUARTER, "baseline"), "content_hz": 60.0})
    assert tuned_to_equal_rays(rows, SIZE, RATE) == []
    assert tuned_to_equal_rays(rows[1:], SIZE, RATE) == []  # nothing to be equal to
