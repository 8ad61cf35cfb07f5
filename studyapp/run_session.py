"""Everything that one session needs, put together, run, and taken down again."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import date
from fractions import Fraction
from pathlib import Path
from typing import Any

from protocols.adaptive import procedure
from protocols.conditions import Gaze
from protocols.design import plan
from protocols.gaze_demands import SAME_SAMPLES_OVERRIDE, same_samples_problems
from protocols.load import library_path, read_study
from protocols.study import Study
from protocols.trial import Trial
from renderers.technique import ViewGeometry
from stimuli.errors import InputError, problem
from studyapp import clock
from studyapp.cli import JobFailed
from studyapp.display.certificate import Certificate, certify, require_lock
from studyapp.display.choose import open_display
from studyapp.display.virtual_display import VirtualDisplay
from studyapp.gaze.angles import ScreenGeometry
from studyapp.gaze.before_session import check_gaze
from studyapp.gaze.fixation import FixationWatch
from studyapp.inclusion import answers_about_self
from studyapp.lab_file import Lab, find_lab, photometry_age_warning
from studyapp.manifest_source import Manifests
from studyapp.present.frame_loop import ask_realtime, children_stay_normal, leave_realtime
from studyapp.present.overlay import Style, style_on
from studyapp.present.presenter import Presenter
from studyapp.resume import Interrupted, answers_so_far, interrupted, mend, next_session_path, session_paths, unfinished
from studyapp.seams import Display, FrameSource
from studyapp.session import Progress, Session, SessionStopped, Sources, finish
from studyapp.session_devices import SessionCalibration, SessionDevices, emulated_devices, lab_devices
from studyapp.session_header import session_header, sha256_text
from studyapp.session_log import DurableLog, LogFailed, SessionLog
from studyapp.simulated_respondent import SimulatedRespondent
from studyapp.stored_sources import StoredSources
from studyapp.target_path import TargetPaths
from studyapp.trial import Person, Respondent, Rules, TrialDone, TrialRunner

STREAM_RING_FLIP_S = 600.0


@dataclass(frozen=True)
class RunRequest:
    """What the command line asks for."""

    protocol: str
    participant: int
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


def run_session(request: RunRequest) -> RunDone:
    """Run (or go on with) one session. Raises InputError before anything is shown, JobFailed afterwards."""
    study, text = read_study(request.protocol)
    trials = plan(study, request.participant)
    lab = find_lab(request.lab, library_path(request.protocol).parent)
    before = _interrupted(request, study, text) if request.resume else None
    if before is not None and before.header["observer_kind"] != ("simulated" if request.simulated else "person"):
        wanted = f"the {before.header['observer_kind']} observer it was begun with"
        raise InputError(problem(before.path, "observer", "simulated" if request.simulated else "person", wanted))
    about = {}
    if before is None:
        about = answers_about_self(study, request.simulated, request.about, request.overrides)
    _writable(request.data)
    earlier = session_paths(request.data, study.study, request.participant)
    if before is None and earlier and unfinished(earlier[-1]):
        print(f"note: {earlier[-1]} was interrupted (--resume goes on with it); this is a new run", file=sys.stderr)
    kind = request.display or lab.display.kind
    used = _different_samples(study, request.overrides)
    sources, clip_rows = _sources(request, study, lab, kind)
    if isinstance(sources, StoredSources):
        trials = sources.planned(trials) if before is None else before.plan
        used += sources.check(trials, request.overrides)
    with contextlib.ExitStack() as stack:
        # Before the display is opened: the driver's own threads inherit it.
        priority = ask_realtime() if request.realtime else "normal"
        stack.callback(leave_realtime)
        display = _display(request, study, lab, kind, before)
        stack.callback(display.close)
        style = session_style(study, lab)
        certificate = certify(
            display, 480, light=_light(display, lab), declared=lab.display.declared, encoding=lab.encoding_name(),
            photometry=lab.photometry_record(), background_code=style.background, priority=priority,
        )  # fmt: skip
        # Writer, readers and emulators are started from here on, and are to stay ordinary processes.
        children_stay_normal()
        used += _permitted(request, study, certificate)
        geometry = _screen(study, lab, display)
        devices = stack.enter_context(
            emulated_devices(display, geometry, study.seed)
            if request.simulated
            else lab_devices(display, lab, geometry)
        )
        look = devices.emulators[1].tell if request.simulated else None
        calibration = SessionCalibration(devices, display, geometry)
        measured, needed = check_gaze(
            study.gaze, devices.gaze, display, geometry, request.overrides,
            None if look is None else lambda x, y: look("look", x, y), background=style.background / 255,
            calibrate=calibration.run if devices.calibrate else None,
        )  # fmt: skip
        used += needed
        if isinstance(sources, StoredSources):
            sources.look_with(devices.gaze)
        prepared = Prepared(
            study, text, trials, lab, before, about, display, certificate, tuple(used), measured, sources, clip_rows,
            devices, calibration.record,
        )  # fmt: skip
        try:
            return _run(request, prepared)
        except (LogFailed, SessionStopped) as error:
            raise JobFailed(str(error)) from error


@dataclass(frozen=True)
class Prepared:
    """All parts of a session, checked and ready."""

    study: Study
    text: str
    trials: tuple[Trial, ...]
    lab: Lab
    before: Interrupted | None
    about: Mapping[str, str]
    display: Display
    certificate: Certificate
    overrides: tuple[dict[str, str], ...]
    gaze_validation: dict[str, Any] | None
    sources: Sources
    clip_rows: Callable[[], list[tuple[str, str, str]]]
    devices: SessionDevices
    calibration: Mapping[str, Any] | None = None


def _run(request: RunRequest, ready: Prepared) -> RunDone:
    study, before, devices, trials = ready.study, ready.before, ready.devices, ready.trials
    kind = "simulated" if request.simulated else "person"
    seed = study.seed if request.seed is None else request.seed
    progress = Progress()
    if before is None:
        path, run = next_session_path(request.data, study.study, request.participant)
    else:
        mend(before, kind, clock.now_ns())
        again = interrupted(before.path, sha256_text(ready.text))
        path, run, progress, trials = before.path, int(before.header["run"]), again.progress, before.plan
        seed = int(before.header["seed"])
    log = DurableLog(path, devices.streams, flip_seconds=STREAM_RING_FLIP_S, markers=request.markers)
    try:
        respondent: Respondent = Person(devices.answers.name)
        if request.simulated:
            respondent = _simulated(study, request.participant, seed, devices)
        if before is None:
            header = session_header(
                study, ready.text, request.participant, run, trials, seed, observer_kind=kind,
                observer=f"{respondent.name} through {devices.answers.name}", certificate=ready.certificate,
                lab=ready.lab, overrides=ready.overrides,
            )  # fmt: skip
            log.header(header)
        _first_words(log, ready)
        if request.pids is not None:
            request.pids.write_text(json.dumps({**devices.pids(), "writer": log.pid}))
        counted = {"answers": 0}
        targets = TargetPaths(study, library_path(request.protocol).parent, _screen(study, ready.lab, ready.display))
        if isinstance(ready.sources, StoredSources):
            for trial in trials:
                targets.prepare(trial)

        def on_trial(done: TrialDone) -> None:
            counted["answers"] += len(done.responses)

        def before_commit(trial: Trial, number: int) -> None:
            if trial.kind == "consent":
                log.about_self("consent", json.dumps(_consent(study, trial, ready.text)))
            if isinstance(ready.sources, StoredSources) and trial.panels:
                for payload, frames in ready.sources.live_logs(number):
                    log.event("live", "frames", payload, frames)
                if (path := targets.record(trial, number)) is not None:
                    log.event("target", "path", path.payload, path.raw)
            if runner.fixation is not None:
                log.event("eyes", "fixation", json.dumps(fixation_record(study.gaze, trial, number, runner)))

        presenter = Presenter(
            ready.display, log, geometry=_view_geometry(study, ready.lab), style=session_style(study, ready.lab),
            patch="off" if ready.lab.sensor is None else "refresh", abort_keys=frozenset({"escape"}),
        )  # fmt: skip
        rules = Rules(study.timing.miss_policy, study.timing.max_missed, study.gaze.fixation_limit_deg)
        # The virtual display leaps over refreshes: there is nothing to look at in between.
        watched = None
        if devices.gaze is not None and not isinstance(ready.display, VirtualDisplay):
            watched = FixationWatch(devices.gaze)
        runner = TrialRunner(presenter, devices.answers, respondent, rules, watched)

        def sources(trial: Trial) -> Mapping[str, FrameSource]:
            frames = ready.sources(trial)
            if isinstance(ready.sources, StoredSources):
                presenter.disk_bytes_s = ready.sources.disk_bytes_s
            return frames

        session = Session(log, runner, sources, devices.reconnect, study.timing.requeue, on_trial, before_commit)
        if is_adaptive(study):
            shown = _run_adaptive(session, log, request, ready, trials, progress)
        else:
            shown = session.run(trials, progress)
        for row in ready.clip_rows():
            log.clip(*row)
        statistics = finish(log)
        return RunDone(path, shown, counted["answers"], statistics.lost)
    finally:
        log.close()


def fixation_record(limits: Gaze, trial: Trial, number: int, runner: TrialRunner) -> dict[str, Any]:
    """What the session keeps of a trial's gaze, JSON-ready; ``flagged``: fixated, and gaze strayed or drifted."""
    seen, drift = runner.fixation, runner.drift
    assert seen is not None
    strayed = not seen.worst_deg <= limits.fixation_limit_deg
    drifted = drift is not None and not drift.within(limits.drift_deg)
    record = {
        "trial": number, "outside": seen.outside, "worst_deg": seen.worst_deg, "loss": seen.loss, "samples": seen.n,
        "drift_deg": None if drift is None else drift.size_deg,
        "flagged": trial.fixation == "fixed" and (strayed or drifted),
    }  # fmt: skip
    return {key: None if isinstance(value, float) and value != value else value for key, value in record.items()}


