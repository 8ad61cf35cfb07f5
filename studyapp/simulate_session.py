"""One whole simulated session on the virtual display, written in this process."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path

from protocols.adaptive import procedure
from protocols.design import plan
from protocols.load import read_study
from protocols.study import Study
from protocols.trial import Trial
from studyapp.devices.simulated import DirectPresses
from studyapp.display.certificate import certify
from studyapp.display.virtual_display import VirtualDisplay
from studyapp.lab_file import Lab
from studyapp.manifest_source import Manifests
from studyapp.person_code import person_code
from studyapp.picture_errors import PictureErrors, ShownFrames, judged
from studyapp.present.presenter import Presenter
from studyapp.resume import next_session_path
from studyapp.seams import FrameSource
from studyapp.session import Session, finish
from studyapp.session_header import here_and_now, session_header
from studyapp.session_log import DirectLog
from studyapp.simulated_respondent import SimulatedRespondent
from studyapp.trial import Rules, TrialRunner


class StoredPictures:
    """The clips of a study in a store, for observers that judge by them."""

    def __init__(self, study: Study, protocol: str | Path, store: str | None) -> None:
        from studyapp.stored_sources import StoredSources

        judged(study, ())
        assert study.observer.pictures is not None
        self._study, self._sources = study, StoredSources(study, protocol, None if store is None else Path(store))
        played: dict[str, FrameSource] = {}

        def clip(identity: str) -> FrameSource:
            if identity not in played:
                played[identity] = self._sources.played(identity)
            return played[identity]

        self.metric = PictureErrors(study, self._sources.requests, clip, study.observer.pictures.metric)
        self._used: dict[str, None] = {}

    def planned(self, trials: Sequence[Trial]) -> tuple[Trial, ...]:
        """The trials with their clips named. Raises InputError: clips missing, pictures that cannot be judged."""
        judged(self._study, trials)
        named = self._sources.planned(trials)
        self._sources.check(named, {"luminance": "simulated observers see what differs"})
        self._used.update(dict.fromkeys(panel.clip for trial in named for panel in trial.panels if panel.clip))
        return named

    def rows(self) -> list[tuple[str, str, str]]:
        """(identity, manifest, cost) of each clip met so far, for the session's ``clips``."""
        return self._sources.rows(tuple(self._used))


class Simulation:
    """Simulated sessions of one protocol with one ``seed``. Equal arguments give equal answers and stamps.

    ``pictures``: the observers judge by the frames of the clips in ``store`` (None: the protocol's own) that were
    shown. Raises InputError where clips are missing, or where trials cannot be judged so.
    """

    def __init__(self, protocol: str | Path, seed: int, pictures: bool = False, store: str | None = None) -> None:
        self.study, self._text = read_study(protocol)
        self._pictures = StoredPictures(self.study, protocol, store) if pictures else None
        self._seed = seed
        self._provenance = here_and_now()
        rate = Fraction(self.study.display.refresh_hz)
        self._certificate = certify(VirtualDisplay(self.study.display.size_px, rate), 480)

    def session(self, participant: int, folder: Path) -> Path:
        """Simulate one participant; the session's path. Raises LogFailed."""
        study = self.study
        trials = plan(study, participant)
        if self._pictures is not None:
            trials = self._pictures.planned(trials)
        display = VirtualDisplay(study.display.size_px, Fraction(study.display.refresh_hz))
        code, run = person_code(folder, study.study, participant, "", simulated=True)
        path = next_session_path(folder, study.study, participant)
        log = DirectLog(path)
        try:
            presses = DirectPresses(display.now_ns)
            seen = ShownFrames(log)
            judging = self._pictures

            def errors(trial: Trial) -> Mapping[str, float]:
                assert judging is not None
                return judging.metric.errors(trial, seen.shown(trial))

            respondent = SimulatedRespondent(
                study, participant, self._seed, presses.press, errors=None if judging is None else errors
            )
            log.header(
                session_header(
                    study,
                    self._text,
                    participant,
                    code,
                    run,
                    trials,
                    self._seed,
                    observer_kind="simulated",
                    observer="protocols.observer, answering directly" + (", by the pictures" if judging else ""),
                    certificate=self._certificate,
                    lab=Lab(),
                    provenance=self._provenance,
                )
            )
            for inclusion in study.participants.inclusion:
                log.about_self(inclusion.name, json.dumps("simulated: meets the bound"))
            sources = Manifests(study)
            rules = Rules(study.timing.miss_policy, study.timing.max_missed)
            runner = TrialRunner(Presenter(display, seen), presses, respondent, rules)

            def begin(trial: Trial) -> Mapping[str, FrameSource]:
                seen.begin()
                return sources(trial)

            session = Session(log, runner, begin, requeue=study.timing.requeue)
            if any(block.adaptive is not None for block in study.blocks):
                made: list[Trial] = []

                def keep(trial: Trial) -> Trial:
                    if judging is not None:
                        (trial,) = judging.planned([trial])
                    made.append(trial)
                    return trial

                session.run_procedure(procedure(study, participant), keep)
                log.header({"plan": [trial.as_dict() for trial in made]})
            else:
                session.run(trials)
            for row in sources.rows() if judging is None else judging.rows():
                log.clip(*row)
            finish(log)
        finally:
            log.close()
        return path
