"""Whether another setting does better for less than a technique where its paper used it."""

from __future__ import annotations

from typing import Any

from renderers import operating_points
from renderers.operating_points import dominating, error_column, judged


def row(name: str, ms: float, rays: float, error: float, origin: str = "knob", gaze: float = 1.0) -> dict[str, Any]:
    return {
        "technique": name, "label": f"{name} {origin}", "ms_per_refresh": ms, "cpu_ms_per_refresh": 2 * ms,
        "primary_per_s": rays, "rmse_eyes": error, "rmse_gaze": gaze, "origin": origin,
    }  # fmt: skip


def test_dominated_is_what_another_beats_in_one_and_matches_in_the_other() -> None:
    own = row("taa", 2, 100, 0.05, "default")
    cheaper, better = row("a", 1.9, 100, 0.05), row("b", 2, 100, 0.04)
    assert dominating(own, [own], "ms_per_refresh", "rmse_eyes") is None
    assert dominating(own, [own, cheaper], "ms_per_refresh", "rmse_eyes") is cheaper
    assert dominating(own, [own, cheaper, better], "ms_per_refresh", "rmse_eyes") is better
    assert dominating(own, [row("c", 1, 50, 0.06), row("d", 3, 300, 0.01)], "ms_per_refresh", "rmse_eyes") is None


def test_noise_dominates_nobody() -> None:
    own = row("taa", 2, 100, 0.05, "default")
    assert dominating(own, [row("a", 1.99, 100, 0.0497)], "ms_per_refresh", "rmse_eyes") is None


def test_time_and_rays_are_fronts_of_their_own() -> None:
    rows = [row("adaptive_frameless", 30, 10, 0.05, "default"), row("vanilla", 3, 400, 0.04, "default")]
    found = judged(rows)
    by_time = {"ms_per_refresh": "vanilla default", "cpu_ms_per_refresh": "vanilla default"}
    assert found[0]["dominated_by"] == {**by_time, "primary_per_s": None}
    assert set(found[1]["dominated_by"].values()) == {None}
    assert "dominated_by" not in judged([row("taa", 1, 1, 1.0)])[0]


def test_a_better_setting_of_its_own_does_not_dominate_a_technique() -> None:
    rows = [row("taa", 2, 100, 0.05, "default"), row("taa", 2, 100, 0.02), row("vanilla", 3, 100, 0.01)]
    assert judged(rows)[0]["dominated_by"] == {**dict.fromkeys(operating_points.COSTS), "primary_per_s": "vanilla knob"}
    lines = operating_points.lines(rows).splitlines()
    assert "on the front (tuned: taa knob: 5.10 at 2)" in lines[0]
    assert "dominated by vanilla knob: 2.55 at 100" in lines[2]


def test_techniques_that_follow_the_gaze_are_judged_by_what_it_resolves() -> None:
    assert error_column("foveated") == error_column("polar") == "rmse_gaze"
    assert error_column("vanilla") == "rmse_eyes"
    rows = [row("foveated", 2, 50, 0.09, "default", gaze=0.02), row("vanilla", 2, 50, 0.04, "default", gaze=0.03)]
    assert judged(rows)[0]["dominated_by"]["ms_per_refresh"] is None


def test_the_verdict_is_a_line_for_each_cost() -> None:
    rows = [row("taa", 2, 100, 0.05, "default"), row("vanilla", 1, 200, 0.02, "default"), row("taa", 9, 900, 0.01)]
    lines = operating_points.lines(rows).splitlines()
    assert len(lines) == 6
    assert "taa" in lines[0]
    assert "dominated by vanilla default: 5.10 at 1" in lines[0]
    assert "dominated" in lines[1]
    assert "CPU" in lines[1]
    assert "on the front" in lines[2]
    assert "primary rays" in lines[2]
