"""Yes/no answers of the same participants under two conditions (McNemar) or several (Cochran)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from analysis.cells import cell_means
from analysis.log_tails import log10_binomial, log10_chi2, p_chi2
from analysis.results import OK, TOO_FEW_SUBJECTS, UNDEFINED, result_table
from stimuli.errors import InputError, problem

COLUMNS = ["statistic", "df", "p", "log10_p"]


def mcnemar(b: Any, c: Any, exact: bool = True, correction: bool = False) -> pd.DataFrame:
    """McNemar's test of the discordant counts: ``b`` yes-then-no and ``c`` no-then-yes, one answer a participant.

    ``exact``: two-sided binomial test, ``statistic`` the smaller count. Otherwise chi-square (b - c)^2 / (b + c), or
    with Yates's ``correction`` (|b - c| - 1)^2 / (b + c). Arrays give a row each. No discordant answers: ``undefined``.
    Raises InputError for counts that are negative or not whole.
    """
    rows = []
    bs, cs = np.broadcast_arrays(np.atleast_1d(b), np.atleast_1d(c))
    for name, values in (("b", bs), ("c", cs)):
        if not all(float(v).is_integer() and v >= 0 for v in values.ravel()):
            raise InputError(problem("mcnemar", name, values.tolist(), "whole numbers that are not negative"))
    for one, other in zip(bs.ravel().astype(int).tolist(), cs.ravel().astype(int).tolist(), strict=True):
        total = one + other
        row: dict[str, Any] = {"df": 1, "b": one, "c": other}
        if total == 0:
            row |= {"statistic": math.nan, "p": math.nan, "log10_p": math.nan}
            row |= {"status": UNDEFINED, "note": "no participant changed the answer"}
        elif exact:
            p = float(stats.binomtest(one, total, 0.5).pvalue)
            log10_p = math.log10(p) if p > 1e-280 else log10_binomial(one, total, 0.5)
            row |= {"statistic": float(min(one, other)), "p": min(p, 1.0), "log10_p": min(0.0, log10_p), "status": OK}
        else:
            away = max(abs(one - other) - 1, 0) if correction else abs(one - other)
            chi2 = away**2 / total
            row |= {"statistic": chi2, "p": p_chi2(chi2, 1), "log10_p": log10_chi2(chi2, 1), "status": OK}
        rows.append(row)
    how = "exact binomial" if exact else "chi-square" + (", continuity-corrected" if correction else "")
    return result_table(
        rows, [*COLUMNS, "b", "c"], method=f"McNemar's test, {how}.", n_subjects=int(bs.sum() + cs.sum())
    )


def cochran_q(table: pd.DataFrame, dv: str, within: str, subject: str) -> pd.DataFrame:
    """Cochran's Q of true/false answers of the same participants over the levels of ``within``; one row.

    One answer a participant and level (0 / 1 or boolean); participants without every level are left out by name. Where
    nobody's answers differ, ``undefined``. Raises InputError for unknown columns and repeated or other answers.
    """
    cells = cell_means("cochran_q", table, dv, [within], subject, [])
    values = np.round(cells.values * cells.scale + cells.offset, 9)
    if not np.isin(values, (0.0, 1.0)).all():
        got = "repetitions" if cells.repetitions > 1 else "other values"
        raise InputError(problem("cochran_q", f"column {dv!r}", got, "one true or false (1 or 0) a cell"))
    n, k = values.shape
    row: dict[str, Any] = dict.fromkeys(COLUMNS, math.nan) | {"df": k - 1}
    by_level, by_subject = values.sum(axis=0), values.sum(axis=1)
    if k < 2:
        row |= {"status": UNDEFINED, "note": f"{within!r} has {k} level"}
    elif n < 2:
        row |= {"status": TOO_FEW_SUBJECTS, "note": f"{n} complete participants, at least 2 are needed"}
    elif (below := float(k * by_subject.sum() - np.sum(by_subject**2))) == 0:
        row |= {"status": UNDEFINED, "note": "no participant's answers differ between levels"}
    else:
        q = (k - 1) * float(k * np.sum(by_level**2) - by_level.sum() ** 2) / below
        row |= {"statistic": q, "p": p_chi2(q, k - 1), "log10_p": log10_chi2(q, k - 1), "status": OK}
    method = f"Cochran's Q test, {n} participants by {k} levels of {within}."
    return result_table([row], COLUMNS, method=method, n_subjects=n, dropped=cells.dropped)
