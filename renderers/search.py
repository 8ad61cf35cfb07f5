"""What a tradeoff tries: every technique's operating point, the same number of trials of its knobs, and equal rays."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np

from renderers.catalogue import entry
from renderers.clip_frames import technique_params

GOLD_SHARE = 8
"""A setting of the gold standard's own kind has at most this fraction (1 / 8) of its samples: the gold's own error then
adds at most 6 % to what is measured of it."""


@dataclass(frozen=True)
class Setting:
    """One technique with its parameters at a content rate; ``origin``: default (its operating point) | knob | budget |
    baseline (equal rays)."""

    technique: str
    params: Mapping[str, Any] = field(default_factory=dict)
    rate_hz: Fraction = Fraction(240)
    origin: str = "default"

    @property
    def label(self) -> str:
        """Short words for tables and plots."""
        shown = ", ".join(f"{name} {_short(value)}" for name, value in self.params.items())
        rate = "" if self.rate_hz == 240 else f" at {_short(float(self.rate_hz))} Hz"
        return f"{self.technique}{rate}{f' ({shown})' if shown else ''}"


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def equal_rays_per_s(size_px: tuple[int, int], rate_hz: Fraction) -> float:
    """The primary rays a second of `temporally_dense`, at which all are compared: a quarter of the pixels a refresh."""
    return size_px[0] * size_px[1] / 4 * float(rate_hz)


def settings_of(
    names: Sequence[str],
    size_px: tuple[int, int],
    rate_hz: Fraction,
    budgets: Sequence[float],
    trials: int,
    seed: int,
    reference_spp: int | None = None,
) -> list[Setting]:
    """What is tried: each technique's operating point, ``trials`` points of its knobs, budgets, equal-ray baselines.

    Knobs are searched by the same rule for all: their grid in a seeded random order, the first ``trials`` points, with
    the operating point's other parameters. ``budgets`` are samples a second for the techniques that have such a
    parameter, in place of their operating point's. ``reference_spp``: of the gold standard, see `GOLD_SHARE`.
    """
    found: list[Setting] = []
    for name in names:
        known = entry(name)
        has_budget = "samples_per_s" in known.params.model_fields
        own = {**known.operating_point, **({"samples_per_s": float(budgets[0])} if budgets and has_budget else {})}
        if name != "reference":
            found.append(Setting(name, own, rate_hz))
        for budget in budgets[1:] if has_budget else ():
            found.append(Setting(name, {"samples_per_s": float(budget)}, rate_hz, "budget"))
        knobs = {knob: values for knob, values in known.knobs.items() if knob != "samples_per_s"}
        grid = [dict(zip(knobs, point, strict=True)) for point in itertools.product(*knobs.values())] if knobs else []
        if name == "reference" and reference_spp is not None:
            grid = [point for point in grid if int(str(point["spp"])) * GOLD_SHARE <= reference_spp]
        digest = hashlib.sha256(name.encode()).digest()
        order = np.random.default_rng([seed, int.from_bytes(digest[:4], "little")]).permutation(len(grid))
        found += [Setting(name, {**own, **grid[i]}, rate_hz, "knob") for i in order[:trials]]
    if "temporally_dense" in names:
        found += equal_ray_baselines(names, equal_rays_per_s(size_px, rate_hz), rate_hz)
    return unique(found)


def unique(settings: Sequence[Setting]) -> list[Setting]:
    """``settings`` without those whose complete parameters and rate stand there before."""
    kept: dict[str, Setting] = {}
    for setting in settings:
        complete = technique_params(setting.technique, setting.params)
        kept.setdefault(f"{setting.technique} {setting.rate_hz} {complete!r}", setting)
    return list(kept.values())


def equal_ray_baselines(names: Sequence[str], samples_per_s: float, rate_hz: Fraction) -> list[Setting]:
    """What `temporally_dense` is judged against at its own primary rays a second, with default parameters."""
    budgeted = [name for name in names if "samples_per_s" in entry(name).params.model_fields]
    held = rate_hz / 4
    wanted = [
        *(Setting(name, {"samples_per_s": samples_per_s}, rate_hz, "baseline") for name in budgeted),
        Setting("temporally_dense", {"reproject": False}, rate_hz, "baseline"),
        Setting("vanilla", {}, held, "baseline"),
        Setting("taa", {}, held, "baseline"),
    ]
    return [setting for setting in wanted if setting.technique in names]


def tuned_to_equal_rays(
    rows: Sequence[Mapping[str, Any]], size_px: tuple[int, int], rate_hz: Fraction
) -> list[Setting]:
    """The best setting that the search found of each technique, once more at the rays a second of `temporally_dense`:
    with that budget where the technique has one, else at the highest content rate (rate_hz / n) that keeps it.

    ``rows``: what was measured; without `temporally_dense` among them there is nothing to be equal to.
    """
    budget = equal_rays_per_s(size_px, rate_hz)
    names = list(dict.fromkeys(row["technique"] for row in rows))
    found = []
    for name in names if "temporally_dense" in names else ():
        own = [
            row
            for row in rows
            if row["technique"] == name and row["content_hz"] == rate_hz and row["origin"] in ("default", "knob")
        ]
        if name == "reference" or not own:
            continue
        best = min(own, key=lambda row: row["rmse_eyes"])
        setting = Setting(name, dict(best["params"]), rate_hz, "baseline")
        if "samples_per_s" in entry(name).params.model_fields:
            setting = replace(setting, params={**best["params"], "samples_per_s": budget})
        elif best["primary_per_s"] > budget:
            setting = replace(setting, rate_hz=rate_hz / math.ceil(round(best["primary_per_s"] / budget, 6)))
        found.append(setting)
    tried = [Setting(r["technique"], r["params"], Fraction(r["content_hz"]), r["origin"]) for r in rows]
    return unique([*tried, *found])[len(unique(tried)) :]
