"""Clips without pixels: what a display that draws nothing needs of a clip is its size, rate and length."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction

import numpy as np

from protocols.requests import ClipSpec, clip_spec
from protocols.study import Study
from protocols.trial import Trial
from studyapp.seams import FrameSource


@dataclass
class ManifestSource:
    """A `FrameSource` for the virtual display. ``frame`` has nothing to give: LookupError."""

    size_px: tuple[int, int]
    rate_hz: Fraction
    frame_count: int

    def frame(self, index: int) -> np.ndarray:
        raise LookupError("a clip that was not rendered has no frames; only the virtual display plays it")


class Manifests:
    """The sources of a study's trials as their specifications say; each specification is looked at once."""

    def __init__(self, study: Study) -> None:
        self._study = study
        self._known: dict[ClipSpec, ManifestSource] = {}
        self._told = 0

    def __call__(self, trial: Trial) -> Mapping[str, FrameSource]:
        """Slot -> source."""
        return {panel.slot: self._source(clip_spec(self._study, trial, panel)) for panel in trial.panels}

    def _source(self, spec: ClipSpec) -> ManifestSource:
        source = self._known.get(spec)
        if source is None:
            source = self._known[spec] = ManifestSource(spec.size_px, Fraction(spec.rate_hz), spec.frame_count)
        return source

    def new_rows(self) -> list[tuple[str, str, str]]:
        """`rows` of the clips that were first met since the last call."""
        before, self._told = self._told, len(self._known)
        return self.rows(before)

    def rows(self, after: int = 0) -> list[tuple[str, str, str]]:
        """(identity, manifest, cost) of each clip met so far (but for the first ``after``), for the session's
        ``clips``; marked as not rendered."""
        out = []
        for spec in list(self._known)[after:]:
            text = json.dumps({"specification": asdict(spec), "rendered": False}, sort_keys=True)
            out.append((hashlib.sha256(text.encode()).hexdigest(), text, "{}"))
        return out
