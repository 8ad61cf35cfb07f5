"""Sensitivity from detection and forced-choice counts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from scipy import optimize, special

from analysis.results import BOUNDARY, OK, UNDEFINED, result_table
from stimuli.errors import InputError, problem

COLUMNS = ["dprime", "se", "criterion", "ci_low", "ci_high"]


def _density(z: float) -> float:
    return math.exp(-z * z / 2) / math.sqrt(2 * math.pi)


def proportion_correct(d: float, m: int) -> float:
    """Share correct of an unbiased observer choosing one of ``m``: E[Phi(Z + d)^(m - 1)] (Green & Swets 1966;
    tables of it: Hacker & Ratcliff 1979, Percept. Psychophys. 26, 168)."""
    if m == 2:
        return float(special.ndtr(d / math.sqrt(2)))
    z = np.linspace(-9.0, 9.0, 2001)
    values = np.exp(-z * z / 2 + (m - 1) * special.log_ndtr(z + d)) / math.sqrt(2 * math.pi)
    return float(np.trapezoid(values, z))


def _choice_row(k: float, n: float, m: int) -> dict[str, Any]:
    if n == 0:
        return {**dict.fromkeys(COLUMNS, math.nan), "status": UNDEFINED, "note": "no answers"}
    share = k / n
    if share in (0.0, 1.0):
        d = math.inf if share == 1 else -math.inf
        note = f"{'all' if share else 'no'} answers are correct: d' is not finite (correction='loglinear' bounds it)"
        return {"dprime": d, "se": math.inf, "criterion": 0.0, "ci_low": -math.inf, "ci_high": math.inf,
                "status": BOUNDARY, "note": note}  # fmt: skip
    if m == 2:
        d = math.sqrt(2) * float(special.ndtri(share))
        slope = _density(d / math.sqrt(2)) / math.sqrt(2)
    else:
        d = float(optimize.brentq(lambda x: proportion_correct(x, m) - share, -30.0, 30.0, xtol=1e-13))
        slope = (proportion_correct(d + 1e-4, m) - proportion_correct(d - 1e-4, m)) / 2e-4
    se = math.sqrt(share * (1 - share) / n) / slope
    return _with_interval({"dprime": d, "se": se, "criterion": 0.0, "status": OK, "note": ""})


def _with_interval(row: dict[str, Any]) -> dict[str, Any]:
    half = float(special.ndtri(0.975)) * row["se"]
    return row | {"ci_low": row["dprime"] - half, "ci_high": row["dprime"] + half}


def _detection_row(hits: float, misses: float, alarms: float, rejections: float, added: float) -> dict[str, Any]:
    hits, misses, alarms, rejections = (v + added for v in (hits, misses, alarms, rejections))
    signal, noise = hits + misses, alarms + rejections
    if signal == 0 or noise == 0:
        lacking = "signal" if signal == 0 else "noise"
        return {**dict.fromkeys(COLUMNS, math.nan), "status": UNDEFINED, "note": f"no {lacking} trials"}
    h, f = hits / signal, alarms / noise
    zh, zf = float(special.ndtri(h)), float(special.ndtri(f))
    d = zh - zf
    if not (0 < h < 1 and 0 < f < 1):
        criterion = -(zh + zf) / 2
        note = "a hit or false alarm rate is 0 or 1: no finite d' (correction='loglinear' bounds it)"
        row: dict[str, Any] = {
            "dprime": d,
            "se": math.inf,
            "criterion": criterion,
            "ci_low": -math.inf,
            "ci_high": math.inf,
        }
        return row | {"status": UNDEFINED if math.isnan(d) else BOUNDARY, "note": note}
    # Gourevitch & Galanter (1967).
    variance = h * (1 - h) / (signal * _density(zh) ** 2) + f * (1 - f) / (noise * _density(zf) ** 2)
    row = {"dprime": d, "se": math.sqrt(variance), "criterion": -(zh + zf) / 2, "status": OK, "note": ""}
    return _with_interval(row)


def dprime(
    hits: Any = None,
    misses: Any = None,
    false_alarms: Any = None,
    correct_rejections: Any = None,
    *,
    k: Any = None,
    n: Any = None,
    m: int = 2,
    correction: str = "none",
) -> pd.DataFrame:
    """d' of detection counts, ``(hits, misses, false_alarms, correct_rejections)``, or of ``(k, n, m=2)``: k of n
    choices among m right. Counts or arrays of them; a row each.

    ``se``: Gourevitch & Galanter (1967) for detection, the delta method for choice; ``criterion`` c = -(z(H) + z(F))
    / 2, 0 for choice, where an unbiased observer is assumed. ``correction``: 'none' (rates of 0 or 1 give infinite
    d', status ``boundary``) or 'loglinear' (Hautus 1995: 0.5 added to every count). Raises InputError for negative
    counts, k > n.
    """
    if correction not in ("none", "loglinear"):
        raise InputError(problem("dprime", "correction", repr(correction), "'none' or 'loglinear'"))
    if false_alarms is not None and correct_rejections is None:
        # (k, n, m) in a row: the third is the number of alternatives.
        m, false_alarms = false_alarms, None
    added = 0.5 if correction == "loglinear" else 0.0
    if false_alarms is None and correct_rejections is None:
        given: tuple[Any, ...] = (hits if k is None else k, misses if n is None else n)
    else:
        given = (hits, misses, false_alarms, correct_rejections)
    if any(v is None for v in given):
        wanted = "hits, misses, false_alarms, correct_rejections, or k, n"
        raise InputError(problem("dprime", "counts", "some of them", wanted))
    arrays = np.broadcast_arrays(*[np.atleast_1d(np.asarray(v, dtype=float)) for v in given])
    if not all((a >= 0).all() for a in arrays):
        raise InputError(problem("dprime", "counts", "negative or missing values", "counts"))
    if len(given) == 2:
        if int(m) != m or m < 2:
            raise InputError(problem("dprime", "m", m, "a whole number of alternatives, 2 or more"))
        if (arrays[0] > arrays[1]).any():
            raise InputError(problem("dprime", "k", "more correct than answers", "k <= n"))
        pairs = zip(*(a.ravel().tolist() for a in arrays), strict=True)
        rows = [_choice_row(one + added, total + 2 * added, int(m)) for one, total in pairs]
        method = f"d' of {m}-alternative forced choice, unbiased observer assumed (criterion 0)."
    else:
        rows = [
            _detection_row(h, miss, f, r, added)
            for h, miss, f, r in zip(*(a.ravel().tolist() for a in arrays), strict=True)
        ]
        method = "d' = z(H) - z(F), equal-variance normal model."
    return result_table(rows, COLUMNS, method=method + ("" if added == 0 else " Log-linear correction."), n_subjects=0)
