"""The saving is measured on the same refreshes for both; its figures are complete (no bounds: machines are noisy)."""

from __future__ import annotations

import math

from renderers.bench_dense import live_sizes, measure_saving
from stimuli import load_scene


def test_the_saving_names_every_stage_of_both_techniques() -> None:
    saving = measure_saving(load_scene("toy_car"), (32, 16), frames=3, warm_up=1)
    assert set(saving.stages_ms) == {"taa", "temporally_dense"}
    assert {"trace", "resolve", "total"} <= set(saving.stages_ms["taa"])
    assert {"trace", "compose", "total"} <= set(saving.stages_ms["temporally_dense"])
    for ratio in (saving.trace_ratio, saving.whole_ratio, saving.compositing_ratio):
        assert math.isfinite(ratio)
        assert ratio > 0


def test_live_times_are_given_for_each_size() -> None:
    found = live_sizes(load_scene("tunnel_geom"), ((8, 8), (16, 8)), frames=4)
    assert list(found) == ["8x8", "16x8"]
    assert all(0 < taken["median_ms"] <= taken["p95_ms"] for taken in found.values())
