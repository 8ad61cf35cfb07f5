"""Trial tables of simulated studies, made directly from a protocol: no session files, no display, no clips."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from analysis.sessions import TRIAL_COLUMNS, trial_row
from protocols.design import group_of, plan
from protocols.observer import answer, draw_observer, trial_stream
from protocols.study import Study
from protocols.trial import Trial


@dataclass(frozen=True)
class Slot:
    """What does not change between simulations of one participant's slot: header, trials, their stored form."""

    participant: int
    header: Mapping[str, Any]
    trials: tuple[Trial, ...]
    stored: tuple[Mapping[str, Any], ...]


def slot(study: Study, participant: int) -> Slot:
    """The slot of a participant: plan and what a session file would hold of it (all refreshes shown, none missed)."""
    trials = plan(study, participant)
    header = {
        "participant": str(participant),
        "run": 1,
        "group": group_of(study, participant),
        "observer_kind": "simulated",
        "study": study.study,
    }
    asked = tuple(trial for trial in trials if trial.panels)
    return Slot(participant, header, asked, tuple(_stored(trial) for trial in asked))


def _stored(trial: Trial) -> Mapping[str, Any]:
    whole = trial.as_dict()
    return {
        "trial": trial.index,
        "planned": trial.index,
        "attempt": 0,
        "block": trial.block,
        "kind": trial.kind,
        "scene": trial.scene,
        "practice": trial.practice,
        "catch": trial.catch,
        "correct": trial.correct,
        "panels": json.dumps(whole["panels"]),
        "factors": json.dumps(dict(trial.factors)),
        "onset_ns": 0,
        "offset_ns": round(trial.duration_s * 1e9),
        "refreshes": 1,
        "missed": 0,
        "status": "ok",
    }


def simulated_table(study: Study, slots: Sequence[Slot], seed: int) -> pd.DataFrame:
    """One simulated study: the table that `load_sessions` would give, before exclusions. Equal seeds, equal tables."""
    rows = []
    for one in slots:
        observer = draw_observer(study, one.participant, seed)
        for trial, stored in zip(one.trials, one.stored, strict=True):
            given = answer(trial, observer, trial_stream(seed, one.participant, trial))
            answers = [
                {
                    "kind": each.kind,
                    "question": each.question,
                    "answer": None if each.timed_out else each.answer,
                    "rating": each.rating,
                    "chosen": each.chosen,
                    "rt_ns": round(each.rt_s * 1e9),
                    "timed_out": each.timed_out,
                }
                for each in given
            ]
            rows.append(trial_row(one.header, stored, answers))
    table = pd.DataFrame(rows)
    for column in TRIAL_COLUMNS:
        if column not in table:
            table[column] = "simulated" if column == "session" else None
    return table[[*TRIAL_COLUMNS, *[column for column in table.columns if column not in TRIAL_COLUMNS]]]
