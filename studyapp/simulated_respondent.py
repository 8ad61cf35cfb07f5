"""A simulated observer in a real session: what `protocols.observer` says, pressed and looked at the right moment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from protocols.observer import Answer, Observer, answer, draw_observer, stream, trial_stream
from protocols.study import Study
from protocols.trial import Question, Trial

READING_S = 0.3  # how long a simulated observer reads a screen of words
_SLOT_AZIMUTH_DVA = {"left": -8.0, "right": 8.0}


class SimulatedRespondent:
    """Answers as `draw_observer(study, participant, seed)` does. ``press(key, at_ns)`` moves the finger; ``look(x_dva,
    y_dva)`` moves the eyes. A pure function of study, participant and seed, whatever happened before a trial.
    ``errors(trial)``: slot -> the metric of what was shown, asked for when the first question is."""

    kind: Literal["person", "simulated"] = "simulated"

    def __init__(
        self,
        study: Study,
        participant: int,
        seed: int,
        press: Callable[[str, int], None],
        look: Callable[[float, float], None] | None = None,
        errors: Callable[[Trial], Mapping[str, float]] | None = None,
    ) -> None:
        self.name = "simulated observer"
        self._observer: Observer = draw_observer(study, participant, seed)
        self._seed, self._press, self._look = seed, press, look
        self._errors = errors
        self._answers: dict[str, Answer] = {}
        self._attempt = 0

    def begins(self, trial: Trial, attempt: int) -> None:
        self._attempt, self._answers = attempt, {}
        if self._errors is None:
            self._decide(trial, None)
        if self._look is not None:
            self._look(0.0, 0.0)

    def _decide(self, trial: Trial, errors: Mapping[str, float] | None) -> None:
        rng = trial_stream(self._seed, self._observer.participant, trial, self._attempt)
        self._answers = {given.question: given for given in answer(trial, self._observer, rng, errors)}

    def sees(self, trial: Trial, onset_ns: int) -> None:
        if not trial.panels:
            self._press("space", onset_ns + int(READING_S * 1e9))
        elif self._look is not None and trial.fixation == "free":
            panels: np.ndarray = np.array([_SLOT_AZIMUTH_DVA.get(panel.slot, 0.0) for panel in trial.panels])
            rng = stream(self._seed, "looks", self._observer.participant, trial.index)
            self._look(float(rng.choice(panels)), float(rng.normal(0.0, 1.0)))

    def asked(self, trial: Trial, question: Question, onset_ns: int, during: bool) -> None:
        if not self._answers and self._errors is not None:
            self._decide(trial, self._errors(trial))
        given = self._answers[question.name]
        if not given.timed_out:
            self._press(given.key or given.answer, onset_ns + round(given.latency_s * 1e9))
