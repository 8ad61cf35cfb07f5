"""Analysis of variance: one-way, and repeated measures with any number of within and between factors (type III).

The repeated-measures analysis is the multivariate one of contrasts: Y (participants by cells) times orthonormal
Kronecker contrasts C gives each within effect its own variables Z = Y C; between effects are tested on Z by the general
linear model with sum-to-zero coding. SS are traces of the hypothesis and error matrices, sphericity is judged on the
error matrix (Maxwell & Delaney 2004, ch. 11 to 15; the numbers equal car::Anova's).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg

from analysis.cells import Cells, cell_means, shift_and_scale
from analysis.effect_sizes import eta2_interval
from analysis.log_tails import log10_f, p_chi2, p_f
from analysis.results import (
    OK,
    TOO_FEW_SUBJECTS,
    UNDEFINED,
    ZERO_ERROR_VARIANCE,
    coded,
    names_of,
    numbers,
    require_columns,
    result_table,
)
from stimuli.errors import InputError, problem

ONEWAY_COLUMNS = ["effect", "df1", "df2", "ss", "ss_error", "F", "p", "log10_p", "eta2", "eta2_low", "eta2_high"]


def effect_rows_columns() -> list[str]:
    """Columns of the repeated-measures table, in order."""
    return [
        "effect",
        "df1",
        "df2",
        "ss",
        "ss_error",
        "F",
        "p",
        "log10_p",
        "eps_gg",
        "eps_hf",
        "p_gg",
        "p_hf",
        "mauchly_w",
        "mauchly_p",
        "eta2_partial",
        "eta2_partial_low",
        "eta2_partial_high",
        "eta2_generalized",
        "eta2_generalized_low",
        "eta2_generalized_high",
    ]


def effects_of(factors: Sequence[str]) -> list[tuple[str, ...]]:
    """All effects of a full factorial, main effects first."""
    return [e for size in range(1, len(factors) + 1) for e in itertools.combinations(factors, size)]


def contrasts(size: int) -> np.ndarray:
    """Orthonormal contrasts of ``size`` levels, (size, size - 1): Helmert's."""
    return linalg.helmert(size).T if size > 1 else np.zeros((size, 0))


def oneway_anova(table: pd.DataFrame, dv: str, between: str, eta2_level: float = 0.90) -> pd.DataFrame:
    """One-way analysis of variance between groups; one row.

    Sums of squares are taken in two passes on values shifted by the first one (11 or more digits of the exact result
    on the stored doubles on every NIST StRD set). eta2 with its ``eta2_level`` interval by the noncentral F
    distribution. Rows without a value or group are left out and counted in ``attrs['dropped']``. Raises InputError for
    unknown columns.
    """
    (factor,) = names_of(between)
    require_columns("oneway_anova", table, [dv, factor])
    y = numbers("oneway_anova", table, dv)
    codes, levels = coded(table, factor)
    use = np.isfinite(y) & (codes >= 0)
    dropped = {"rows": f"{int((~use).sum())} rows without a value or group"} if not use.all() else {}
    y, scale, rounding = (lambda v: (v[0], v[2], v[3]))(shift_and_scale(y[use]))
    codes, n = codes[use], int(use.sum())
    count = np.bincount(codes, minlength=len(levels)) if n else np.zeros(0)
    occupied = np.flatnonzero(count)
    k = len(occupied)
    row: dict[str, Any] = dict.fromkeys(ONEWAY_COLUMNS, math.nan) | {"effect": factor, "df1": k - 1, "df2": n - k}
    if n:
        y = y - math.fsum(y) / n
        parts = [y[codes == g] for g in occupied] if k < 50 else _parts(y, codes)
        means = [math.fsum(part) / len(part) for part in parts]
        grand = math.fsum(len(part) * mean for part, mean in zip(parts, means, strict=True)) / n
        ss = math.fsum(len(part) * (mean - grand) ** 2 for part, mean in zip(parts, means, strict=True))
        within = [part - mean for part, mean in zip(parts, means, strict=True)]
        ss_error = math.fsum(math.fsum(d * d) - math.fsum(d) ** 2 / len(d) for d in within)
        row |= _f_test(ss, ss_error, k - 1, n - k, rounding**2 * n, scale * scale)
        row["eta2"] = row.pop("eta2_partial")
        row["eta2_low"], row["eta2_high"] = eta2_interval(row["F"], k - 1, n - k, eta2_level)
    if n == 0 or n - k < 1:
        row |= {"status": TOO_FEW_SUBJECTS, "note": f"{n} values in {k} groups leave no degrees of freedom for error"}
    elif k < 2:
        row |= {"status": UNDEFINED, "note": f"{factor!r} has one level"}
    method = f"One-way analysis of variance of {dv} between {k} groups of {factor}, {n} values."
    return result_table([row], ONEWAY_COLUMNS, method=method, n_subjects=n, dropped=dropped)


