"""Does a reported test agree with itself?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal
from typing import Any

import pandas as pd

from analysis.log_tails import p_chi2, p_f, p_t, p_z
from analysis.results import OK, one_of, result_table
from stimuli.errors import InputError, problem

COLUMNS = ["kind", "statistic", "df1", "df2", "p_reported", "p_computed", "p_lowest", "p_highest", "consistent"]


def _half_unit(text: str) -> float:
    exponent = Decimal(text).as_tuple().exponent
    return 0.5 * 10.0 ** int(exponent) if isinstance(exponent, int) else 0.0


def check_reported(statistic: Any, df: Any, p: Any, kind: str = "F") -> pd.DataFrame:
    """Recompute p from a published ``statistic`` and ``df`` and say whether the published ``p`` is its rounding.

    ``kind``: F (df = (df1, df2)), t, chi2, or z (df None). Numbers may be text ('3.46', '.03', '<.001'), whose last
    digit says how they were rounded; numbers are taken as their shortest text. ``p_lowest``, ``p_highest``: what the
    rounding of the statistic allows. Raises InputError for other kinds or degrees of freedom.
    """
    one_of("check_reported", "kind", kind, ("F", "t", "chi2", "z"))
    dfs = [] if df is None else [float(v) for v in (df if isinstance(df, Sequence | tuple) else [df])]
    wanted = {"F": 2, "t": 1, "chi2": 1, "z": 0}[kind]
    if kind != "z" and len(dfs) != wanted:
        raise InputError(problem("check_reported", "df", df, f"{wanted} degrees of freedom for {kind}"))
    text, p_text = str(statistic).strip(), str(p).strip()
    relation, p_text = (p_text[0], p_text[1:].strip()) if p_text[:1] in "<>=" else ("=", p_text)
    value, reported = float(text), float(p_text)

    def computed(x: float) -> float:
        if kind == "F":
            return p_f(max(x, 0.0), dfs[0], dfs[1])
        return p_t(x, dfs[0]) if kind == "t" else p_chi2(max(x, 0.0), dfs[0]) if kind == "chi2" else p_z(x)

    half = _half_unit(text)
    size = abs(value)
    lowest, highest = computed(size + half), computed(max(size - half, 0.0))
    around = _half_unit(p_text) * (1 + 1e-9)
    if relation == "<":
        consistent = lowest < reported
    elif relation == ">":
        consistent = highest > reported
    else:
        consistent = lowest <= reported + around and highest >= reported - around
    row = {
        "kind": kind,
        "statistic": value,
        "df1": dfs[0] if dfs else math.inf,
        "df2": dfs[1] if len(dfs) > 1 else math.inf,
        "p_reported": reported,
        "p_computed": computed(size),
        "p_lowest": lowest,
        "p_highest": highest,
        "consistent": bool(consistent),
        "status": OK,
        "note": "" if consistent else "p does not follow from the statistic",
    }
    return result_table([row], COLUMNS, method="p recomputed from the reported statistic and df.", n_subjects=0)
