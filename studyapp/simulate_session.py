"""One whole simulated session on the virtual display, written in this process."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

from protocols.adaptive import procedure
from protocols.design import plan
from protocols.load import read_study
from protocols.trial import Trial
from studyapp.devices.simulated import DirectPresses
from studyapp.display.certificate import certify
from studyapp.display.virtual_display import VirtualDisplay
from studyapp.lab_file import Lab
from studyapp.manifest_source import Manifests
from studyapp.present.presenter import Presenter
from studyapp.resume import next_session_path
from studyapp.session import Session, finish
from studyapp.session_header import here_and_now, session_header
from studyapp.session_log import DirectLog
from studyapp.simulated_respondent import SimulatedRespondent
from studyapp.trial import Rules, TrialRunner


class Simulation:
    """Simulated sessions of one protocol with one ``seed``. Equal arguments give equal answers and stamps."""

    def __init__(self, protocol: str | Path, seed: int) -> None:
        self.study, self._text = read_study(protocol)
        self._seed = seed
        self._provenance = here_and_now()
        rate = Fraction(self.study.display.refresh_hz)
        self._certificate = certify(VirtualDisplay(self.study.display.size_px, rate), 480)

    def session(self, participant: int, folder: Path) -> Path:
        """Simulate one participant; the session's path. Raises LogFailed."""
        study = self.study
        trials = plan(study, participant)
        display = VirtualDisplay(study.display.size_px, Fraction(study.display.refresh_hz))
        path, run = next_session_path(folder, study.study, participant)
        log = DirectLog(path)
        try:
            presses = DirectPresses(display.now_ns)
            respondent = SimulatedRespondent(study, participant, self._seed, presses.press)
            log.header(
                session_header(
                    study,
                    self._text,
                    participant,
                    run,
                    trials,
                    self._seed,
                    observer_kind="simulated",
                    observer="protocols.observer, answering directly",
                    certificate=self._certificate,
                    lab=Lab(),
                    provenance=self._provenance,
                )
            )
            for inclusion in study.participants.inclusion:
                log.about_self(inclusion.name, json.dumps("simulated: meets the bound"))
            sources = Manifests(study)
            rules = Rules(study.timing.miss_policy, study.timing.max_missed)
            runner = TrialRunner(Presenter(display, log), presses, respondent, rules)
            session = Session(log, runner, sources, requeue=study.timing.requeue)
            if any(block.adaptive is not None for block in study.blocks):
                made: list[Trial] = []

                def keep(trial: Trial) -> Trial:
                    made.append(trial)
                    return trial

                session.run_procedure(procedure(study, participant), keep)
                log.header({"plan": [trial.as_dict() for trial in made]})
            else:
                session.run(trials)
            for row in sources.rows():
                log.clip(*row)
            finish(log)
        finally:
            log.close()
        return path
