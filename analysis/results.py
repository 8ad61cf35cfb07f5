"""What every result table has in common: a status a row, a note where it is not ok, and how it was made in ``attrs``.

Statuses: ``ok``; ``zero_error_variance`` (the error term is zero: the statistic is infinite); ``undefined`` (0 / 0, or
nothing to compare); ``separated`` (no finite maximum likelihood); ``disconnected`` (items never compared, even through
others); ``not_converged``; ``boundary`` (an estimate on the edge of its range); ``too_few_subjects``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stimuli.errors import InputError, problem

OK = "ok"
ZERO_ERROR_VARIANCE = "zero_error_variance"
UNDEFINED = "undefined"
SEPARATED = "separated"
DISCONNECTED = "disconnected"
NOT_CONVERGED = "not_converged"
BOUNDARY = "boundary"
TOO_FEW_SUBJECTS = "too_few_subjects"
STATUSES = (
    OK,
    ZERO_ERROR_VARIANCE,
    UNDEFINED,
    SEPARATED,
    DISCONNECTED,
    NOT_CONVERGED,
    BOUNDARY,
    TOO_FEW_SUBJECTS,
)

# A sum of squares of N values is zero if it is not above (ROUNDING * max|y|)^2 N: what rounding of the data leaves.
ROUNDING = 64 * float(np.finfo(float).eps)


def result_table(
    rows: Iterable[Mapping[str, Any]],
    columns: Sequence[str],
    *,
    method: str,
    n_subjects: int,
    dropped: Mapping[Any, str] | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> pd.DataFrame:
    """The rows as a table with ``status`` and ``note`` last; ``method``, ``n_subjects``, ``dropped`` in its attrs.

    A row that holds a nan but says ``ok`` is a mistake of the caller's: it becomes ``undefined``, and its note names
    the columns.
    """
    found = []
    # Nothing to compare or describe is said in a row of its own.
    rows = list(rows) or [
        {**dict.fromkeys(columns, math.nan), "status": UNDEFINED, "note": "there is nothing to compare"}
    ]
    for row in rows:
        made = {"status": OK, "note": "", **row}
        if made["status"] == OK:
            empty = [c for c in columns if isinstance(made[c], float | np.floating) and np.isnan(made[c])]
            if empty:
                made |= {"status": UNDEFINED, "note": f"not defined for these data: {', '.join(empty)}"}
        found.append(made)
    table = pd.DataFrame(found, columns=[*columns, "status", "note"])
    table.attrs.update({"method": method, "n_subjects": int(n_subjects), "dropped": dict(dropped or {})})
    table.attrs.update(attrs or {})
    return table


def require_columns(where: str, table: pd.DataFrame, names: Iterable[Any]) -> None:
    """Raise an InputError (a ValueError) that names every column of ``names`` that ``table`` lacks."""
    if not isinstance(table, pd.DataFrame):
        raise InputError(problem(where, "table", type(table).__name__, "a pandas DataFrame in long form"))
    have = ", ".join(map(str, table.columns))
    lacking = [problem(where, "column", repr(name), f"one of {have}") for name in names if name not in table.columns]
    if lacking:
        raise InputError(*lacking)


def one_of(where: str, what: str, got: Any, choices: Sequence[Any]) -> Any:
    """``got`` if it is among ``choices``; an InputError otherwise."""
    if got not in choices:
        raise InputError(problem(where, what, repr(got), "one of " + ", ".join(map(repr, choices))))
    return got


def names_of(value: str | Sequence[str] | None) -> list[str]:
    """A column name, a sequence of them or None, as a list."""
    if value is None:
        return []
    return [value] if isinstance(value, str) else list(value)


def numbers(where: str, table: pd.DataFrame, column: str) -> np.ndarray:
    """The column as float64; what is missing or infinite becomes nan. InputError if it does not hold numbers."""
    series = table[column]
    if isinstance(series.dtype, pd.CategoricalDtype):
        series = series.astype(object)
    try:
        values = pd.to_numeric(series).to_numpy(dtype=float, na_value=np.nan)
    except (ValueError, TypeError) as error:
        raise InputError(problem(where, f"column {column!r}", str(error), "numbers")) from None
    return np.where(np.isfinite(values), values, np.nan)


def coded(table: pd.DataFrame, column: str) -> tuple[np.ndarray, list[Any]]:
    """Codes (-1: missing) and the levels that occur, in categorical order or sorted."""
    series = table[column]
    if isinstance(series.dtype, pd.CategoricalDtype):
        series = series.cat.remove_unused_categories()
        return series.cat.codes.to_numpy(dtype=np.int64), list(series.cat.categories)
    codes, levels = pd.factorize(series.to_numpy(dtype=object) if series.dtype == object else series)
    found = [level.item() if isinstance(level, np.generic) else level for level in levels]
    try:
        order = sorted(range(len(found)), key=lambda i: found[i])
    except TypeError:
        order = sorted(range(len(found)), key=lambda i: (type(found[i]).__name__, str(found[i])))
    place = np.empty(len(found) + 1, dtype=np.int64)
    place[order] = np.arange(len(found))
    place[-1] = -1
    return place[codes], [found[i] for i in order]
