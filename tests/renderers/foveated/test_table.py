"""The table's own arithmetic, and one tiny cell for each light setting."""

from __future__ import annotations

import numpy as np
import pytest

from renderers.foveated.table import PAPER, RINGS_DEG, SETTINGS, Conditions, lit, measure_cell, summary
from stimuli import load_scene


def test_the_papers_table_gives_its_own_means() -> None:
    """Section 4.1: 79 % fewer pixels on average, speed-ups of 1.46 to 4.18 (mean 2.62; the text has 2.55)."""
    cells = [cell for scene in PAPER.values() for cell in scene.values()]
    assert len(cells) == 12
    assert np.mean([share for share, _ in cells]) == pytest.approx(0.21, abs=0.005)
    speedups = [speedup for _, speedup in cells]
    assert np.mean(speedups) == pytest.approx(2.615, abs=1e-3)
    assert (min(speedups), max(speedups)) == (1.46, 4.18)


def test_one_light_of_the_kind_that_is_asked_for() -> None:
    scene = load_scene("tunnel_geom")
    assert [light.kind for light in lit(scene, "point", 1.0).lights] == ["point"]
    assert [light.kind for light in lit(scene, "area", 1.0).lights] == ["area"]
    assert lit(scene, "ambient_occlusion", 1.0) is scene


def test_a_cell_of_each_setting() -> None:
    scene = load_scene("tunnel_geom")
    small = Conditions(frames=2, warm_up=2, size_px=(236, 292))
    cells = [measure_cell(scene, setting, small) for setting in SETTINGS]
    for cell, setting in zip(cells, SETTINGS, strict=True):
        assert cell.setting == setting
        assert 0.05 < cell.share < 1
        assert 0 <= cell.marked <= cell.share
        assert ("post filter" in cell.stages_ms) == (setting != "point")
        assert cell.speedup == pytest.approx(cell.full_ms / cell.total_ms)
        assert cell.trace_speedup == pytest.approx(cell.full_trace_ms / cell.stages_ms["trace"])
        assert len(cell.rmse_by_ring) == len(RINGS_DEG) - 1
        assert cell.rmse_by_ring[0] < 1e-6  # the fovea is what full ray tracing shows
        assert 0.2 < max(cell.rmse_by_ring) < 60  # of codes from 0 to 255
        assert cell.rmse_by_ring[2] > 0
        assert cell.flip_by_ring[0] < 0.02  # it looks around each pixel
        assert 0.005 < max(cell.flip_by_ring) < 0.5
    found = summary(cells)
    assert found["fewer_samples_percent"] == pytest.approx(100 * (1 - np.mean([c.share for c in cells])))
    assert found["speedup_best"] == max(c.speedup for c in cells)
    assert set(found["trace_speedup"]) == set(SETTINGS)
    with pytest.raises(ValueError, match="at least one"):
        summary([])
