"""What a planned test is, and what it gave; shared by the plan and the functions that run it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from analysis.multiplicity import ALIASES
from stimuli.errors import InputError, problem


@dataclass(frozen=True)
class Test:
    """One planned test, in the words of `protocols.analysis_plan.PlannedTest`."""

    __test__ = False  # not a test case of pytest's

    name: str
    test: str
    dv: str = "rating"
    within: tuple[str, ...] = ()
    between: tuple[str, ...] = ()
    subject: str = "participant"
    where: Mapping[str, Sequence[str]] = field(default_factory=dict)
    separately_by: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """What a planned test gave: the table of `analysis`'s function (or one row that says why there is none)."""

    test: Test
    table: pd.DataFrame
    method: str
    n_subjects: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """``stated``: False where it was derived from the design, since the study had none; ``scales``: lowest and highest
    answer of each Likert question; ``levels``: those of the factors tested separately, as the protocol lists them;
    ``adaptive``: blocks whose trials depend on the answers before, and how (`analysis.protocol_facts`)."""

    tests: tuple[Test, ...]
    alpha: float
    adjust: str
    stated: bool
    scales: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    levels: Mapping[str, Sequence[str]] = field(default_factory=dict)
    adaptive: Mapping[str, str] = field(default_factory=dict)


def sphericity_corrected(row: Mapping[Any, Any]) -> bool:
    """Whether the result of an effect is stated with Greenhouse & Geisser's correction."""
    eps = float(row.get("eps_gg", np.nan))
    return bool(np.isfinite(eps) and eps < 0.9999 and row["df1"] > 1)


def reported_p(row: Mapping[Any, Any]) -> float:
    """The p value that is stated of a row: corrected for sphericity where it is to be."""
    return float(row["p_gg"] if sphericity_corrected(row) else row.get("p", np.nan))


def adjustment_name(method: str) -> str:
    """The adjustment of p values as papers write it."""
    known = {"BH": "Benjamini-Hochberg", "fdr": "Benjamini-Hochberg", "BY": "Benjamini-Yekutieli"}
    name = ALIASES.get(method, method)
    return known.get(name, "no adjustment" if name == "none" else name.capitalize())


def column_of(table: pd.DataFrame, name: str, test: Test) -> pd.Series:
    """A named column; InputError that names the test and the columns there are."""
    if name not in table:
        have = ", ".join(map(str, table.columns))
        raise InputError(problem(f"analysis plan: {test.name}", "column", repr(name), f"one of {have}"))
    return table[name]
