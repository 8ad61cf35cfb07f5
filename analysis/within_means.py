"""Cell means over participants with within-subject 95 % intervals, for plots and descriptive tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy import stats


def cell_means(
    table: pd.DataFrame, dv: str, within: Sequence[str], subject: str = "participant", level: float = 0.95
) -> pd.DataFrame:
    """Means of the ``within`` cells over participants (repetitions averaged first), with Cousineau-Morey intervals.

    Columns: the factors, n (participants), mean, sd (over participants), ci_low, ci_high. The interval removes each
    participant's own level (Cousineau 2005) and corrects the variance by C / (C - 1) for C cells (Morey 2008); it
    stands on the participants who have every cell. With fewer than two of them, or one cell, the interval is nan or
    the ordinary one.
    """
    factors = list(within)
    known = table[np.isfinite(table[dv].astype(float))]
    cells = known.groupby([subject, *factors], observed=True, sort=False)[dv].mean().astype(float).reset_index()
    keys = pd.MultiIndex.from_frame(cells[factors].astype(str))
    wide = pd.DataFrame({"subject": cells[subject], "cell": list(keys), "value": cells[dv]}).pivot_table(
        index="subject", columns="cell", values="value", sort=False
    )
    complete = wide.dropna()
    n_cells = wide.shape[1]
    normed = complete.sub(complete.mean(axis=1), axis=0) + complete.to_numpy().mean() if len(complete) else complete
    correction = np.sqrt(n_cells / (n_cells - 1)) if n_cells > 1 else 1.0
    spread = (normed if n_cells > 1 else complete).std(ddof=1) * correction
    n = len(complete)
    half = stats.t.ppf(0.5 + level / 2, n - 1) * spread / np.sqrt(n) if n > 1 else spread * np.nan
    rows = []
    for cell in wide.columns:
        values = wide[cell].dropna()
        mean = float(values.mean())
        sd = float(values.std(ddof=1)) if len(values) > 1 else float("nan")
        reach = float(half[cell])
        levels = dict(zip(factors, cell if isinstance(cell, tuple) else (cell,), strict=True))
        rows.append(
            {**levels, "n": len(values), "mean": mean, "sd": sd, "ci_low": mean - reach, "ci_high": mean + reach}
        )
    return pd.DataFrame(rows, columns=[*factors, "n", "mean", "sd", "ci_low", "ci_high"])


def one_sample(values: Sequence[float] | np.ndarray, against: float, level: float = 0.95) -> dict[str, object]:
    """Mean of one number a participant, its t interval, and the t test against a value.

    Keys: n, mean, ci_low, ci_high, t, df, p, status, note. Nothing is invented where the spread is zero
    (``zero_error_variance``) or fewer than two participants have a number (``too_few_subjects``).
    """
    x = np.asarray(values, dtype=float)
    x = x[np.isfinite(x)]
    nan = float("nan")
    row: dict[str, object] = {"n": len(x), "mean": float(x.mean()) if len(x) else nan, "ci_low": nan, "ci_high": nan}
    row |= {"t": nan, "df": len(x) - 1 if len(x) > 1 else nan, "p": nan}
    if len(x) < 2:
        return row | {"status": "too_few_subjects", "note": f"{len(x)} participant(s) with a number, 2 needed"}
    sd = float(np.std(x - x[0], ddof=1))
    if sd <= 64 * np.finfo(float).eps * max(float(np.abs(x).max()), abs(against)):
        return row | {"status": "zero_error_variance", "note": "every participant has the same number"}
    error = sd / np.sqrt(len(x))
    t = (float(x.mean()) - against) / error
    half = float(stats.t.ppf(0.5 + level / 2, len(x) - 1)) * error
    row |= {"ci_low": float(x.mean()) - half, "ci_high": float(x.mean()) + half, "t": t}
    return row | {"p": float(2 * stats.t.sf(abs(t), len(x) - 1)), "status": "ok", "note": ""}
