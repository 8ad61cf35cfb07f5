"""A model formula on a table: the response, the design with R's term names, and random intercepts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import formulaic
import numpy as np
import pandas as pd
from formulaic.errors import FormulaicError

from analysis.results import coded, require_columns
from stimuli.errors import InputError, problem

_RANDOM = re.compile(r"\(([^()|]*)(\|\|?)([^()|]*)\)")
_LEVEL = re.compile(r"\[(?:T\.)?([^\]]*)\]")


@dataclass(frozen=True)
class RandomTerm:
    """One variance component: ``design[i]`` (1 for an intercept) times the effect of group ``codes[i]``."""

    name: str
    codes: np.ndarray
    levels: list[Any]
    design: np.ndarray


@dataclass(frozen=True)
class ModelFrame:
    """Rows of the table that the model can use. ``x`` (rows, terms), ``terms`` in R's names, ``empty``: factors with
    one level, which have no column. ``sources``: term -> the term of the formula that it belongs to. ``parsed``: the
    formula's terms, ``part`` those rows of the table and ``flags`` its true/false columns (as 0 and 1), to code the
    model's factors in another way (`type_three`). ``references``: factor -> its first level, which its terms are
    differences from."""

    rows: np.ndarray
    response: str
    x: np.ndarray
    terms: list[str]
    empty: list[str]
    sources: dict[str, str]
    random: list[RandomTerm]
    dropped: dict[Any, str]
    parsed: Any
    part: pd.DataFrame
    flags: set[str]
    references: dict[str, str]


def _r_name(column: str, factors: set[str]) -> str:
    """Formulaic's ``temp[T.warm]:x`` as R's ``tempwarm:x``."""
    if column == "Intercept":
        return "(Intercept)"
    parts = []
    for part in column.split(":"):
        bare = part.strip("`")
        if bare in factors:
            # A true/false column is a factor in R.
            parts.append(f"{bare}TRUE")
            continue
        named = _LEVEL.sub(lambda m: {"True": "TRUE", "False": "FALSE"}.get(m.group(1), m.group(1)), part)
        parts.append(named.replace("`", ""))
    return ":".join(parts)


def _random_terms(where: str, table: pd.DataFrame, specs: Sequence[str], rows: np.ndarray) -> list[RandomTerm]:
    """Variance components of '(1|g)', '(1|a/b)', '(1|a:b)', '(0 + x|g)', '(x||g)', or a bare column name."""
    found: list[RandomTerm] = []
    for spec in specs:
        text = spec.strip()
        left, bar, right = "1", "|", text
        if match := _RANDOM.fullmatch(text if text.startswith("(") else f"({text})"):
            left, bar, right = (part.strip() for part in match.groups())
        groups = [g.strip() for g in right.split("/")]
        nested = [":".join(groups[: i + 1]) for i in range(len(groups))]
        terms = [t.strip() for t in left.split("+")]
        slopes = [t for t in terms if t not in ("0", "1", "-1")]
        intercept = "0" not in terms and "-1" not in terms
        if slopes and intercept and bar == "|":
            wanted = "a random intercept (1|g), or independent ones: (x||g), (0 + x|g)"
            raise InputError(problem(where, "random", repr(spec), wanted))
        for group in nested:
            names = [g.strip().strip("`") for g in group.split(":")]
            require_columns(where, table, [*names, *slopes])
            key = np.zeros(int(rows.sum()), dtype=np.int64)
            for name in names:
                codes, levels = coded(table.loc[rows], name)
                key = key * len(levels) + codes
            unique, codes = np.unique(key, return_inverse=True)
            labels: list[Any] = levels if len(names) == 1 else unique.tolist()
            if intercept:
                found.append(RandomTerm(group, codes.ravel(), labels, np.ones(len(key))))
            for slope in slopes:
                values = pd.to_numeric(table.loc[rows, slope]).to_numpy(float)
                found.append(RandomTerm(f"{slope}|{group}", codes.ravel(), labels, values))
    return found


def random_columns(specs: Sequence[str]) -> list[str]:
    """The grouping columns that the random terms name."""
    names: list[str] = []
    for spec in specs:
        text = spec.strip()
        match = _RANDOM.fullmatch(text if text.startswith("(") else f"({text})")
        right = match.group(3) if match else text
        names += [g.strip().strip("`") for g in re.split("[:/]", right)]
    return names


def model_frame(where: str, table: pd.DataFrame, formula: str, random: str | Sequence[str] | None) -> ModelFrame:
    """Evaluate ``formula`` ('y ~ a * b', R style; '(1|g)' in it is taken as ``random``) on ``table``.

    Rows with a missing value in any column of the model are left out and counted. Raises InputError for a formula that
    cannot be read or a column that does not exist.
    """
    require_columns(where, table, [])
    if formula.count("~") != 1:
        raise InputError(problem(where, "formula", repr(formula), "'response ~ terms'"))
    left, right = (side.strip() for side in formula.split("~"))
    specs = [random] if isinstance(random, str) else list(random or [])
    for match in _RANDOM.finditer(right):
        specs.append(match.group(0))
    right = re.sub(r"\+\s*\+", "+", _RANDOM.sub("", right)).strip().strip("+").strip() or "1"
    response = left.strip("`")
    try:
        parsed = formulaic.Formula(right)
        variables = [str(v) for v in parsed.required_variables]
    except FormulaicError as error:
        raise InputError(problem(where, "formula", repr(formula), f"one that can be read ({error})")) from None
    groups = random_columns(specs)
    require_columns(where, table, [response, *variables, *groups])
    rows = table[[*dict.fromkeys([response, *variables, *groups])]].notna().all(axis=1).to_numpy(copy=True)
    for name in [response, *variables]:
        if pd.api.types.is_float_dtype(table[name].dtype):
            rows &= np.isfinite(table[name].to_numpy(float))
    dropped: dict[Any, str] = {}
    if not rows.all():
        dropped["rows"] = f"{int((~rows).sum())} rows with a missing value in the model's columns"
    part = table.loc[rows].reset_index(drop=True)
    flags, empty = set(), []
    for name in variables:
        series = part[name]
        if isinstance(series.dtype, pd.CategoricalDtype):
            part[name] = series.cat.remove_unused_categories()
        if pd.api.types.is_bool_dtype(series.dtype):
            flags.add(name)
            part[name] = series.astype(float)
        elif not pd.api.types.is_numeric_dtype(series.dtype) and series.nunique() < 2:
            empty.append(name)
    if empty or not len(part):
        # A factor with one level has no contrast: the model goes on without it.
        terms = (
            [t for t in parsed if not set(map(str, formulaic.Formula(str(t)).required_variables)) & set(empty)]
            if len(part)
            else []
        )
        names = [str(t) for t in terms if str(t) != "1"]
        right = " + ".join((["1"] if any(str(t) == "1" for t in parsed) else ["0"]) + names)
        parsed = formulaic.Formula(right)
    sources: dict[str, str] = {}
    if len(part):
        try:
            matrix = formulaic.model_matrix(parsed, part, na_action="ignore")
        except FormulaicError as error:
            raise InputError(problem(where, "formula", repr(formula), f"one that can be read ({error})")) from None
        x, names = np.asarray(matrix, dtype=float), [_r_name(str(c), flags) for c in matrix.columns]
        for term, columns in matrix.model_spec.term_indices.items():
            sources |= {names[j]: str(term) for j in columns}
    else:
        x, names = np.ones((0, 1)), ["(Intercept)"]
    index = np.flatnonzero(rows)
    grouping = _random_terms(where, table, specs, rows)
    texts = [name for name in variables if not pd.api.types.is_numeric_dtype(part[name].dtype)]
    references = {name: str(coded(part, name)[1][0]) for name in texts if name not in empty and len(part)}
    return ModelFrame(index, response, x, names, empty, sources, grouping, dropped, parsed, part, flags, references)


def independent_columns(x: np.ndarray) -> np.ndarray:
    """Indices of the first columns that are linearly independent (scaled, tolerance 1e-10), as R's lm aliases."""
    kept: list[int] = []
    basis = np.zeros((len(x), 0))
    for j in range(x.shape[1]):
        column = x[:, j]
        length = float(np.linalg.norm(column))
        if length == 0:
            continue
        rest = column / length
        for _ in range(2):
            rest = rest - basis @ (basis.T @ rest)
        left = float(np.linalg.norm(rest))
        if left > 1e-10:
            kept.append(j)
            basis = np.hstack([basis, (rest / left)[:, None]])
    return np.array(kept, dtype=int)
