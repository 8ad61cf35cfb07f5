"""Many simulated observers straight to one long table, without session files: for power and calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from protocols.design import plan
from protocols.observer import Observer, answer, draw_observer, trial_stream
from protocols.study import Study
from protocols.trial import Trial


def simulated_rows(
    study: Study,
    participants: int,
    seed: int,
    plans: Mapping[int, Sequence[Trial]] | None = None,
) -> list[dict[str, Any]]:
    """One row a trial with pictures, for slots 1..``participants``; a list that ``pandas.DataFrame`` takes.

    Columns as in `analysis.load_sessions`: participant, observer_kind, trial, block, kind, scene, practice, catch,
    correct, technique, condition, side, response, winner, loser, rating, rt_s, timed_out, missed, excluded, reason,
    the factors, and for each question Q ``response_Q``, ``rating_Q``, ``rt_s_Q``. Practice and catch trials are marked
    excluded. ``plans``: slot -> trials, where the same plans serve many seeds.
    """
    rows: list[dict[str, Any]] = []
    for participant in range(1, participants + 1):
        observer = draw_observer(study, participant, seed)
        trials = plans[participant] if plans is not None else plan(study, participant)
        rows += [_row(trial, observer, participant, seed) for trial in trials if trial.panels]
    return rows


def _row(trial: Trial, observer: Observer, participant: int, seed: int) -> dict[str, Any]:
    shown = [panel for panel in trial.panels if panel.role != "reference"]
    reason = "practice" if trial.practice else "catch trial" if trial.catch else ""
    row: dict[str, Any] = {
        "participant": f"p{participant:03d}",
        "observer_kind": "simulated",
        "trial": trial.index,
        "block": trial.block,
        "kind": trial.kind,
        "scene": trial.scene,
        "practice": trial.practice,
        "catch": trial.catch,
        "correct": trial.correct,
        "technique": "|".join(sorted(panel.technique for panel in shown)),
        "condition": "|".join(sorted(panel.condition for panel in shown)),
        "side": None,
        "response": None,
        "winner": None,
        "loser": None,
        "rating": float("nan"),
        "rt_s": float("nan"),
        "timed_out": False,
        "missed": 0,
        "excluded": bool(reason),
        "reason": reason,
        **trial.factors,
    }
    given = answer(trial, observer, trial_stream(seed, participant, trial))
    for one in sorted(given, key=lambda one: one.kind != "choice"):
        row[f"response_{one.question}"], row[f"rt_s_{one.question}"] = one.chosen or one.answer, one.rt_s
        if row["response"] is None:
            row["response"], row["rt_s"] = one.chosen or one.answer, one.rt_s
            row["side"] = one.answer if one.kind == "choice" else None
        if one.kind == "likert":
            rating = float("nan") if one.rating is None else one.rating
            row[f"rating_{one.question}"] = rating
            row["rating"] = rating if row["rating"] != row["rating"] else row["rating"]
        if one.chosen is not None and len(shown) == 2:
            row["winner"] = one.chosen
            row["loser"] = next((p.condition for p in shown if p.slot != one.answer), None)
        row["timed_out"] = row["timed_out"] or one.timed_out
    return row
