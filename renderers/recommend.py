"""The most accurate setting that this machine holds at a rate, by measurement.

Candidates come from a tradeoff's rows, the most accurate first; each is then timed anew, until one holds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from renderers.engine import Engine
from renderers.tradeoff import Conditions, Setting, shown_by
from stimuli.scene import CameraPath

HOLDING_QUANTILE = 0.95
"""A setting holds a budget when this share of its frames keeps it."""


@dataclass(frozen=True)
class Held:
    """A setting's row and its timing by itself: ``ms_median`` and ``ms_p95`` over ``frames`` frames that were made."""

    row: Mapping[str, Any]
    ms_median: float
    ms_p95: float
    frames: int

    def holds(self, budget_ms: float) -> bool:
        """Whether 95 % of the frames keep the budget."""
        return self.ms_p95 <= budget_ms


def candidates(rows: Sequence[Mapping[str, Any]], budget_ms: float, rate_hz: float) -> list[Mapping[str, Any]]:
    """Rows that may hold the budget, the most accurate (both eyes) first: made at the display's rate, and with a median
    frame within it (the 95 % are what the new timing decides). The gold standard itself is one where it is fast enough.
    """
    able = [row for row in rows if row["content_hz"] == rate_hz and row["ms_per_content_frame"] <= budget_ms]
    # Settings that come down to the same picture differ in the last digits: of those the faster is meant.
    return sorted(able, key=lambda row: (float(f"{row['rmse_eyes']:.5g}"), row["ms_per_content_frame"]))


def timed(
    engine: Engine, camera: CameraPath, row: Mapping[str, Any], conditions: Conditions, exposure: float, frames: int
) -> Held:
    """Time the setting of ``row`` once more, alone."""
    setting = Setting(row["technique"], row["params"], conditions.rate_hz)
    longer = replace(conditions, frames=frames)
    seconds = [s for s in shown_by(engine, camera, setting, exposure, longer).seconds if s > 0]
    low, high = np.quantile(seconds, [0.5, HOLDING_QUANTILE]) * 1e3
    return Held(row, float(low), float(high), len(seconds))


def tried(
    engine: Engine,
    camera: CameraPath,
    rows: Sequence[Mapping[str, Any]],
    budget_ms: float,
    conditions: Conditions,
    exposure: float,
    frames: int = 120,
) -> Iterator[Held]:
    """Time candidates, the most accurate first, up to and with the first that holds."""
    for row in candidates(rows, budget_ms, float(conditions.rate_hz)):
        held = timed(engine, camera, row, conditions, exposure, frames)
        yield held
        if held.holds(budget_ms):
            return