def _run_adaptive(
    session: Session, log: SessionLog, request: RunRequest, ready: Prepared, trials: tuple[Trial, ...],
    progress: Progress,
) -> int:  # fmt: skip
    """The trials are made as the answers come; the stored plan grows with them."""
    known = {trial.index: trial for trial in trials} if ready.before is not None else {}

    def prepare(trial: Trial) -> Trial:
        if isinstance(ready.sources, StoredSources):
            (trial,) = ready.sources.planned([trial])
        known[trial.index] = trial
        log.header({"plan": [known[index].as_dict() for index in sorted(known)]})
        return trial

    answers = {} if ready.before is None else answers_so_far(ready.before.path)
    return session.run_procedure(procedure(ready.study, request.participant), prepare, progress, answers)


def is_adaptive(study: Study) -> bool:
    """Does any block learn from the answers?"""
    return any(block.adaptive is not None for block in study.blocks)


def _first_words(log: SessionLog, ready: Prepared) -> None:
    """What goes into the file before trial 1, or before the first trial after an interruption."""
    for name, value in ready.about.items():
        log.about_self(name, value)
    if ready.before is not None:
        again = {"certificate": ready.certificate.as_dict(), "overrides": list(ready.overrides)}
        log.event("session", "resumed", json.dumps(again))
    if ready.calibration is not None:
        log.event("eyes", "calibration", json.dumps(ready.calibration))
    if ready.gaze_validation is not None:
        log.event("eyes", "validation", json.dumps(ready.gaze_validation))
    _warn_of_photometry(log, ready.study, ready.lab)
    for note in ready.sources.notes if isinstance(ready.sources, StoredSources) else ():
        log.note(note)