def _parts(y: np.ndarray, codes: np.ndarray) -> list[np.ndarray]:
    order = np.argsort(codes, kind="stable")
    return np.split(y[order], np.flatnonzero(np.diff(codes[order])) + 1)


def _f_test(ss: float, ss_error: float, df1: int, df2: int, zero: float, unit: float) -> dict[str, Any]:
    """F and its p from scaled sums of squares; ``zero``: what counts as no variance; ``unit``: scale squared."""
    nothing, no_error = not ss > zero, not ss_error > zero
    ss, ss_error = max(ss, 0.0), max(ss_error, 0.0)
    row: dict[str, Any] = {"ss": ss * unit if ss else 0.0, "ss_error": ss_error * unit if ss_error else 0.0}
    if df1 < 1 or df2 < 1:
        return row | {"F": math.nan, "p": math.nan, "log10_p": math.nan, "eta2_partial": math.nan}
    if no_error and nothing:
        row |= {"ss": 0.0, "ss_error": 0.0, "F": math.nan, "p": math.nan, "log10_p": math.nan, "eta2_partial": math.nan}
        return row | {"status": UNDEFINED, "note": "neither the effect nor its error varies: F is 0 / 0"}
    if no_error:
        row |= {"ss_error": 0.0, "F": math.inf, "p": 0.0, "log10_p": -math.inf, "eta2_partial": 1.0}
        return row | {"status": ZERO_ERROR_VARIANCE, "note": "the error does not vary: F is infinite"}
    f = (ss / df1) / (ss_error / df2)
    row |= {"F": f, "p": p_f(f, df1, df2), "log10_p": log10_f(f, df1, df2), "eta2_partial": ss / (ss + ss_error)}
    return row | {"status": OK, "note": ""}


def sphericity(error: np.ndarray, df_error: int) -> dict[str, float]:
    """Greenhouse & Geisser's and Huynh & Feldt's epsilon (cut to [1/d, 1]) and Mauchly's test of an error SSP matrix.

    Huynh & Feldt's in the form with error degrees of freedom (as car has it); Mauchly's p by the chi-square with
    Anderson's second-order term. One contrast is spherical by itself (all 1). Where there are more contrasts than error
    degrees of freedom Mauchly's test is undefined (nan) while both epsilons are defined.
    """
    d = len(error)
    if d == 1:
        return {"eps_gg": 1.0, "eps_hf": 1.0, "mauchly_w": 1.0, "mauchly_p": 1.0}
    trace = float(np.trace(error))
    if not trace > 0:
        return dict.fromkeys(("eps_gg", "eps_hf", "mauchly_w", "mauchly_p"), math.nan)
    unit = error / trace
    gg = min(1.0, 1.0 / (d * float(np.sum(unit * unit))))
    above, below = (df_error + 1) * d * gg - 2, d * (df_error - d * gg)
    if abs(below) > 1e-9 * d:
        hf = min(1.0, max(above / below, 1.0 / d)) if below > 0 else 1.0
    else:
        hf = 1.0 if above > 1e-9 else math.nan
    if d > df_error:
        return {"eps_gg": gg, "eps_hf": hf, "mauchly_w": math.nan, "mauchly_p": math.nan}
    sign, log_det = np.linalg.slogdet(unit * d)
    log_w = float(log_det) if sign > 0 else -math.inf
    return {"eps_gg": gg, "eps_hf": hf, "mauchly_w": math.exp(log_w), "mauchly_p": _mauchly_p(log_w, d, df_error)}


def _mauchly_p(log_w: float, d: int, n: int) -> float:
    """Chi-square approximation with the second-order term of Anderson (2003, section 10.7.4)."""
    if math.isinf(log_w):
        return 0.0
    rho = 1 - (2 * d * d + d + 2) / (6 * d * n)
    weight = (d + 2) * (d - 1) * (d - 2) * (2 * d**3 + 6 * d * d + 3 * d + 2) / (288 * (n * d * rho) ** 2)
    chi2, df = -n * rho * log_w, d * (d + 1) / 2 - 1
    first = p_chi2(chi2, df)
    return min(1.0, max(0.0, first + weight * (p_chi2(chi2, df + 4) - first)))


