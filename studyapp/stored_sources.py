"""Frames of a session's trials from the clip store, and every check of them before anything is shown."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from protocols.load import library_path
from protocols.requests import ClipSpec
from protocols.study import Study
from protocols.trial import Trial
from stimuli.clip import ClipStore
from stimuli.clip_request import ClipRequest
from stimuli.encode import DisplayTable
from stimuli.errors import InputError, problem
from stimuli.play_cache import PlayCache, PlayedClip
from studyapp.clips import (
    StudyClips,
    clip_record,
    luminance_problems,
    measured_read_rate,
    resolve_clips,
    sources_for,
    store_problems,
    with_clips,
)  # fmt: skip
from studyapp.gaze.angles import ScreenGeometry
from studyapp.seams import FrameSource, GazeSource
from studyapp.store_root import store_directory

if TYPE_CHECKING:  # the ray engine is loaded only where a panel is live
    from studyapp.live_sources import LiveSources
    from studyapp.present.live import LiveSource

DISK_SAMPLE_BYTES = 1 << 28
LUMINANCE_OVERRIDE = "luminance"


def free_memory_bytes() -> int:
    """Memory that programs can have now."""
    return int(psutil.virtual_memory().available)


class StoredSources:
    """Slot -> frames for each trial, played from the store (``given``: --store), encoded for ``table`` (None: sRGB).
    Raises InputError where scenes are nowhere."""

    def __init__(
        self, study: Study, protocol: str | Path, given: Path | None, table: DisplayTable | None = None
    ) -> None:
        self._study = study
        self._table = table
        self.disk_bytes_s: float | None = None
        self._protocol = protocol
        self._store = ClipStore(store_directory(protocol, None if given is None else str(given)))
        self._clips: StudyClips = resolve_clips(study, protocol, self._store)
        self._used: dict[str, None] = {}
        self._told: set[str] = set()
        self._live: LiveSources | None = None
        self._shown: dict[str, LiveSource] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """What stands in for what."""
        return self._clips.notes

    @property
    def requests(self) -> Mapping[ClipSpec, ClipRequest]:
        """Every stored clip of the study."""
        return self._clips.requests

    def played(self, identity: str) -> PlayedClip:
        """The frames of one clip from the play cache, which is filled where it is not."""
        return PlayCache(self._store).played(self._store.open(identity))

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
        played = sources_for(trial, self._store, self._table)
        # Where memory is short, the presenter asks what the disk gives (a rate that `sources_for` has found enough).
        self.disk_bytes_s = None
        if played and sum({s.path: s.byte_count for s in played.values()}.values()) > 0.8 * free_memory_bytes():
            largest = max(played.values(), key=lambda source: source.byte_count)
            self.disk_bytes_s = measured_read_rate(largest.path, DISK_SAMPLE_BYTES)
        frames: dict[str, FrameSource] = dict(played)
        self._shown = {}
        for panel in trial.panels:
            if panel.live:
                self._shown[panel.slot] = frames[panel.slot] = self._rendered(trial, panel.slot)
        return frames

    def look_with(self, gaze: GazeSource | None, screen: ScreenGeometry | None = None) -> None:
        """Live panels follow this gaze, where they stand on ``screen`` (gaze None: their centre)."""
        from studyapp.live_sources import LiveSources

        beside = library_path(self._protocol).parent
        self._live = LiveSources(self._study, beside, self._store, gaze, self._table, screen)

    def _rendered(self, trial: Trial, slot: str) -> LiveSource:
        if self._live is None:
            self.look_with(None)
        assert self._live is not None
        return self._live.source(trial, slot)

    def live_logs(self, number: int) -> list[tuple[str, bytes]]:
        """(payload, frames) of every live panel of the trial shown last, which was presentation ``number``."""
        if not self._shown:
            return []
        from studyapp.live_sources import log_of

        logs = [log_of(source, number, slot) for slot, source in self._shown.items()]
        return [(log.payload, log.frames) for log in logs]

    def new_rows(self) -> list[tuple[str, str, str]]:
        """`rows` of the clips that were first shown since the last call."""
        new = [identity for identity in self._used if identity not in self._told]
        self._told.update(new)
        return self.rows(new) if new else []

    def rows(self, identities: Sequence[str] | None = None) -> list[tuple[str, str, str]]:
        """(identity, manifest, cost) of each clip shown (or of those given), for the session's ``clips``."""
        shown = self._used if identities is None else identities
        records = [clip_record(self._store.open(identity)) for identity in shown]
        return [
            (
                str(record["clip"]),
                json.dumps(record["manifest"], sort_keys=True),
                json.dumps(record["cost"], sort_keys=True),
            )
            for record in records
        ]
