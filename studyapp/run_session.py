"""Everything that one session needs, put together, run, and taken down again."""

from __future__ import annotations

import contextlib
import errno
import sys
from collections.abc import Callable, Sequence

from protocols.check import first_adaptive_trial
from protocols.design import plan
from protocols.load import library_path, read_study
from protocols.study import Study
from protocols.trial import Trial
from studyapp.cli import JobFailed
from studyapp.display.certificate import certify
from studyapp.gaze.before_session import check_gaze
from studyapp.inclusion import answers_about_self
from studyapp.lab_file import Lab, find_lab
from studyapp.manifest_source import Manifests
from studyapp.person_code import person_code
from studyapp.present.frame_loop import ask_realtime, children_stay_normal, leave_realtime, set_aside
from studyapp.resume import session_paths, unfinished
from studyapp.session import SessionStopped, Sources
from studyapp.session_checks import different_samples, interrupted_session, require_space, require_writable
from studyapp.session_course import run_course
from studyapp.session_devices import SessionCalibration, emulated_devices, lab_devices
from studyapp.session_log import LogFailed
from studyapp.session_parts import Prepared, RunDone, RunRequest
from studyapp.session_room import (
    eye_to_light,
    flip_to_light,
    lock_overrides,
    room_warnings,
    screen_of,
    session_display,
    session_style,
    upload_budget,
)
from studyapp.stored_sources import StoredSources

DISK_ERRORS = (errno.ENOSPC, errno.EROFS, errno.EDQUOT, errno.EIO)


def run_session(request: RunRequest) -> RunDone:
    """Run (or go on with) one session. Raises InputError before anything is shown, JobFailed afterwards."""
    study, text = read_study(request.protocol)
    trials = plan(study, request.participant)
    lab = find_lab(request.lab, library_path(request.protocol).parent)
    require_writable(request.data)
    observer_kind = "simulated" if request.simulated else "person"
    before = None
    if request.resume:
        before = interrupted_session(request.data, study, request.participant, request.code, text, observer_kind)
    about, person = {}, ("", 0)
    if before is None:
        person = person_code(request.data, study.study, request.participant, request.code, request.simulated)
        about = answers_about_self(study, request.simulated, request.about, request.overrides)
    require_space(request.data, study, trials)
    earlier = session_paths(request.data, study.study, request.participant)
    if before is None and earlier and unfinished(earlier[-1]):
        print(f"note: {earlier[-1]} was interrupted (--resume goes on with it); this is a new run", file=sys.stderr)
    kind = request.display or lab.display.kind
    used = different_samples(study, request.overrides)
    sources, new_clips = _sources(request, study, lab, kind)
    if isinstance(sources, StoredSources):
        trials = sources.planned(trials) if before is None else before.plan
        used += sources.check(trials, request.overrides)
    with contextlib.ExitStack() as stack:
        # Before the display is opened: the driver's own threads inherit it.
        priority = ask_realtime() if request.realtime else "normal"
        stack.callback(leave_realtime)
        # The virtual clock goes on after the newest stamp in the file.
        start_ns = None if before is None else before.last_ns + 1_000_000_000
        monitor = request.monitor if request.monitor is not None else lab.display.monitor
        display = session_display(kind, study, monitor, start_ns)
        stack.callback(display.close)
        style = session_style(study, lab)
        certificate = certify(
            display, 480, light=flip_to_light(display, lab), declared=lab.display.declared,
            encoding=lab.encoding_name(), photometry=lab.photometry_record(), background_code=style.background,
            priority=priority,
        )  # fmt: skip
        warnings = room_warnings(study, lab, certificate)
        for warning in () if request.simulated else warnings:
            print(f"warning: {warning}", file=sys.stderr)
        # Writer, readers and emulators are started from here on, and are to stay ordinary processes.
        children_stay_normal()
        used += lock_overrides(study, certificate, request.overrides, request.simulated)
        budget, needed = upload_budget(display, _shown_trials(study, trials), request.overrides)
        used += needed
        geometry = screen_of(study, lab, display)
        devices = stack.enter_context(
            emulated_devices(display, geometry, study.seed)
            if request.simulated
            else lab_devices(display, lab, geometry)
        )
        eye = devices.emulators[1] if request.simulated else None
        look = None if eye is None else eye.tell
        calibration = SessionCalibration(devices, display, geometry)
        measured, needed = check_gaze(
            study.gaze, devices.gaze, display, geometry, request.overrides,
            None if look is None else lambda x, y: look("look", x, y), background=style.background / 255,
            calibrate=calibration.run if devices.calibrate else None,
            eye_to_light=eye_to_light(study, lab, display, devices.gaze, eye),
        )  # fmt: skip
        used += needed
        if isinstance(sources, StoredSources):
            sources.look_with(devices.gaze, geometry)
        for override in used:
            print(f"note: {override['check']} is overridden: {override['reason']}", file=sys.stderr)
        prepared = Prepared(
            study, text, trials, lab, before, about, person, display, certificate, tuple(used), measured, sources,
            new_clips, devices, calibration.record, budget, tuple(warnings),
        )  # fmt: skip
        stack.enter_context(set_aside())
        try:
            return run_course(request, prepared)
        except (LogFailed, SessionStopped) as error:
            raise JobFailed(str(error)) from error
        except OSError as error:
            if error.errno not in DISK_ERRORS:
                raise
            where = error.filename or request.data
            raise JobFailed(f"{where}: got '{error.strerror}', wanted a writable disk; go on with --resume") from error


def _shown_trials(study: Study, trials: Sequence[Trial]) -> list[Trial]:
    """The planned trials, and the first one of each block that makes its own."""
    learning = [first_adaptive_trial(study, block) for block in study.blocks if block.adaptive is not None]
    return [*trials, *(trial for trial in learning if trial is not None)]


def _sources(
    request: RunRequest, study: Study, lab: Lab, kind: str
) -> tuple[Sources, Callable[[], list[tuple[str, str, str]]]]:
    """Where frames come from, and what the session's ``clips`` will say of them."""
    if kind == "virtual":
        manifests = Manifests(study)
        return manifests, manifests.new_rows
    stored = StoredSources(study, request.protocol, request.store, lab.display_table())
    return stored, stored.new_rows
