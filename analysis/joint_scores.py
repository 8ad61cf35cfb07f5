"""Type III tests of the terms of a threshold model, whose unit is the participant.

Coefficients of a factor of several levels are tested together, and averaged over the levels of the other factors: the
columns are taken to deviation coding (`type_three`), where the term's coefficients are 0 together, and the score test
of `participant_score` is made of all of them. With n participants and q coefficients it needs n > q, and is weak where
n is not well above q: as Hotelling's test is beside the repeated-measures F, it does not assume that participants
differ alike in all of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from analysis.coefficient_tests import ThresholdModel
from analysis.formula import ModelFrame, independent_columns
from analysis.log_tails import log10_f, p_f
from analysis.participant_score import ParticipantScore
from analysis.threshold_model import ThresholdFit
from analysis.type_three import deviation_frame


def joint_tests(frame: ModelFrame, model: ThresholdModel, fit: ThresholdFit, labels: list[str]) -> list[dict[str, Any]]:
    """[{term, df1, df2, F, p, log10_p}] of the formula's terms; without a term for which participants are too few, and
    empty where cells are missing or every term is one coefficient already. ``labels``: the fit's parameters, thresholds
    first."""
    ours = [label for label in labels[model.thresholds :] if label != "(Intercept)"]
    coded = deviation_frame(frame)
    theirs = [label for label in coded.terms if label != "(Intercept)"]
    of_theirs = [coded.terms.index(label) for label in theirs]
    constant = np.ones((len(coded.x), 1))
    whole = np.hstack([constant, coded.x[:, of_theirs]])
    single = len(set(coded.sources.values()) - {"1"}) == len(theirs) and not any(":" in term for term in ours)
    if single or len(ours) != len(theirs) or len(independent_columns(whole)) < whole.shape[1]:
        return []
    x = frame.x[:, [frame.terms.index(label) for label in ours]]
    # x = 1 shift + coded change: thresholds (or the intercept) take up the shift.
    solved = np.linalg.lstsq(whole, x)[0]
    forth = np.eye(len(labels))
    first = len(labels) - len(ours)
    forth[first:, first:] = solved[1:]
    sign = -1.0 if model.thresholds else 1.0
    forth[:first, first:] = sign * solved[0]
    back = np.linalg.inv(forth)
    bounds = replace(model.bounds, upper=model.bounds.upper @ back, lower=model.bounds.lower @ back)
    moved = replace(fit, phi=forth @ fit.phi, covariance=forth @ fit.covariance @ forth.T)
    scores = ParticipantScore(bounds, model.random[0].codes, moved, model.link, model.nodes, model.thresholds)
    places: dict[str, list[int]] = {}
    for j, label in enumerate(theirs):
        places.setdefault(coded.sources[label], []).append(first + j)
    tests = []
    for term, index in places.items():
        found = scores.joint(index)
        if found is not None:
            f, df1, df2 = found
            tests.append({"term": term, "df1": df1, "df2": df2, "F": f, "p": p_f(f, df1, df2),
                          "log10_p": log10_f(f, df1, df2)})  # fmt: skip
    return tests
