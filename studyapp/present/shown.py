"""What a presenter hands back: a trial as it was shown, an answer as it was given, rows that were kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from protocols.records import FLIP_DTYPE
from protocols.trial import Question
from studyapp.present.frame_loop import PhaseShown
from studyapp.seams import Press


@dataclass(frozen=True)
class TrialShown:
    """What was shown of one trial. ``onset_ns``: stamp of the first stimulus refresh; ``onsets_ns``: of each interval
    of a two-interval trial; ``offset_ns``: of the blank after it; ``refreshes``: of the raster during the stimulus;
    ``missed``, ``early``, ``late``, ``slips``: during the stimulus; ``press``: the answer that ended it, if one did;
    ``presses``: all, accepted or not; ``replays``: whole repetitions after the first showing."""

    onset_ns: int
    offset_ns: int
    refreshes: int
    missed: int
    presses: tuple[Press, ...] = ()
    replays: int = 0
    press: Press | None = None
    onsets_ns: tuple[int, ...] = ()
    early: int = 0
    late: int = 0
    slips: int = 0
    first_refresh: int = 0
    aborted: bool = False
    device_lost: bool = False
    oldest_gaze_ns: int = -1

    def timing_ok(self, max_missed: int = 0) -> bool:
        """False where the trial is to be flagged and shown again: too many refreshes lost, an early swap or a slip."""
        return self.missed <= max_missed and not self.early and not self.slips


@dataclass(frozen=True)
class Answer:
    """What came of a question or a screen of words. ``answer``: the meaning of the key (None: timed out, aborted or
    device lost); times on the session clock."""

    answer: str | None
    press: Press | None
    onset_ns: int
    end_ns: int
    timed_out: bool = False
    aborted: bool = False
    device_lost: bool = False
    replays: int = 0
    presses: tuple[Press, ...] = ()


class KeptFlips:
    """A FlipSink that keeps every row in memory: tests, benches, demos."""

    def __init__(self) -> None:
        self._blocks: list[np.ndarray] = []

    def put(self, row: np.ndarray) -> None:
        """Keep a copy of (N,) rows."""
        self._blocks.append(row.copy())

    def rows(self) -> np.ndarray:
        """All rows so far, (N,) FLIP_DTYPE."""
        return np.concatenate(self._blocks) if self._blocks else np.zeros(0, FLIP_DTYPE)


def key_meanings(question: Question) -> dict[str, str] | None:
    """Key -> answer; None: any key."""
    if question.keys:
        return dict(question.keys)
    if question.kind == "likert":
        return {str(value): str(value) for value in range(question.low, question.high + 1)}
    return {option: option for option in question.options} or None


def answer_of(shown: PhaseShown, keys: Mapping[str, str] | None, replays: int, presses: Sequence[Press]) -> Answer:
    """The phase of a question as an answer; ``keys`` as `key_meanings`."""
    press = None if shown.aborted else shown.press
    meaning = None if press is None else press.key if keys is None else keys[press.key]
    timed_out = shown.press is None and not shown.device_lost
    return Answer(
        meaning,
        press,
        shown.onset_ns,
        shown.end_ns,
        timed_out,
        shown.aborted,
        shown.device_lost,
        replays,
        tuple(presses),
    )


def trial_of(done: Sequence[PhaseShown], blank: PhaseShown, loop: int | None) -> TrialShown:
    """Phases of a stimulus as one record."""
    first, last = done[0], done[-1]
    return TrialShown(
        onset_ns=first.onset_ns,
        offset_ns=blank.onset_ns,
        refreshes=sum(phase.span for phase in done),
        missed=sum(phase.missed for phase in done),
        presses=tuple(press for phase in [*done, blank] for press in phase.presses),
        replays=0 if loop is None else max(0, last.span - 1) // loop,
        press=last.press,
        onsets_ns=tuple(phase.onset_ns for phase in done),
        early=sum(phase.early for phase in done),
        late=sum(phase.late for phase in done),
        slips=sum(phase.slips for phase in done),
        first_refresh=first.first_refresh,
        aborted=any(phase.aborted for phase in done),
        device_lost=any(phase.device_lost for phase in done),
        oldest_gaze_ns=max(phase.oldest_gaze_ns for phase in done),
    )
