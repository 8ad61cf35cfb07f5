"""One planned trial, run: shown by the presenter, answered, turned into the rows that the session file holds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Protocol

from protocols.trial import Question, Trial, is_right
from studyapp.gaze.fixation import DriftCheck, Fixation, FixationWatch
from studyapp.present.frame_loop import MissPolicy
from studyapp.present.presenter import Answer, Presenter, TrialShown
from studyapp.seams import FrameSource, GazeSource, Press, Responder
from studyapp.session_file import ResponseRow, TrialRow

Status = Literal["ok", "timing_failed", "device_lost", "aborted"]
REPLAY_KEY = "r"
CROSS_S = 0.5  # fixation cross before a fixated stimulus


class AnswerDevice(Responder, Protocol):
    """A `Responder` that is told which question is on."""

    def expect(self, question: Question | None) -> None:
        """A new screen begins: ``question``, or words or pictures (None). Earlier presses do not count."""
        ...


class Respondent(Protocol):
    """Who answers. A person needs nothing of this; a simulated observer plans presses in it."""

    kind: Literal["person", "simulated"]
    name: str

    def begins(self, trial: Trial, attempt: int) -> None:
        """``trial`` is about to be shown, for the first (0) or another time."""
        ...

    def sees(self, trial: Trial, onset_ns: int) -> None:
        """Its pictures (or words) came on at ``onset_ns`` on the display's clock."""
        ...

    def asked(self, trial: Trial, question: Question, onset_ns: int, during: bool) -> None:
        """``question`` may be answered from ``onset_ns`` on; ``during``: while the pictures are still up."""
        ...


class Person:
    """A person at the device."""

    kind: Literal["person", "simulated"] = "person"

    def __init__(self, name: str) -> None:
        self.name = name

    def begins(self, trial: Trial, attempt: int) -> None:
        pass

    def sees(self, trial: Trial, onset_ns: int) -> None:
        pass

    def asked(self, trial: Trial, question: Question, onset_ns: int, during: bool) -> None:
        pass


@dataclass(frozen=True)
class Rules:
    """What counts as a well-timed trial (the protocol's ``timing``), and the words of feedback."""

    miss_policy: MissPolicy = "hold"
    max_missed: int = 0
    fixation_limit_deg: float = 3.0
    right: str = "Right."
    wrong: str = "Not this time."


@dataclass(frozen=True)
class TrialDone:
    """The rows of one presentation."""

    row: TrialRow
    responses: tuple[ResponseRow, ...]

    @property
    def status(self) -> str:
        """ok | timing_failed | device_lost | aborted."""
        return self.row.status