def rm_anova(
    table: pd.DataFrame,
    dv: str,
    within: str | list[str],
    subject: str,
    between: str | list[str] | None = None,
    eta2_level: float = 0.90,
) -> pd.DataFrame:
    """Repeated-measures (mixed) analysis of variance, type III; one row an effect, interactions named ``a:b``.

    Repetitions are averaged per participant and cell. Participants who lack a cell are left out and named, with the
    cell, in ``attrs['dropped']``. F and p are uncorrected; ``p_gg`` and ``p_hf`` are corrected for sphericity.
    Effects within two levels (and between participants) need no correction: their epsilons, W and Mauchly's p are 1.
    Generalized eta squared: Olejnik & Algina (2003), all factors manipulated. Intervals are ``eta2_level`` (0.90:
    without 0 exactly where p < .05) by the noncentral F distribution. Raises InputError for unknown or repeated
    columns.
    """
    factors, groups = names_of(within), names_of(between)
    named = [dv, subject, *factors, *groups]
    if len(set(named)) < len(named):
        raise InputError(problem("rm_anova", "columns", named, "each column named once"))
    cells = cell_means("rm_anova", table, dv, factors, subject, groups)
    rows = anova_of_cells(
        cells.values, cells.levels, factors, cells.groups, cells.group_levels, groups, cells.rounding,
        unit=cells.scale * cells.scale, eta2_level=eta2_level,
    )  # fmt: skip
    n = len(cells.subjects)
    method = (
        f"Repeated-measures analysis of variance (type III) of {dv} within {', '.join(factors) or 'nothing'}"
        + (f" and between {', '.join(groups)}" if groups else "")
        + f", {n} participants; {_averaging(cells)}; {eta2_level:.0%} intervals of eta squared by the noncentral F."
    )
    return result_table(
        rows, effect_rows_columns(), method=method, n_subjects=n, dropped=cells.dropped, attrs={"notes": cells.notes}
    )


def _averaging(cells: Cells) -> str:
    return f"up to {cells.repetitions} repetitions a cell averaged" if cells.repetitions > 1 else "one value a cell"


def anova_of_cells(
    values: np.ndarray,
    levels: list[list[Any]],
    within: list[str],
    groups: np.ndarray,
    group_levels: list[list[Any]],
    between: list[str],
    rounding: float,
    *,
    unit: float = 1.0,
    effects: list[tuple[str, ...]] | None = None,
    eta2_level: float = 0.90,
) -> list[dict[str, Any]]:
    """Rows of the ANOVA of ``values`` (participants, cells in C order of ``levels``); see ``rm_anova``."""
    shape = [len(found) for found in levels]
    n = len(values)
    model, columns = _between_model(groups, group_levels, between)
    rank = model.shape[1]
    centred = values - values.mean() if n else values
    full = n > rank and np.linalg.matrix_rank(model) == rank
    rows: list[dict[str, Any]] = []
    errors: dict[tuple[str, ...], float] = {}
    for stratum in [(), *effects_of(within)]:
        basis = _basis(shape, [within.index(name) for name in stratum])
        z = centred @ basis
        fit, *_ = np.linalg.lstsq(model, z, rcond=None) if full else (np.zeros((rank, z.shape[1])),)
        residual = z - model @ fit
        error = residual.T @ residual
        errors[stratum] = float(np.trace(error))
        for group_effect in [(), *effects_of(between)]:
            name = (*group_effect, *stratum)
            if not name or (effects is not None and name not in effects):
                continue
            rows.append(_effect_row(name, z, model, columns[group_effect], fit, error, n, rank, full, rounding))
    # Generalized eta squared takes the error of every stratum into its denominator.
    total_error = sum(errors.values())
    for row in rows:
        _finish(row, total_error, unit, eta2_level)
    order = {effect: i for i, effect in enumerate([":".join(e) for e in effects_of([*between, *within])])}
    rows.sort(key=lambda row: order[row["effect"]])
    if n == 0:
        for row in rows:
            row["note"] = "no participant has a valid value in every cell"
    return rows


