"""Thurstone's Case V scale from paired comparisons, in JOD or z."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from analysis.bootstrap import in_blocks, resample_weights
from analysis.pair_model import design, fit_many
from analysis.paired_comparison import JOD_Z, LONE, Comparisons, count_comparisons, fit_attrs, solve
from analysis.results import OK, SEPARATED, TOO_FEW_SUBJECTS, one_of, result_table


def thurstone(
    table: pd.DataFrame,
    winner: str,
    loser: str,
    count: str | None = None,
    observer: str | None = None,
    unit: str = "jod",
    method: str = "ml",
    seed: int = 0,
    n_boot: int = 2000,
    workers: int | None = None,
) -> pd.DataFrame:
    """Thurstone's Case V scale, the first item (in order) at 0; in JOD (z / 0.67449) or z.

    ``method``: 'ml' maximum likelihood (Tsukida & Gupta 2011), or 'mean_z' least squares of the normal quantiles of the
    win shares (Mosteller 1951: the mean of z over a complete matrix). With ``observer`` the standard errors come from a
    bootstrap over observers (``n_boot`` resamples, ``seed``; resamples without a finite scale are counted in
    ``attrs['boot_failed']``; ``workers`` threads change nothing but the time), widened by sqrt(n / (n - 1)), and
    intervals use t(n - 1). Without, each comparison counts as independent. Statuses as in ``bradley_terry``.
    Raises InputError for unknown names.
    """
    one_of("thurstone", "unit", unit, ("jod", "z"))
    one_of("thurstone", "method", method, ("ml", "mean_z"))
    comparisons = count_comparisons("thurstone", table, winner, loser, None, None, observer, count)
    solved = solve(comparisons, "probit", False, False)
    n, factor = len(comparisons.observers), (1 / JOD_Z if unit == "jod" else 1.0)
    quantile, attrs = float(special.ndtri(0.975)), {"separation": solved["separation"], "unit": unit}
    if method == "mean_z":
        _mean_z(comparisons, solved)
    if solved["fit"] is not None and method == "ml":
        attrs |= fit_attrs(solved, solved["fit"].covariance, "probit", quantile)
    covariance = solved["covariance"]
    few = observer is not None and n < 2
    if observer is not None and not few and all(s == OK for s in solved["status"]):
        boot = _bootstrap(comparisons, solved, method, seed, n_boot, workers)
        valid = boot[np.isfinite(boot).all(axis=1)]
        attrs |= {"boot_failed": len(boot) - len(valid), "n_boot": n_boot, "seed": seed}
        if len(valid) > 1:
            covariance = np.atleast_2d(np.cov(valid, rowvar=False)) * n / (n - 1)
        quantile = float(special.stdtrit(n - 1, 0.975))
    rows = []
    for i, item in enumerate(comparisons.items):
        z, se = float(solved["ability"][i]), math.sqrt(max(float(covariance[i, i]), 0.0))
        row = {"item": item, "status": solved["status"][i], "note": solved["note"][i]}
        if math.isinf(z):
            row |= {"scale": z, "se": math.inf, "ci_low": -math.inf, "ci_high": math.inf}
        elif math.isnan(z) or (few and i > 0):
            row |= {"scale": z * factor, "se": math.nan, "ci_low": math.nan, "ci_high": math.nan}
        else:
            low, high = z - quantile * se, z + quantile * se
            row |= {"scale": z * factor, "se": se * factor, "ci_low": low * factor, "ci_high": high * factor}
        if few and row["status"] == OK:
            row |= {"status": TOO_FEW_SUBJECTS, "note": f"{n} observer: no inference about others"}
        if observer and i > 0 and comparisons.lone()[i] and row["status"] == OK:
            row |= {"se": math.nan, "ci_low": math.nan, "ci_high": math.nan, "status": TOO_FEW_SUBJECTS, "note": LONE}
        rows.append(row)
    attrs["covariance"] = (covariance * factor**2).tolist()
    how = "maximum likelihood" if method == "ml" else "least squares of z"
    errors = f"bootstrap over {n} observers, {n_boot} resamples, seed {seed}" if observer else "comparisons independent"
    sentence = f"Thurstone Case V scale in {unit.upper() if unit == 'jod' else 'z'} by {how}; {errors}."
    columns = ["item", "scale", "se", "ci_low", "ci_high"]
    return result_table(rows, columns, method=sentence, n_subjects=n, dropped=comparisons.dropped, attrs=attrs)


def _mean_z(comparisons: Comparisons, solved: dict[str, Any]) -> None:
    """Replace abilities by least squares of z; nothing finite where a pair is all wins or all losses."""
    pairs, m = comparisons.pairs, len(comparisons.items)
    if solved["fit"] is None or len(solved["use"]) < m:
        return
    n = pairs.wins + pairs.losses
    share = pairs.wins / n
    if ((share <= 0) | (share >= 1)).any():
        solved["ability"][1:] = np.nan
        solved["status"] = [SEPARATED] * m
        solved["note"] = [
            "a pair was decided the same way every time: its z is infinite (method='ml' may be finite)"
        ] * m
        return
    solver = np.linalg.pinv(design(pairs, m, False))
    z = special.ndtri(share)
    density = np.exp(-z * z / 2) / math.sqrt(2 * math.pi)
    solved["ability"] = np.append(0.0, solver @ z)
    variance = share * (1 - share) / (n * density**2)
    solved["covariance"] = np.zeros((m, m))
    solved["covariance"][1:, 1:] = (solver * variance) @ solver.T


def _bootstrap(
    comparisons: Comparisons, solved: dict[str, Any], method: str, seed: int, n_boot: int, workers: int | None = None
) -> np.ndarray:
    """Scales (n_boot, items) of resampled observers; nan rows where no finite scale exists."""
    m = len(comparisons.items)
    solver = np.linalg.pinv(design(comparisons.pairs, m, False)) if method == "mean_z" else None

    def fit(weights: np.ndarray) -> np.ndarray:
        wins, losses = weights @ comparisons.counts[:, 0], weights @ comparisons.counts[:, 1]
        if solver is None:
            return fit_many(solved["x"], "probit", wins, losses, solved["ability"][1:])
        with np.errstate(invalid="ignore", divide="ignore"):
            found = np.asarray(special.ndtri(wins / (wins + losses)) @ solver.T)
        found[~np.isfinite(found).all(axis=1)] = np.nan
        return found

    found = in_blocks(fit, resample_weights(len(comparisons.observers), n_boot, seed), workers)
    return np.hstack([np.zeros((len(found), 1)), found])
