"""The course of a session: from its header to its seal, every trial on the disk before the next."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping

from protocols.adaptive import procedure
from protocols.load import library_path
from protocols.study import Study
from protocols.trial import Trial
from studyapp import clock
from studyapp.display.virtual_display import VirtualDisplay
from studyapp.gaze.fixation import FixationWatch
from studyapp.present.presenter import Presenter
from studyapp.resume import Interrupted, answers_so_far, interrupted, mend, next_session_path
from studyapp.seams import FrameSource
from studyapp.session import Progress, Session, finish
from studyapp.session_devices import SessionDevices
from studyapp.session_header import session_header, sha256_text
from studyapp.session_log import DurableLog, LogFailed, SessionLog
from studyapp.session_parts import Prepared, RunDone, RunRequest
from studyapp.session_record import consent_record, fixation_record
from studyapp.session_room import screen_of, session_style, view_geometry
from studyapp.simulated_respondent import SimulatedRespondent
from studyapp.stored_sources import StoredSources
from studyapp.target_path import TargetPaths
from studyapp.trial import Person, Respondent, Rules, TrialDone, TrialRunner

STREAM_RING_FLIP_S = 600.0


def run_course(request: RunRequest, ready: Prepared) -> RunDone:
    """Run what is planned, or what is left of it. Raises LogFailed and SessionStopped."""
    study, before, devices, trials = ready.study, ready.before, ready.devices, ready.trials
    kind = "simulated" if request.simulated else "person"
    seed = study.seed if request.seed is None else request.seed
    progress = Progress()
    if before is None:
        path = next_session_path(request.data, study.study, request.participant)
    else:
        _mend(before, kind)
        again = interrupted(before.path, sha256_text(ready.text))
        path, progress, trials = before.path, again.progress, before.plan
        seed = int(before.header["seed"])
    log = DurableLog(path, devices.streams, flip_seconds=STREAM_RING_FLIP_S, markers=request.markers)
    try:
        respondent: Respondent = Person(devices.answers.name)
        if request.simulated:
            respondent = _simulated(study, request.participant, seed, devices)
        if before is None:
            header = session_header(
                study, ready.text, request.participant, *ready.person, trials, seed, observer_kind=kind,
                observer=f"{respondent.name} through {devices.answers.name}", certificate=ready.certificate,
                lab=ready.lab, overrides=ready.overrides,
            )  # fmt: skip
            log.header(header)
        ready.begin(log)
        if request.pids is not None:
            request.pids.write_text(json.dumps({**devices.pids(), "writer": log.pid}))
        counted = {"answers": 0}
        targets = TargetPaths(study, library_path(request.protocol).parent, screen_of(study, ready.lab, ready.display))
        if isinstance(ready.sources, StoredSources):
            for trial in trials:
                targets.prepare(trial)

        def on_trial(done: TrialDone) -> None:
            counted["answers"] += len(done.responses)

        def before_commit(trial: Trial, number: int) -> None:
            # With the trial that first shows them: who is killed has said what was shown.
            for row in ready.new_clips():
                log.clip(*row)
            if trial.kind == "consent":
                log.about_self("consent", json.dumps(consent_record(study, trial, ready.text)))
            if isinstance(ready.sources, StoredSources) and trial.panels:
                for payload, frames in ready.sources.live_logs(number):
                    log.event("live", "frames", payload, frames)
                if (path := targets.record(trial, number)) is not None:
                    log.event("target", "path", path.payload, path.raw)
            if runner.fixation is not None:
                log.event("eyes", "fixation", json.dumps(fixation_record(study.gaze, trial, number, runner)))

        presenter = Presenter(
            ready.display, log, geometry=view_geometry(study, ready.lab), style=session_style(study, ready.lab),
            patch="off" if ready.lab.sensor is None else "refresh", abort_keys=frozenset({"escape"}),
            upload_limit_bytes_s=ready.upload_limit_bytes_s, show_gaze=study.gaze.show,
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
        statistics = finish(log)
        return RunDone(path, shown, counted["answers"], statistics.lost)
    finally:
        log.close()


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


def _simulated(study: Study, participant: int, seed: int, devices: SessionDevices) -> SimulatedRespondent:
    press = getattr(devices.answers, "press")  # noqa: B009  (only emulated devices have it)
    eyes = devices.emulators[1]
    return SimulatedRespondent(study, participant, seed, press, lambda x, y: eyes.tell("look", x, y))


def _mend(before: Interrupted, kind: str) -> None:
    try:
        mend(before, kind, clock.now_ns())
    except sqlite3.Error as error:
        raise LogFailed(f"{before.path}: go on with the session: got '{error}', wanted a writable disk") from error
