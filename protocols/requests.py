"""Which clips a study needs: Study -> plain specifications -> the store's ClipRequests.

Scene hashes and exposures are found by the caller (`studyapp`), since protocols load no scenes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from typing import Any

from protocols.blocks import PAIR_KINDS, WORD_KINDS
from protocols.cells import Cell, block_cells, explicit_cell, panel
from protocols.study import Study
from protocols.trial import Panel, Trial
from renderers.catalogue import CATALOGUE
from stimuli.clip_request import CHANNEL_GROUPS, ClipRequest


@dataclass(frozen=True)
class ClipSpec:
    """One clip as the protocol asks for it. ``scene`` is the study's own name, ``source`` what `load_scene` takes;
    ``params`` is JSON with sorted keys; rates and times are exact rationals as text; ``path_keys`` is JSON of the
    keyframes where the protocol holds them; ``live``: rendered per refresh, never stored."""

    scene: str
    source: str
    instead: str | None
    technique: str
    params: str
    size_px: tuple[int, int]
    rate_hz: str
    duration_s: str
    start_s: str = "0"
    warm_up_s: str = "1"
    path: str = "file"
    path_keys: str = ""
    animation: str | None = None
    lighting: str = "direct"
    loop: str = "once"
    seed: int = 0
    geometry: tuple[float, ...] | None = None
    gaze: tuple[float, float] | str | None = None
    exposure: float | None = None
    live: bool = False
    channels: tuple[str, ...] = ()
    reference_error: float | None = None

    @property
    def frame_count(self) -> int:
        """round(duration * rate)."""
        return round(Fraction(self.duration_s) * Fraction(self.rate_hz))

    def request(self, scene_sha256: str, exposure: float, external_sha256: str = "") -> ClipRequest:
        """The store's request. ``exposure`` is used where the protocol fixes none; ``external_sha256`` is the hash of
        a technique from outside the tree. Where a ``reference_error`` decides, ``spp`` is the most there may be."""
        keys = hashlib.sha256(self.path_keys.encode()).hexdigest() if self.path_keys else ""
        return ClipRequest(
            scene=self.scene, scene_sha256=scene_sha256, technique=self.technique, params=json.loads(self.params),
            size_px=self.size_px, rate_hz=self.rate_hz, duration_s=self.duration_s, path=self.path, path_sha256=keys,
            animation=self.animation, start_s=self.start_s, warm_up_s=self.warm_up_s, seed=self.seed,
            exposure=exposure if self.exposure is None else self.exposure, lighting=self.lighting,
            geometry=self.geometry, gaze=self.gaze, loop=self.loop, external_sha256=external_sha256,
            extra={"channels": list(self.channels)} if self.channels else {},
        )  # fmt: skip


def clip_spec(study: Study, trial: Trial, shown: Panel) -> ClipSpec:
    """The clip behind one panel of a trial."""
    scene = study.scenes[trial.scene]
    settings = trial.settings
    width, height = (int(side) for side in settings["size_px"])
    entry = CATALOGUE.get(shown.technique)
    follows = entry is not None and entry.gaze_contingent
    # The target is an object of the scene, whoever renders it; side by side there is no single one to follow.
    alone = len(trial.panels) == 1 or trial.kind == "two_interval"
    moving = trial.fixation == "moving" and entry is not None and (follows or alone)
    gaze = "moving" if moving else (0.0, 0.0) if follows else None
    geometry = None
    if follows and study.display.geometry == "screen":
        geometry = (*study.display.panel_m((width, height)), study.display.distance_m, 0.0, 0.0)
    keys = study.paths[trial.path].as_json() if trial.path in study.paths else ""
    own = study.conditions.get(shown.condition.partition("@")[0])
    asked = settings.get("channels") or () if own is None or own.channels is None else own.channels
    channels = () if shown.live else tuple(name for group in asked for name in CHANNEL_GROUPS[group])
    return ClipSpec(
        scene=trial.scene, source=scene.scene, instead=scene.instead, technique=shown.technique,
        params=json.dumps(dict(shown.params), sort_keys=True), size_px=(width, height), rate_hz=shown.rate_hz,
        duration_s=str(settings["duration_s"]), start_s=str(settings["start_s"]), warm_up_s=str(settings["warm_up_s"]),
        path=trial.path, path_keys=keys, animation=settings.get("animation"), lighting=str(settings["lighting"]),
        loop=str(settings["loop"]), seed=study.seed, geometry=geometry,
        gaze=gaze, exposure=scene.exposure, live=shown.live, channels=tuple(dict.fromkeys(channels)),
        reference_error=None if own is None else own.reference_error,
    )  # fmt: skip


def clip_specs(study: Study) -> tuple[ClipSpec, ...]:
    """All distinct clips that any participant may see, live ones included (``live``), in the order of the protocol."""
    found: dict[ClipSpec, None] = {}
    for trial in possible_trials(study):
        for shown in trial.panels:
            found.setdefault(clip_spec(study, trial, shown))
    return tuple(found)


def clip_requests(
    study: Study,
    scene_sha256: Mapping[str, str],
    exposure: Mapping[str, float],
    external: Mapping[str, str] | None = None,
) -> dict[ClipSpec, ClipRequest]:
    """Every stored clip of the study -> its request. ``scene_sha256`` and ``exposure`` go by the study's scene names;
    ``external``: technique -> hash, for techniques from outside."""
    known = external or {}
    return {
        spec: spec.request(scene_sha256[spec.scene], exposure[spec.scene], known.get(spec.technique, ""))
        for spec in clip_specs(study)
        if not spec.live
    }


def with_clips(study: Study, trial: Trial, requests: Mapping[ClipSpec, ClipRequest]) -> Trial:
    """The trial with each stored panel's clip named by its identity."""
    shown = [
        panel if panel.live else replace(panel, clip=requests[clip_spec(study, trial, panel)].identity)
        for panel in trial.panels
    ]
    return replace(trial, panels=tuple(shown))


def possible_trials(study: Study) -> Iterator[Trial]:
    """One bare trial for each cell that any participant may meet: practice, catch trials and references included."""
    between = study.participants.between
    groups = [dict(zip(between, pick, strict=True)) for pick in product(*between.values())]
    for block, group in product(study.blocks, groups):
        if block.kind in WORD_KINDS:
            continue
        cells = list(block_cells(study, block, group))
        if isinstance(block.practice, list):
            cells += [explicit_cell(study, block, trial, group) for trial in block.practice]
        over = block.practice_set.model_dump(mode="json", exclude_none=True)
        if over and block.practice:
            cells += [replace(cell, settings={**cell.settings, **over}) for cell in cells]
        if block.catch is not None:
            added = tuple(name for name in (block.catch.good, block.catch.bad) if name)
            cells += [
                replace(cell, members=added) for cell in {cell.key.split("@")[1]: cell for cell in cells}.values()
            ]
        for cell in cells:
            yield _bare(study, block.name, block.reference, block.kind in PAIR_KINDS, cell)


def _bare(study: Study, name: str, reference: str | None, pairs: bool, cell: Cell) -> Trial:
    panels = [panel(study, cell, member, "") for member in cell.members]
    if reference is not None:
        panels.append(panel(study, cell, reference, "", "reference"))
    settings: dict[str, Any] = dict(cell.settings)
    return Trial(
        0, name, "forced_choice" if pairs else "likert", cell.scene, str(settings["path"]), tuple(panels),
        fixation=str(settings["fixation"]), settings=settings,
    )  # fmt: skip