@dataclass
class TrialRunner:
    """Runs trials one after the other. ``sources(trial)`` gives each panel's frames by slot."""

    presenter: Presenter
    device: AnswerDevice
    respondent: Respondent
    rules: Rules
    gaze: GazeSource | None = None
    drift: DriftCheck | None = None
    fixation: Fixation | None = None

    def run(self, trial: Trial, sources: Mapping[str, FrameSource], number: int, attempt: int) -> TrialDone:
        """Show ``trial`` as presentation ``number``, ask its questions, return its rows.

        Where `gaze` is a FixationWatch, ``drift`` (on the cross before a fixated stimulus) and ``fixation`` hold what
        was seen of the last trial; None where there was nothing to see.
        """
        self.respondent.begins(trial, attempt)
        self.drift = self.fixation = None
        if not trial.panels:
            return self._words(trial, number, attempt)
        settings = trial.settings
        self.presenter.gap_px = int(settings.get("gap_px", 0))
        self.presenter.mirror = settings.get("mirror", "none")
        iti_s = float(settings.get("iti_s", 0.0))
        if iti_s > 0:
            self.presenter.rest(iti_s, None, cross=trial.fixation == "fixed")
        during = settings.get("response") == "during" and bool(trial.questions)
        if isinstance(self.gaze, FixationWatch):
            self.gaze.begin()
        shown, first = self._show(trial, sources, during)
        self._look_back(trial)
        answers: dict[str, Answer] = {} if first is None else {trial.questions[0].name: first}
        if not (shown.aborted or shown.device_lost):
            self._ask_rest(trial, sources, answers)
        replays = shown.replays + sum(answer.replays for answer in answers.values())
        status = self._status(shown, answers)
        if status == "ok" and settings.get("feedback") and trial.correct is not None:
            self._feedback(trial, answers)
        row = self._row(trial, number, attempt, shown.onset_ns, shown.offset_ns, shown.refreshes, shown.missed, status)
        row = TrialRow(**{**vars(row), "replays": replays})
        responses = tuple(
            _response(trial, question, answers[question.name], number, shown.onset_ns, self.device.name)
            for question in trial.questions
            if question.name in answers and status not in ("aborted", "device_lost")
        )
        return TrialDone(row, responses)

    def _show(self, trial: Trial, sources: Mapping[str, FrameSource], during: bool) -> tuple[TrialShown, Answer | None]:
        """Play the pictures; with ``during`` the first question is answered by the press that ends them."""
        question = trial.questions[0] if during else None
        self.device.expect(question)

        def on_onset(onset_ns: int) -> None:
            self.respondent.sees(trial, onset_ns)
            if question is not None:
                self.respondent.asked(trial, question, onset_ns, during=True)

        gap_s = float(trial.settings.get("interval_gap_s", 0.5))
        cross_s = CROSS_S if trial.fixation == "fixed" else 0.0
        if question is None:
            shown = self.presenter.play(
                trial, sources, self.device, miss_policy=self.rules.miss_policy, gap_s=gap_s, cross_s=cross_s,
                gaze=self.gaze, on_onset=on_onset,
            )  # fmt: skip
            return shown, None
        shown = self.presenter.play(
            trial, sources, self.device, miss_policy=self.rules.miss_policy, gap_s=gap_s, cross_s=cross_s,
            gaze=self.gaze, on_onset=on_onset, answer_keys=frozenset(question.keys), min_view_s=question.min_view_s,
            window_s=question.window_s, repeat="until_answer",
        )  # fmt: skip
        meaning = None if shown.press is None else question.keys.get(shown.press.key)
        return shown, Answer(meaning, shown.press, shown.onset_ns, shown.offset_ns, timed_out=shown.press is None)

    def _look_back(self, trial: Trial) -> None:
        """How gaze behaved while the pictures were up."""
        if not isinstance(self.gaze, FixationWatch):
            return
        if trial.fixation == "fixed":
            self.drift = self.gaze.first(round(CROSS_S * float(self.presenter.display.nominal_hz)))
        self.fixation = self.gaze.result(self.rules.fixation_limit_deg)

    def _ask_rest(self, trial: Trial, sources: Mapping[str, FrameSource], answers: dict[str, Answer]) -> None:
        allowed = int(trial.settings.get("replays", 0))
        for question in trial.questions:
            if question.name in answers:
                continue
            self.device.expect(question)
            answer = self.presenter.ask(
                question,
                self.device,
                replay_key=REPLAY_KEY if allowed else None,
                replay=(lambda: self._show(trial, sources, False)) if allowed else None,
                max_replays=allowed,
                gaze=self.gaze,
                on_onset=partial(self._asked, trial, question),
            )
            answers[question.name] = answer
            if answer.aborted or answer.device_lost:
                return

    def _asked(self, trial: Trial, question: Question, onset_ns: int) -> None:
        self.respondent.asked(trial, question, onset_ns, during=False)

    def _status(self, shown: TrialShown, answers: Mapping[str, Answer]) -> Status:
        if shown.device_lost or any(answer.device_lost for answer in answers.values()):
            return "device_lost"
        if shown.aborted or any(answer.aborted for answer in answers.values()):
            return "aborted"
        return "ok" if shown.timing_ok(self.rules.max_missed) else "timing_failed"

    def _feedback(self, trial: Trial, answers: Mapping[str, Answer]) -> None:
        first = answers.get(trial.questions[0].name)
        if first is not None:
            right = trial.correct is not None and is_right(trial.correct, first.answer)
            self.presenter.show_words(self.rules.right if right else self.rules.wrong, None, duration_s=1.0)

    def _words(self, trial: Trial, number: int, attempt: int) -> TrialDone:
        """Instructions, consent, breaks: read, then any key."""
        self.device.expect(None)
        shown = self.presenter.show_words(
            trial.text, self.device, on_onset=lambda onset_ns: self.respondent.sees(trial, onset_ns)
        )
        status: Status = "device_lost" if shown.device_lost else "aborted" if shown.aborted else "ok"
        return TrialDone(self._row(trial, number, attempt, shown.onset_ns, shown.end_ns, 0, 0, status), ())

    def _row(
        self, trial: Trial, number: int, attempt: int, onset_ns: int, offset_ns: int, refreshes: int, missed: int,
        status: Status,
    ) -> TrialRow:  # fmt: skip
        return planned_row(trial, number, attempt, onset_ns, offset_ns, refreshes, missed, status, self.respondent.kind)


def planned_row(
    trial: Trial, number: int, attempt: int, onset_ns: int, offset_ns: int, refreshes: int, missed: int,
    status: str, observer_kind: str,
) -> TrialRow:  # fmt: skip
    """A row of ``trials`` from the plan and what was shown."""
    data: dict[str, Any] = trial.as_dict()
    return TrialRow(
        trial=number, planned=trial.index, attempt=attempt, block=trial.block, kind=trial.kind, scene=trial.scene,
        practice=trial.practice, catch=trial.catch, correct=trial.correct, panels=json.dumps(data["panels"]),
        factors=json.dumps(data["factors"], sort_keys=True), onset_ns=onset_ns, offset_ns=offset_ns,
        refreshes=refreshes, missed=missed, replays=0, status=status, observer_kind=observer_kind,
    )  # fmt: skip


def _response(trial: Trial, question: Question, answer: Answer, number: int, onset_ns: int, device: str) -> ResponseRow:
    """An answer as a row; times from the stimulus onset."""
    press: Press | None = answer.press
    chosen = None
    if question.kind == "choice" and answer.answer is not None:
        chosen = next((panel.condition for panel in trial.panels if panel.slot == answer.answer), None)
    rating = float(answer.answer) if question.kind == "likert" and answer.answer is not None else None
    return ResponseRow(
        trial=number,
        question=question.name,
        kind=question.kind,
        answer=answer.answer,
        rating=rating,
        chosen=chosen,
        rt_ns=None if press is None else press.mapped_ns - onset_ns,
        press_ns=None if press is None else press.mapped_ns,
        device=device if press is None else press.device,
        device_stamp=None if press is None else press.device_stamp,
        raw=None if press is None else press.raw or None,
        timed_out=answer.timed_out,
    )