def _basis(shape: list[int], axes: list[int]) -> np.ndarray:
    """Orthonormal basis of a within effect: contrasts on ``axes``, the normalised mean elsewhere."""
    basis = np.ones((1, 1))
    for axis, size in enumerate(shape):
        basis = np.kron(basis, contrasts(size) if axis in axes else np.full((size, 1), 1 / math.sqrt(max(size, 1))))
    return basis


def _between_model(
    groups: np.ndarray, levels: list[list[Any]], between: list[str]
) -> tuple[np.ndarray, dict[tuple[str, ...], list[int]]]:
    """Full factorial model of the participants' groups in sum-to-zero coding, and each effect's columns."""
    n = len(groups)
    coding = []
    for j, found in enumerate(levels):
        size = len(found)
        sums = np.vstack([np.eye(max(size - 1, 0)), -np.ones((1, max(size - 1, 0)))]) if size else np.zeros((1, 0))
        coding.append(sums[groups[:, j]] if n else np.zeros((0, sums.shape[1])))
    parts, used = [np.ones((n, 1))], 1
    columns: dict[tuple[str, ...], list[int]] = {(): [0]}
    for effect in effects_of(between):
        part = np.ones((n, 1))
        for name in effect:
            part = np.einsum("ni,nj->nij", part, coding[between.index(name)]).reshape(n, -1)
        parts.append(part)
        columns[effect] = list(range(used, used + part.shape[1]))
        used += part.shape[1]
    return np.hstack(parts), columns


def _effect_row(
    name: tuple[str, ...],
    z: np.ndarray,
    model: np.ndarray,
    columns: list[int],
    fit: np.ndarray,
    error: np.ndarray,
    n: int,
    rank: int,
    full: bool,
    rounding: float,
) -> dict[str, Any]:
    """F test of one effect: hypothesis SSP of the model's ``columns`` on the contrast variables ``z``."""
    d = z.shape[1]
    df1, df2 = d * len(columns), d * (n - rank)
    row: dict[str, Any] = dict.fromkeys(effect_rows_columns(), math.nan) | {"effect": ":".join(name)}
    row |= {"df1": df1, "df2": max(df2, 0), "_share": 0.0}
    if df1 == 0:
        return row | {"status": UNDEFINED, "note": "a factor has fewer than two levels"}
    if n - rank < 1:
        need = rank + 1
        return row | {"status": TOO_FEW_SUBJECTS, "note": f"{n} complete participants, at least {need} are needed"}
    if not full:
        return row | {"status": UNDEFINED, "note": "a combination of between factors has no participant"}
    inverse = np.linalg.inv(model.T @ model)[np.ix_(columns, columns)]
    ss = float(np.sum(fit[columns] * np.linalg.solve(inverse, fit[columns])))
    row |= _f_test(ss, float(np.trace(error)), df1, df2, rounding**2 * z.size, 1.0)
    if row["status"] != OK:
        return row
    row |= sphericity(error, n - rank)
    for kind in ("gg", "hf"):
        eps = row[f"eps_{kind}"]
        row[f"p_{kind}"] = p_f(row["F"], eps * df1, eps * df2) if not math.isnan(eps) else math.nan
    if math.isnan(row["mauchly_w"]):
        row["status"] = TOO_FEW_SUBJECTS
        row["note"] = (
            f"F, p and Greenhouse & Geisser's correction are right, but Mauchly's test is undefined: "
            f"{d} contrasts, {n - rank} error degrees of freedom"
        )
    return row


def _finish(row: dict[str, Any], total_error: float, unit: float, level: float) -> None:
    """Effect sizes with intervals, and sums of squares in the data's unit."""
    ss, ss_error, f = row["ss"], row["ss_error"], row["F"]
    row.pop("_share", None)
    if not math.isnan(f):
        denominator = ss + total_error
        row["eta2_generalized"] = ss / denominator if denominator > 0 else math.nan
        low, high = eta2_interval(f, row["df1"], row["df2"], level)
        row["eta2_partial_low"], row["eta2_partial_high"] = low, high
        for name, bound in (("low", low), ("high", high)):
            # The same noncentrality as a sum of squares, put over all error.
            effect = ss_error * bound / (1 - bound) if bound < 1 else ss
            row[f"eta2_generalized_{name}"] = effect / (effect + total_error) if effect + total_error > 0 else math.nan
    row["ss"], row["ss_error"] = (value * unit if value else value for value in (ss, ss_error))
