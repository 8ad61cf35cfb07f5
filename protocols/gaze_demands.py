"""What gaze-contingent techniques demand of a protocol: a known gaze, and a display wide enough to tell them apart."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from pydantic import BaseModel

from protocols.names import Problem
from protocols.requests import ClipSpec, clip_spec, possible_trials
from protocols.study import Study
from renderers.catalogue import CATALOGUE, ViewGeometry, sampling_probability
from stimuli.errors import problem

SAME_SAMPLES = 0.01
"""Two conditions whose frames differ in a smaller share of their samples show the same thing."""
GRID_PX = 256
"""Shares are taken over a grid of at most so many points a side: larger panels are no smoother."""
SAME_SAMPLES_OVERRIDE = "same_samples"


def gaze_problems(study: Study) -> Iterator[Problem]:
    """A picture made for one gaze cannot be stored for an eye that is free to look anywhere. Only for a study whose
    names all lead somewhere."""
    places = {block.name: index for index, block in enumerate(study.blocks)}
    told: set[tuple[str, str]] = set()
    for trial in possible_trials(study):
        for panel in trial.panels:
            entry = CATALOGUE.get(panel.technique)
            if entry is None or not entry.gaze_contingent or panel.live or trial.fixation != "free":
                continue
            if (trial.block, panel.condition) not in told:
                told.add((trial.block, panel.condition))
                got = f"{panel.condition} ({panel.technique}) with a free gaze from the store"
                wanted = "live: true, or fixation: fixed | moving (what the eye will do is not known beforehand)"
                yield ("blocks", places[trial.block]), f"blocks[{places[trial.block]}]", got, wanted


@dataclass(frozen=True)
class BelowFullRate:
    """The share of a panel's pixels, in [0, 1], that ``condition`` traces less often than in every frame, at the
    protocol's display geometry with the gaze at the panel's centre."""

    condition: str
    size_px: tuple[int, int]
    share: float


@dataclass(frozen=True)
class _Density:
    """How likely a condition's pixels are traced, and what else makes its pictures: ``others``, or ``at_full_rate``
    where all are traced."""

    condition: str
    block: str
    spec: ClipSpec
    others: str
    at_full_rate: str
    chance: np.ndarray

    def share_unlike(self, other: _Density) -> float:
        """The share of a frame's samples, in [0, 1], in which the pictures of two are expected to differ."""
        if self.spec.size_px != other.spec.size_px or self.at_full_rate != other.at_full_rate:
            return 1.0
        if self.others == other.others:
            return float(np.mean(np.abs(self.chance - other.chance)))
        return float(np.mean(1 - np.minimum(self.chance, other.chance)))


def below_full_rate(study: Study) -> tuple[BelowFullRate, ...]:
    """One row for each condition whose samples hang on eccentricity, and each panel size. Empty where eccentricities
    come from the camera's field (``display.geometry: camera``), which the scene knows and the protocol does not."""
    rows = {
        (found.condition, found.spec.size_px): BelowFullRate(
            found.condition, found.spec.size_px, float(np.mean(found.chance < 1))
        )
        for found in _densities(study)
        if CATALOGUE[found.spec.technique].density
    }
    return tuple(rows.values())


def same_samples_problems(study: Study) -> list[str]:
    """Pairs of conditions of one block whose pictures could hardly be told apart: they are expected to differ in less
    than 1 % of a frame's samples on this display: all else being equal the mean of |p_1 - p_2| over pixels, and where
    they differ in what a pixel that is always traced does not hang on (full ray tracing, cache), of 1 - min(p_1, p_2).
    """
    found: dict[tuple[str, str, str], str] = {}
    for one, other in combinations(_densities(study), 2):
        key = (one.block, one.condition, other.condition)
        if one.condition == other.condition or one.block != other.block or key in found:
            continue
        share = one.share_unlike(other)
        if share < SAME_SAMPLES:
            where = f"block {one.block}: {one.condition} and {other.condition}"
            wanted = f"at least {SAME_SAMPLES:.0%} on this display (or --override {SAME_SAMPLES_OVERRIDE}=REASON)"
            found[key] = problem(where, "samples that differ", f"{share:.2%}", wanted)
    return list(found.values())


def _densities(study: Study) -> list[_Density]:
    """Each condition of each block whose density of samples is known once, where the display's geometry says where its
    pixels are."""
    if study.display.geometry != "screen":
        return []
    made: dict[tuple[str, str, str], _Density] = {}
    chances: dict[tuple[str, str, tuple[int, int]], np.ndarray] = {}
    for trial in possible_trials(study):
        for panel in trial.panels:
            entry = CATALOGUE.get(panel.technique)
            if entry is None or entry.full_rate_params is None:
                continue
            spec = clip_spec(study, trial, panel)
            params: BaseModel = entry.params.model_validate_json(spec.params)
            values = params.model_dump(mode="json")
            rest = {k: v for k, v in values.items() if k not in entry.density_params}
            others = json.dumps([panel.technique, rest, spec.rate_hz])
            told = {k: values[k] for k in entry.full_rate_params if values[k]}
            asked = (panel.technique, spec.params, spec.size_px)
            if asked not in chances:
                geometry = ViewGeometry(*study.display.panel_m(spec.size_px), study.display.distance_m)
                factor = min(1.0, GRID_PX / max(spec.size_px))
                grid = (max(1, round(spec.size_px[0] * factor)), max(1, round(spec.size_px[1] * factor)))
                chance = sampling_probability(panel.technique, params, grid, geometry)
                assert chance is not None
                chances[asked] = chance
            key = (trial.block, panel.condition, f"{others} {spec.size_px}")
            at_full_rate = json.dumps([told, spec.rate_hz])
            made.setdefault(key, _Density(panel.condition, trial.block, spec, others, at_full_rate, chances[asked]))
    return list(made.values())
