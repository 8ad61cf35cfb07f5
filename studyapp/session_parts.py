"""What a session is asked for, what it is made of, and what comes of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from protocols.study import Study
from protocols.trial import Trial
from studyapp.display.certificate import Certificate
from studyapp.lab_file import Lab
from studyapp.present.admission import UploadBudget
from studyapp.resume import Interrupted
from studyapp.seams import Display
from studyapp.session import Sources
from studyapp.session_devices import SessionDevices
from studyapp.session_log import SessionLog
from studyapp.session_record import begin_record
from studyapp.session_room import UPLOAD_OVERRIDE, budget_record
from studyapp.stored_sources import StoredSources


@dataclass(frozen=True)
class RunRequest:
    """What the command line asks for. ``participant``: the slot; ``code``: the person's, '' for the slot's number."""

    protocol: str
    participant: int
    code: str = ""
    display: str | None = None
    monitor: int | None = None
    simulated: bool = False
    resume: bool = False
    data: Path = Path("data")
    store: Path | None = None
    lab: str | None = None
    seed: int | None = None
    overrides: Mapping[str, str] = field(default_factory=dict)
    about: Mapping[str, str] = field(default_factory=dict)
    markers: str = ""
    pids: Path | None = None
    realtime: bool = False


@dataclass(frozen=True)
class RunDone:
    """A session that was completed."""

    path: Path
    presentations: int
    answers: int
    lost_records: int


@dataclass(frozen=True)
class Prepared:
    """All parts of a session, checked and ready. ``person``: code, and number of their session."""

    study: Study
    text: str
    trials: tuple[Trial, ...]
    lab: Lab
    before: Interrupted | None
    about: Mapping[str, str]
    person: tuple[str, int]
    display: Display
    certificate: Certificate
    overrides: tuple[dict[str, str], ...]
    gaze_validation: dict[str, Any] | None
    sources: Sources
    new_clips: Callable[[], list[tuple[str, str, str]]]
    devices: SessionDevices
    calibration: Mapping[str, Any] | None = None
    budget: UploadBudget | None = None
    warnings: tuple[str, ...] = ()

    @property
    def upload_limit_bytes_s(self) -> float | None:
        """What a trial may upload; None where nothing was measured, or more was allowed by name."""
        allowed = any(override["check"] == UPLOAD_OVERRIDE for override in self.overrides)
        return None if self.budget is None or allowed else self.budget.limit_bytes_s

    def begin(self, log: SessionLog) -> None:
        """Put on record how the session begins, or goes on."""
        again = None
        if self.before is not None:
            again = {"certificate": self.certificate.as_dict(), "overrides": list(self.overrides)}
        events = [
            ("session", "resumed", again),
            ("session", "upload", None if self.budget is None else budget_record(self.budget)),
            ("eyes", "calibration", self.calibration),
            ("eyes", "validation", self.gaze_validation),
        ]
        told = self.sources.notes if isinstance(self.sources, StoredSources) else ()
        begin_record(log, self.about, events, [*self.warnings, *told])
