"""Frames of a session's trials from the clip store, and every check of them before anything is shown."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from protocols.study import Study
from protocols.trial import Trial
from stimuli.clip import ClipStore
from stimuli.errors import InputError, problem
from studyapp.clips import (
    StudyClips,
    clip_record,
    luminance_problems,
    resolve_clips,
    sources_for,
    store_directory,
    store_problems,
    with_clips,
)  # fmt: skip
from studyapp.seams import FrameSource

LUMINANCE_OVERRIDE = "luminance"


class StoredSources:
    """Slot -> frames for each trial, played from the store (``given``: --store). Raises InputError where scenes are
    nowhere."""

    def __init__(self, study: Study, protocol: str | Path, given: Path | None) -> None:
        self._study = study
        self._protocol = protocol
        self._store = ClipStore(store_directory(protocol, None if given is None else str(given)))
        self._clips: StudyClips = resolve_clips(study, protocol, self._store)
        self._used: dict[str, None] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """What stands in for what."""
        return self._clips.notes

    def planned(self, trials: Sequence[Trial]) -> tuple[Trial, ...]:
        """The trials with their clips named."""
        return tuple(with_clips(self._study, trial, self._clips) if trial.panels else trial for trial in trials)

    def check(self, trials: Sequence[Trial], overrides: Mapping[str, str]) -> list[dict[str, str]]:
        """Every clip there and whole, compared clips equally bright. Returns the overrides that were needed.

        Raises InputError: missing or damaged clips; luminance that differs without the override 'luminance'.
        """
        missing = store_problems(self._clips, self._store)
        if missing:
            hint = problem(self._store.root, "clips", f"{len(missing)} missing or damaged", f"all: {self._command()}")
            raise InputError(hint, *missing[:5])
        dark = [line for t in trials if t.panels for line in luminance_problems(self._study, t, self._store)]
        if not dark:
            return []
        if overrides.get(LUMINANCE_OVERRIDE, "").strip():
            return [{"check": LUMINANCE_OVERRIDE, "reason": overrides[LUMINANCE_OVERRIDE]}]
        hint = f"{len(dark)} trials (or --override {LUMINANCE_OVERRIDE}=REASON)"
        raise InputError(problem("luminance", "compared clips differ in", hint, "none"), *dark[:5])

    def _command(self) -> str:
        return f"studyapp render {self._protocol}"

    def __call__(self, trial: Trial) -> Mapping[str, FrameSource]:
        for panel in trial.panels:
            if panel.clip:
                self._used[panel.clip] = None
        return sources_for(trial, self._store)

    def rows(self) -> list[tuple[str, str, str]]:
        """(identity, manifest, cost) of each clip shown, for the session's ``clips``."""
        records = [clip_record(self._store.open(identity)) for identity in self._used]
        return [
            (
                str(record["clip"]),
                json.dumps(record["manifest"], sort_keys=True),
                json.dumps(record["cost"], sort_keys=True),
            )
            for record in records
        ]