def _simulated(study: Study, participant: int, seed: int, devices: SessionDevices) -> SimulatedRespondent:
    press = getattr(devices.answers, "press")  # noqa: B009  (only emulated devices have it)
    eyes = devices.emulators[1]
    return SimulatedRespondent(study, participant, seed, press, lambda x, y: eyes.tell("look", x, y))


def _interrupted(request: RunRequest, study: Study, text: str) -> Interrupted:
    paths = session_paths(request.data, study.study, request.participant)
    if not paths:
        where = request.data / f"{study.study}_p{request.participant}_*.sqlite"
        raise InputError(problem(where, "session to resume", "none", "an interrupted session"))
    return interrupted(paths[-1], sha256_text(text))


def _writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(problem(folder, "data folder", error.strerror, "a folder that can be written")) from error


def _display(request: RunRequest, study: Study, lab: Lab, kind: str, before: Interrupted | None) -> Display:
    rate = Fraction(study.display.refresh_hz)
    if kind == "virtual" and before is not None:
        # The virtual clock goes on after the newest stamp in the file.
        return VirtualDisplay(study.display.size_px, rate, start_ns=before.last_ns + 1_000_000_000)
    monitor = request.monitor if request.monitor is not None else lab.display.monitor
    return open_display(kind, study.display.size_px, rate, monitor)


