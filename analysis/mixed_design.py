"""The design of a linear model through QR, after centring and scaling: coefficients keep the digits of the data."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from analysis.formula import ModelFrame, independent_columns


@dataclass(frozen=True)
class Design:
    """Independent columns of the model through QR: x = (q r) after centring and scaling; ``back`` maps to terms."""

    q: np.ndarray
    back: np.ndarray
    labels: list[str]
    aliased: list[str]
    intercept: int | None


def orthonormal_design(frame: ModelFrame) -> Design:
    """Centre (where there is an intercept) and scale the columns, then QR; drop what is linearly dependent."""
    x = frame.x
    intercept = frame.terms.index("(Intercept)") if "(Intercept)" in frame.terms else None
    shift, scale = np.zeros(x.shape[1]), np.ones(x.shape[1])
    work = x.copy()
    for j in range(x.shape[1]):
        if j == intercept or not len(x):
            continue
        if intercept is not None:
            first = x[0, j]
            shift[j] = first + math.fsum(x[:, j] - first) / len(x)
            work[:, j] = x[:, j] - shift[j]
        scale[j] = float(np.linalg.norm(work[:, j])) or 1.0
        work[:, j] /= scale[j]
    kept = independent_columns(work)
    labels = [frame.terms[j] for j in kept]
    aliased = [t for j, t in enumerate(frame.terms) if j not in set(kept.tolist())]
    q, r = np.linalg.qr(work[:, kept])
    back = linalg.solve_triangular(r, np.eye(len(kept))) / scale[kept][:, None]
    place = labels.index("(Intercept)") if "(Intercept)" in labels else None
    if place is not None:
        # Undo the centring: the intercept carries the shifts of all other columns.
        others = [i for i in range(len(kept)) if i != place]
        back[place] -= shift[kept][others] @ back[others]
    return Design(q, back, labels, aliased, place)


def in_unit(design: Design, gamma: np.ndarray, scale: float, offset: float) -> np.ndarray:
    """Coefficients of the terms in the data's unit."""
    beta = np.asarray(design.back @ gamma) * scale
    if design.intercept is not None:
        beta[design.intercept] += offset
    return beta
