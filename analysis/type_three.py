"""Type III hypotheses of a model's terms: every factor averaged over the levels of the others, each level alike.

Coefficients of treatment coding cannot say it: beside an interaction, that of a factor is its effect at the first level
of the others. With deviations from the mean (R's contr.sum) the columns of a term vanish exactly where the term has no
effect on average; both codings span the same space, so that one fit serves.
"""

from __future__ import annotations

import re
from dataclasses import replace

import formulaic
import numpy as np
import pandas as pd
from formulaic.parser.types import Factor

from analysis.formula import ModelFrame

_CATEGORICAL = re.compile(r"C\(([^,)]+)[^)]*\)")


def _column(factor: Factor, frame: ModelFrame) -> tuple[str, bool]:
    """(The column that a factor of the formula reads, is it categorical); ("", False): an expression of columns."""
    name = factor.expr
    if factor.eval_method is Factor.EvalMethod.LOOKUP:
        return name, name in frame.flags or not pd.api.types.is_numeric_dtype(frame.part[name].dtype)
    found = _CATEGORICAL.fullmatch(name)
    return (found.group(1).strip().strip("`"), True) if found else ("", False)


def deviation_frame(frame: ModelFrame) -> ModelFrame:
    """The same model, its factors coded by deviations; ``sources`` gives each column's term as the formula names it."""
    plain: dict[str, str] = {}  # the table's columns under names that formulas read without quotes

    def coded(factor: Factor) -> str:
        name, categorical = _column(factor, frame)
        if not name:
            return str(factor.expr)
        alias = plain.setdefault(name, f"V{len(plain)}_")
        return f"C({alias}, contr.sum)" if categorical else alias

    made = [":".join(coded(factor) for factor in term.factors) for term in frame.parsed]
    part = frame.part.assign(**{alias: frame.part[name] for name, alias in plain.items()})
    matrix = formulaic.model_matrix(" + ".join(made if "1" in made else ["0", *made]), part, na_action="ignore")
    names = ["(Intercept)" if str(c) == "Intercept" else str(c) for c in matrix.columns]
    # Both formulas list their terms by degree and then as written, so that they stand in the same order.
    indices = zip(frame.parsed, matrix.model_spec.term_indices.values(), strict=True)
    sources = {names[j]: str(term) for term, columns in indices for j in columns}
    return replace(frame, x=np.asarray(matrix, float), terms=names, sources=sources)
