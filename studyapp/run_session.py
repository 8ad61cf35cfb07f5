"""Everything that one session needs, put together, run, and taken down again."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

from protocols.design import plan
from protocols.load import library_path, read_study
from protocols.participants import Inclusion
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
from studyapp.lab_file import Lab, find_lab, photometry_age_warning
from studyapp.manifest_source import Manifests
from studyapp.present.presenter import Presenter
from studyapp.resume import Interrupted, interrupted, mend, next_session_path, session_paths
from studyapp.seams import Display
from studyapp.session import Progress, Session, SessionStopped, Sources, finish
from studyapp.session_devices import SessionDevices, emulated_devices, lab_devices
from studyapp.session_header import session_header, sha256_text
from studyapp.session_log import DurableLog, LogFailed, SessionLog
from studyapp.simulated_respondent import SimulatedRespondent
from studyapp.stored_sources import StoredSources
from studyapp.trial import Person, Respondent, Rules, TrialDone, TrialRunner

INCLUSION_OVERRIDE = "inclusion"
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
    pids: Path | None = None


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
    about = _about_self(study, request) if before is None else {}
    _writable(request.data)
    kind = request.display or lab.display.kind
    sources, clip_rows = _sources(request, study, kind)
    used = []
    if isinstance(sources, StoredSources):
        trials = sources.planned(trials) if before is None else before.plan
        used = sources.check(trials, request.overrides)
    with contextlib.ExitStack() as stack:
        display = _display(request, study, lab, kind, before)
        stack.callback(display.close)
        certificate = certify(
            display, 480, declared=lab.display.declared, encoding=lab.encoding_name(),
            photometry=lab.photometry_record(),
        )  # fmt: skip
        used += _permitted(request, study, certificate)
        geometry = _screen(study, lab)
        devices = stack.enter_context(
            emulated_devices(display, geometry, study.seed)
            if request.simulated
            else lab_devices(display, lab, geometry)
        )
        try:
            return _run(request, study, text, trials, lab, before, about, display, certificate, used, sources,
                        clip_rows, devices)  # fmt: skip
        except (LogFailed, SessionStopped) as error:
            raise JobFailed(str(error)) from error


def _run(
    request: RunRequest, study: Study, text: str, trials: tuple[Trial, ...], lab: Lab, before: Interrupted | None,
    about: Mapping[str, str], display: Display, certificate: Certificate, used: list[dict[str, str]],
    sources: Sources, clip_rows: Callable[[], list[tuple[str, str, str]]], devices: SessionDevices,
) -> RunDone:  # fmt: skip
    kind = "simulated" if request.simulated else "person"
    seed = study.seed if request.seed is None else request.seed
    progress = Progress()
    if before is None:
        path, run = next_session_path(request.data, study.study, request.participant)
    else:
        mend(before, kind, clock.now_ns())
        again = interrupted(before.path, sha256_text(text))
        path, run, progress, trials = before.path, int(before.header["run"]), again.progress, before.plan
        seed = int(before.header["seed"])
    log = DurableLog(path, devices.streams, flip_seconds=STREAM_RING_FLIP_S)
    try:
        respondent: Respondent = Person(devices.answers.name)
        if request.simulated:
            respondent = _simulated(study, request.participant, seed, devices)
        if before is None:
            header = session_header(
                study, text, request.participant, run, trials, seed, observer_kind=kind,
                observer=f"{respondent.name} through {devices.answers.name}", certificate=certificate, lab=lab,
                overrides=used,
            )  # fmt: skip
            log.header(header)
            for name, value in about.items():
                log.about_self(name, value)
            _warn_of_photometry(log, study, lab)
            for note in sources.notes if isinstance(sources, StoredSources) else ():
                log.note(note)
        if request.pids is not None:
            request.pids.write_text(json.dumps({**devices.pids(), "writer": log.pid}))
        counted = {"answers": 0}

        def on_trial(done: TrialDone) -> None:
            counted["answers"] += len(done.responses)
            if done.row.kind == "consent" and done.status == "ok":
                log.about_self("consent", json.dumps(_consent(study, trials[done.row.planned], text)))

        runner = TrialRunner(
            Presenter(
                display, log, geometry=_view_geometry(study, lab), abort_keys=frozenset({"escape"}),
            ),
            devices.answers, respondent, Rules(study.timing.miss_policy, study.timing.max_missed),
            # The virtual display leaps over refreshes: there is nothing to look at in between.
            None if isinstance(display, VirtualDisplay) else devices.gaze,
        )  # fmt: skip
        session = Session(log, runner, sources, devices.reconnect, study.timing.requeue, on_trial)
        shown = session.run(trials, progress)
        for row in clip_rows():
            log.clip(*row)
        statistics = finish(log)
        return RunDone(path, shown, counted["answers"], statistics.lost)
    finally:
        log.close()


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


def _sources(request: RunRequest, study: Study, kind: str) -> tuple[Sources, Callable[[], list[tuple[str, str, str]]]]:
    """Where frames come from, and what the session's ``clips`` will say of them."""
    if kind == "virtual":
        manifests = Manifests(study)
        return manifests, manifests.rows
    stored = StoredSources(study, request.protocol, request.store)
    return stored, stored.rows