def _permitted(request: RunRequest, study: Study, certificate: Certificate) -> list[dict[str, str]]:
    """The overrides that were needed; InputError where a check fails without one."""
    overrides = dict(request.overrides)
    if not study.timing.lock:
        overrides.setdefault("display_lock", "the protocol does not ask for a locked display")
    return require_lock(certificate, Fraction(study.display.refresh_hz), overrides, request.simulated)


def _light(display: Display, lab: Lab) -> dict[str, Any] | None:
    """Flip to light, measured now, where the lab has a sensor and the display has light."""
    if lab.sensor is None or display.context() is None:
        return None
    from studyapp.light_sensor import measure_light

    return measure_light(display, lab.sensor.port)


def _different_samples(study: Study, overrides: Mapping[str, str]) -> list[dict[str, str]]:
    """The override that was needed, if one was; InputError for conditions that show the same without it."""
    alike = same_samples_problems(study)
    reason = overrides.get(SAME_SAMPLES_OVERRIDE, "").strip()
    if alike and not reason:
        raise InputError(*alike)
    return [{"check": SAME_SAMPLES_OVERRIDE, "reason": reason}] if alike else []


def _sources(
    request: RunRequest, study: Study, lab: Lab, kind: str
) -> tuple[Sources, Callable[[], list[tuple[str, str, str]]]]:
    """Where frames come from, and what the session's ``clips`` will say of them."""
    if kind == "virtual":
        manifests = Manifests(study)
        return manifests, manifests.rows
    stored = StoredSources(study, request.protocol, request.store, lab.display_table())
    return stored, stored.rows


def _screen(study: Study, lab: Lab, display: Display) -> ScreenGeometry:
    view = _view_geometry(study, lab)
    return ScreenGeometry(view.width_m, view.height_m, view.distance_m, display.size_px)


def _view_geometry(study: Study, lab: Lab) -> ViewGeometry:
    """The lab's screen; the protocol's where there is no lab file."""
    if lab.path is not None:
        return lab.display.geometry
    wide, high = study.display.panel_m(study.display.size_px)
    return ViewGeometry(wide, high, study.display.distance_m)


def session_style(study: Study, lab: Lab) -> Style:
    """The protocol's background, letters that can be read on it, and the light patch where the lab has its sensor."""
    corner = "lower_left" if lab.sensor is None else lab.sensor.patch_corner
    return style_on(round(255 * study.display.background), corner)


def _consent(study: Study, trial: Trial, text: str) -> dict[str, Any]:
    """What was agreed to and when: the words' hash, the protocol's hash as their version, the time."""
    return {
        "text_sha256": sha256_text(trial.text), "version": sha256_text(text)[:12], "utc": clock.wall_clock_utc(),
        "study": study.study,
    }  # fmt: skip


def _warn_of_photometry(log: SessionLog, study: Study, lab: Lab) -> None:
    today = clock.wall_clock_utc()[:10]
    limit = lab.photometry.max_age_days if lab.photometry is not None else study.timing.photometry_max_age_days
    warning = photometry_age_warning(lab.photometry_record(), limit, date.fromisoformat(today))
    if warning is not None:
        log.note(warning)
