"""What must hold before a session begins: a disk that takes it, a session to go on with, conditions that differ."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path

from protocols.check import trial_seconds
from protocols.gaze_demands import SAME_SAMPLES_OVERRIDE, same_samples_problems
from protocols.records import FLIP_DTYPE, GAZE_DTYPE
from protocols.study import Study
from protocols.trial import Trial
from stimuli.errors import InputError, problem
from studyapp.resume import Interrupted, interrupted, session_paths
from studyapp.session_header import sha256_text

EVENT_BYTES_S = 4096.0  # presses, clock fits, SQLite's own pages
LEAST_FREE_BYTES = 16_000_000


def require_writable(folder: Path) -> None:
    """Tried, not asked for: a disk may be mounted read-only, or full, and still say that the folder may be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"?")
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as error:
        raise InputError(problem(folder, "data folder", error.strerror, "a folder that can be written")) from error


def require_space(folder: Path, study: Study, trials: Sequence[Trial]) -> None:
    """Room for all that a session is expected to write, twice over (the write-ahead log holds it once more)."""
    seconds = sum(trial_seconds(study, trial) for trial in trials)
    per_s = float(Fraction(study.display.refresh_hz)) * FLIP_DTYPE.itemsize + EVENT_BYTES_S
    if study.gaze.required:
        per_s += float(Fraction(study.gaze.rate_hz)) * GAZE_DTYPE.itemsize
    needed, free = 2 * seconds * per_s + LEAST_FREE_BYTES, shutil.disk_usage(folder).free
    if free < needed:
        wanted = f"{needed / 1e6:.0f} MB for this session"
        raise InputError(problem(folder, "free space", f"{free / 1e6:.0f} MB", wanted))


def interrupted_session(folder: Path, study: Study, participant: int, code: str, text: str, kind: str) -> Interrupted:
    """The slot's newest session, to go on with. InputError: none, complete, of another protocol, observer or (where a
    ``code`` is given) person."""
    paths = session_paths(folder, study.study, participant)
    if not paths:
        where = folder / f"{study.study}_p{participant}_*.sqlite"
        raise InputError(problem(where, "session to resume", "none", "an interrupted session"))
    before = interrupted(paths[-1], sha256_text(text))
    if before.header["observer_kind"] != kind:
        wanted = f"the {before.header['observer_kind']} observer it was begun with"
        raise InputError(problem(before.path, "observer", kind, wanted))
    if code and before.header["participant"] != code:
        wanted = f"the person it was begun with ({before.header['participant']})"
        raise InputError(problem(before.path, "--code", code, wanted))
    return before


def different_samples(study: Study, overrides: Mapping[str, str]) -> list[dict[str, str]]:
    """The override that was needed, if one was; InputError for conditions that show the same without it."""
    alike = same_samples_problems(study)
    reason = overrides.get(SAME_SAMPLES_OVERRIDE, "").strip()
    if alike and not reason:
        raise InputError(*alike)
    return [{"check": SAME_SAMPLES_OVERRIDE, "reason": reason}] if alike else []