def _screen(study: Study, lab: Lab) -> ScreenGeometry:
    view = _view_geometry(study, lab)
    return ScreenGeometry(view.width_m, view.height_m, view.distance_m, study.display.size_px)


def _view_geometry(study: Study, lab: Lab) -> ViewGeometry:
    """The lab's screen; the protocol's where there is no lab file."""
    if lab.path is not None:
        return lab.display.geometry
    wide, high = study.display.panel_m(study.display.size_px)
    return ViewGeometry(wide, high, study.display.distance_m)


def _consent(study: Study, trial: Trial, text: str) -> dict[str, Any]:
    """What was agreed to and when: the words' hash, the protocol's hash as their version, the time."""
    return {
        "text_sha256": sha256_text(trial.text), "version": sha256_text(text)[:12], "utc": clock.wall_clock_utc(),
        "study": study.study,
    }  # fmt: skip


def _about_self(study: Study, request: RunRequest) -> dict[str, str]:
    """Answers to the inclusion questions, JSON; InputError where a person's are missing or miss the bound."""
    asked = study.participants.inclusion
    if request.simulated:
        return {inclusion.name: json.dumps("simulated: meets the bound") for inclusion in asked}
    problems, out = [], {}
    unknown = sorted(set(request.about) - {inclusion.name for inclusion in asked})
    for name in unknown:
        wanted = " | ".join(inclusion.name for inclusion in asked) or "none: the protocol asks nothing"
        problems.append(problem("--about", "question", name, wanted))
    for inclusion in asked:
        given = request.about.get(inclusion.name)
        if given is None:
            problems.append(problem("--about", inclusion.name, "no answer", f"an answer to: {inclusion.text}"))
            continue
        value, why = _meets(inclusion, given)
        out[inclusion.name] = json.dumps(value)
        if why is not None and not request.overrides.get(INCLUSION_OVERRIDE):
            problems.append(problem("--about", inclusion.name, given, f"{why} (or --override inclusion=REASON)"))
    if problems:
        raise InputError(*problems)
    return out


def _meets(inclusion: Inclusion, given: str) -> tuple[object, str | None]:
    """(value, None), or (value, what was wanted) where the bound is missed."""
    if inclusion.kind == "number":
        try:
            number = float(given)
        except ValueError:
            return given, "a number"
        low = -float("inf") if inclusion.at_least is None else inclusion.at_least
        high = float("inf") if inclusion.at_most is None else inclusion.at_most
        return number, None if low <= number <= high else f"a number from {low:g} to {high:g}"
    if inclusion.kind == "yes_no":
        if given not in ("yes", "no"):
            return given, "yes | no"
        fits = inclusion.equals is None or (given == "yes") == inclusion.equals
        return given, None if fits else ("yes" if inclusion.equals else "no")
    wanted = inclusion.one_of if inclusion.one_of is not None else inclusion.options
    return given, None if given in wanted else " | ".join(wanted)


def _warn_of_photometry(log: SessionLog, study: Study, lab: Lab) -> None:
    today = clock.wall_clock_utc()[:10]
    from datetime import date

    limit = lab.photometry.max_age_days if lab.photometry is not None else study.timing.photometry_max_age_days
    warning = photometry_age_warning(lab.photometry_record(), limit, date.fromisoformat(today))
    if warning is not None:
        log.note(warning)
