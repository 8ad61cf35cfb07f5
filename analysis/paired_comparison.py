"""Bradley-Terry scales from paired comparisons, with ties and order effect; what Thurstone's scale shares with them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from analysis.log_tails import log10_z, p_chi2, p_z
from analysis.multiplicity import METHODS, adjust_p
from analysis.pair_model import (
    Fit,
    Pairs,
    components,
    design,
    fit_pairs,
    log_coefficients,
    saturated_deviance,
    scores,
)
from analysis.results import (
    DISCONNECTED,
    NOT_CONVERGED,
    OK,
    SEPARATED,
    TOO_FEW_SUBJECTS,
    UNDEFINED,
    coded,
    numbers,
    one_of,
    require_columns,
    result_table,
)
from stimuli.errors import InputError, problem

# One JOD: 75 % prefer the better one. In probit units z(0.75), in logits ln 3.
JOD_Z = 0.6744897501960817
JOD_LOGIT = math.log(3.0)
TIE_COLUMNS = ("tie", "ties", "tied", "is_tie")
ORDER_COLUMNS = ("first", "home", "shown_first", "order", "side")


LONE = "one observer compared it: no inference about others"


@dataclass(frozen=True)
class Comparisons:
    """Rows of a table counted by pair; ``counts`` (observers, 3, pairs) where observers are known."""

    items: list[Any]
    pairs: Pairs
    observers: list[Any]
    counts: np.ndarray
    dropped: dict[Any, str]

    def lone(self) -> np.ndarray:
        """Which items fewer than two of the observers compared."""
        seen = self.counts.sum(axis=1) > 0
        its = [(self.pairs.first == i) | (self.pairs.second == i) for i in range(len(self.items))]
        return np.array([seen[:, own].any(axis=1).sum() < 2 for own in its])


def _first_shown(where: str, table: pd.DataFrame, column: str, winner: str, loser: str) -> np.ndarray:
    """+1 where the winner was presented first, -1 where the loser was, 0 where the column does not say."""
    shown, won, lost = (table[name].astype(object).to_numpy() for name in (column, winner, loser))
    is_winner = np.array([a == b for a, b in zip(shown, won, strict=True)], dtype=bool)
    is_loser = np.array([a == b for a, b in zip(shown, lost, strict=True)], dtype=bool)
    if (is_winner | is_loser).any():
        return is_winner.astype(float) - is_loser.astype(float)
    flags = numbers(where, table, column)
    if not np.isin(flags[np.isfinite(flags)], (-1.0, 0.0, 1.0)).all():
        raise InputError(problem(where, f"column {column!r}", "other values", "the item shown first, or 1, 0, -1"))
    if (flags == -1).any():
        return np.nan_to_num(flags)
    return np.where(flags == 1, 1.0, np.where(flags == 0, -1.0, 0.0))


def count_comparisons(
    where: str,
    table: pd.DataFrame,
    winner: str,
    loser: str,
    ties: str | None,
    order: str | None,
    observer: str | None,
    count: str | None,
) -> Comparisons:
    """Count the table by pair, order and observer."""
    require_columns(where, table, [c for c in (winner, loser, ties, order, observer, count) if c is not None])
    both = pd.concat([table[winner].astype(object), table[loser].astype(object)], ignore_index=True)
    categories = [table[c].dtype for c in (winner, loser)]
    if isinstance(categories[0], pd.CategoricalDtype) and categories[0] == categories[1]:
        both = both.astype(categories[0])
    codes, items = coded(pd.DataFrame({"item": both}), "item")
    won, lost = codes[: len(table)], codes[len(table) :]
    weight = numbers(where, table, count) if count else np.ones(len(table))
    if (weight < 0).any():
        raise InputError(problem(where, f"column {count!r}", "negative values", "counts"))
    tie = np.zeros(len(table), dtype=bool)
    if ties is not None:
        flags = numbers(where, table, ties)
        if not np.isin(flags[np.isfinite(flags)], (0.0, 1.0)).all():
            raise InputError(problem(where, f"column {ties!r}", "other values", "true where the row is a tie"))
        tie = flags == 1
    person, observers = coded(table, observer) if observer else (np.zeros(len(table), dtype=np.int64), [])
    use = (won >= 0) & (lost >= 0) & (won != lost) & np.isfinite(weight) & (person >= 0)
    dropped = {}
    if not use.all():
        dropped["rows"] = f"{int((~use).sum())} rows without two different items, an observer or a count"
    shown = _first_shown(where, table, order, winner, loser) if order else np.zeros(len(table))
    low, high = np.minimum(won, lost)[use], np.maximum(won, lost)[use]
    low_won = (won < lost)[use]
    # The order of the pair (low, high): the winner's order turned round where the winner is the higher item.
    turned = np.where(low_won, shown[use], -shown[use])
    keys, index = np.unique(np.stack([low, high, turned.astype(np.int64)]), axis=1, return_inverse=True)
    kind = np.where(tie[use], 2, np.where(low_won, 0, 1))
    people, width = max(len(observers), 1), keys.shape[1]
    flat = (person[use] * 3 + kind) * width + index.ravel()
    counts = np.bincount(flat, weights=weight[use], minlength=people * 3 * width).reshape(people, 3, width)
    total = counts.sum(axis=0)
    pairs = Pairs(keys[0], keys[1], keys[2].astype(float), total[0], total[1], total[2])
    seen = counts.sum(axis=(1, 2)) > 0
    for i in np.flatnonzero(~seen[: len(observers)]):
        dropped[observers[i]] = "has no valid comparison: left out"
    kept = [name for name, found in zip(observers, seen, strict=False) if found]
    return Comparisons(items, pairs, kept, counts[seen] if observers else counts, dropped)


def solve(comparisons: Comparisons, link: str, with_ties: bool, with_order: bool) -> dict[str, Any]:
    """Fit what can be fitted: abilities and covariance of all items, a status and note each, and the fit."""
    items, pairs = comparisons.items, comparisons.pairs
    m = len(items)
    ability, status, note = np.zeros(m), [OK] * m, [""] * m
    solved: dict[str, Any] = {"ability": ability, "status": status, "note": note, "separation": False, "fit": None}
    covariance = np.zeros((m, m))
    solved["covariance"] = covariance
    if m < 2:
        solved |= {"status": [UNDEFINED] * m, "note": ["fewer than two items were compared"] * m}
        ability[:] = np.nan
        return solved
    weak, strong, reach = components(pairs, m)
    use: np.ndarray = np.arange(m)
    if strong.max() > 0:
        use = np.flatnonzero(strong == strong[0])
        cut = DISCONNECTED if weak.max() > 0 else SEPARATED
        solved["separation"] = cut == SEPARATED or _separated_within(weak, strong)
        for i in range(m):
            status[i] = cut
            if strong[i] == strong[0]:
                note[i] = "finite relative to the first item, but not every item is" if i else "the reference item"
                continue
            wins, loses = reach[i, 0], reach[0, i]
            ability[i] = math.inf if wins else -math.inf if loses else math.nan
            covariance[i, i] = math.inf if wins or loses else math.nan
            if wins or loses:
                note[i] = f"never {'loses' if wins else 'wins'} against the first item's side: no finite estimate"
            else:
                note[i] = "was never compared with the first item, not even through others that each won and lost"
    inside = np.isin(pairs.first, use) & np.isin(pairs.second, use)
    place = np.full(m, -1)
    place[use] = np.arange(len(use))
    part = Pairs(place[pairs.first[inside]], place[pairs.second[inside]], pairs.order[inside],
                 pairs.wins[inside], pairs.losses[inside], pairs.ties[inside])  # fmt: skip
    x = design(part, len(use), with_order)
    fit = fit_pairs(part, x, link, with_ties)
    free = len(use) - 1
    ability[use[1:]] = fit.parameters[:free]
    covariance[np.ix_(use[1:], use[1:])] = fit.covariance[:free, :free]
    if not fit.converged:
        for i in use.tolist():
            status[i], note[i] = NOT_CONVERGED, "the search for the maximum did not end"
        if with_order or with_ties or float(np.max(np.abs(fit.parameters), initial=0.0)) >= 25:
            solved["separation"] = True
            for i in use.tolist():
                status[i], note[i] = SEPARATED, "the order effect or the ties separate the answers: no finite maximum"
    return solved | {"fit": fit, "pairs": part, "x": x, "use": use, "inside": inside}


def _separated_within(weak: np.ndarray, strong: np.ndarray) -> bool:
    """Whether a component of compared items falls into several strong ones."""
    return any(len(set(strong[weak == w].tolist())) > 1 for w in set(weak.tolist()))


def _robust(comparisons: Comparisons, solved: dict[str, Any], link: str) -> np.ndarray:
    """Sandwich covariance with the observer as the unit, n / (n - 1)."""
    fit: Fit = solved["fit"]
    n = len(comparisons.counts)
    by_observer = scores(solved["pairs"], solved["x"], link, fit.parameters, comparisons.counts[:, :, solved["inside"]])
    meat = by_observer.T @ by_observer * (n / (n - 1))
    return fit.covariance @ meat @ fit.covariance


def _order_column(table: pd.DataFrame, order_effect: bool | str) -> str | None:
    """The column that tells which item was presented first."""
    if order_effect is False or order_effect is None:
        return None
    if isinstance(order_effect, str):
        return order_effect
    found = [name for name in ORDER_COLUMNS if name in table.columns]
    if not found:
        wanted = "a column 'first' with the item presented first, or order_effect='COLUMN'"
        raise InputError(problem("bradley_terry", "order_effect", "no column that tells the order", wanted))
    return found[0]


def _tie_column(table: pd.DataFrame, ties: str | None) -> str | None:
    """The column that marks ties; 'davidson', the model's name, finds one by its usual name."""
    if ties != "davidson" or ties in table.columns:
        return ties
    found = [name for name in TIE_COLUMNS if name in table.columns]
    if not found:
        raise InputError(
            problem("bradley_terry", "ties", "no column that tells ties", "ties='COLUMN', true where tied")
        )
    return found[0]


def bradley_terry(
    table: pd.DataFrame,
    winner: str,
    loser: str,
    ties: str | None = None,
    order_effect: bool | str = False,
    observer: str | None = None,
    count: str | None = None,
) -> pd.DataFrame:
    """Bradley & Terry's (1952) abilities in logits by maximum likelihood, the first item (in order) at 0.

    A row of ``table`` is a comparison, or ``count`` of them. ``ties``: column, true where the two were called equal
    (Davidson 1970; its log nu in ``attrs['tie_parameter']``). ``order_effect``: column with the item presented first
    (or 1 / 0: the winner was or was not; True looks for a column ``first``); the advantage, in logits, is in
    ``attrs['order_effect']``. With ``observer`` the standard errors are those of the sandwich over observers and
    intervals use t with observers - 1 degrees of freedom; without, every comparison counts as independent. ``jod``,
    ``jod_se``: the same over ln 3. ``attrs``: log_likelihood (with binomial coefficients), deviance, df_residual,
    p_gof, separation, covariance (items by items). Where no finite maximum exists every row says ``separated`` or
    ``disconnected`` and abilities are infinite or nan. Raises InputError for unknown columns.
    """
    columns = winner, loser, _tie_column(table, ties), _order_column(table, order_effect), observer, count
    comparisons = count_comparisons("bradley_terry", table, *columns)
    solved = solve(comparisons, "logit", _any(comparisons.pairs.ties), bool(order_effect))
    return _scale_table("bradley_terry", comparisons, solved, "logit", observer is not None)


def _any(values: np.ndarray) -> bool:
    return bool((values > 0).any())


def _scale_table(
    where: str, comparisons: Comparisons, solved: dict[str, Any], link: str, by_observer: bool
) -> pd.DataFrame:
    fit: Fit | None = solved["fit"]
    n = len(comparisons.observers)
    m = len(comparisons.items)
    covariance, quantile = solved["covariance"].copy(), float(special.ndtri(0.975))
    extra: dict[str, Any] = {}
    parameter_covariance = fit.covariance if fit else np.zeros((0, 0))
    few = by_observer and n < 2
    if fit and by_observer and not few:
        parameter_covariance = _robust(comparisons, solved, link)
        free = len(solved["use"]) - 1
        covariance[np.ix_(solved["use"][1:], solved["use"][1:])] = parameter_covariance[:free, :free]
        quantile = float(special.stdtrit(n - 1, 0.975))
    rows = []
    for i, item in enumerate(comparisons.items):
        ability, se = float(solved["ability"][i]), math.sqrt(max(float(covariance[i, i]), 0.0))
        row = {"item": item, "ability": ability, "se": se, "status": solved["status"][i], "note": solved["note"][i]}
        if math.isinf(ability):
            row |= {"se": math.inf, "ci_low": -math.inf, "ci_high": math.inf}
        elif math.isnan(ability) or (few and i > 0):
            row |= {"se": math.nan, "ci_low": math.nan, "ci_high": math.nan}
        else:
            row |= {"ci_low": ability - quantile * se, "ci_high": ability + quantile * se}
        if few and row["status"] == OK:
            row |= {"status": TOO_FEW_SUBJECTS, "note": f"{n} observer: no inference about others"}
        if by_observer and i > 0 and comparisons.lone()[i] and row["status"] == OK:
            row |= {"se": math.nan, "ci_low": math.nan, "ci_high": math.nan, "status": TOO_FEW_SUBJECTS, "note": LONE}
        row |= {"jod": ability / JOD_LOGIT, "jod_se": row["se"] / JOD_LOGIT}
        rows.append(row)
    if fit:
        extra |= fit_attrs(solved, parameter_covariance, link, quantile)
    unit = (
        f"sandwich errors over {n} observers, t({n - 1})" if by_observer else "each comparison counted as independent"
    )
    method = f"Bradley-Terry model by maximum likelihood, {m} items, {unit}."
    attrs = {"separation": solved["separation"], "covariance": covariance.tolist(), "unit": "logit", **extra}
    columns = ["item", "ability", "se", "ci_low", "ci_high", "jod", "jod_se"]
    return result_table(rows, columns, method=method, n_subjects=n, dropped=comparisons.dropped, attrs=attrs)


def fit_attrs(solved: dict[str, Any], covariance: np.ndarray, link: str, quantile: float) -> dict[str, Any]:
    """Log-likelihood, deviance, and the parameters that belong to no item."""
    fit, part, x = solved["fit"], solved["pairs"], solved["x"]
    free = len(solved["use"]) - 1
    with_ties = len(fit.parameters) > x.shape[1]
    deviance, df = saturated_deviance(part, x, fit.parameters, link, with_ties)
    found: dict[str, Any] = {
        "log_likelihood": fit.log_likelihood + log_coefficients(part),
        "log_likelihood_bernoulli": fit.log_likelihood,
        "deviance": deviance,
        "df_residual": df,
        "p_gof": p_chi2(deviance, df) if df > 0 else 1.0,
    }
    for name, index, present in (
        ("order_effect", free, x.shape[1] > free),
        ("tie_parameter", len(fit.parameters) - 1, with_ties),
    ):
        if present:
            estimate, se = float(fit.parameters[index]), math.sqrt(max(float(covariance[index, index]), 0.0))
            z = estimate / se if se > 0 else math.nan
            found[name] = {
                "estimate": estimate, "se": se, "z": z, "p": p_z(z), "log10_p": log10_z(z),
                "ci_low": estimate - quantile * se, "ci_high": estimate + quantile * se,
            }  # fmt: skip
    return found


def compare_items(scale: pd.DataFrame, adjust: str = "holm") -> pd.DataFrame:
    """Differences of all pairs of a scale from ``bradley_terry`` or ``thurstone``, with their covariance; adjusted."""
    one_of("compare_items", "adjust", adjust, METHODS)
    value = "ability" if "ability" in scale.columns else "scale"
    covariance = np.array(scale.attrs["covariance"])
    rows: list[dict[str, Any]] = []
    for i, j in itertools.combinations(range(len(scale)), 2):
        a, b = scale.iloc[i], scale.iloc[j]
        row: dict[str, Any] = {"a": a["item"], "b": b["item"], "z": math.nan, "se": math.nan}
        with np.errstate(invalid="ignore"):
            row["diff"] = float(a[value]) - float(b[value])
            variance = float(covariance[i, i] + covariance[j, j] - 2 * covariance[i, j])
        worst = next((r for r in (a, b) if not math.isfinite(float(r[value]))), None)
        if worst is not None:
            row |= {"status": worst["status"], "note": worst["note"]}
        elif not variance > 0:
            row |= {"status": UNDEFINED, "note": "no standard error"}
        else:
            row |= {"se": math.sqrt(variance), "z": row["diff"] / math.sqrt(variance)}
        row |= {"p": p_z(row["z"]), "log10_p": log10_z(row["z"])}
        rows.append(row)
    for row, p in zip(rows, adjust_p([row["p"] for row in rows], adjust), strict=True):
        row["p_adjusted"] = float(p)
    columns = ["a", "b", "diff", "se", "z", "p", "p_adjusted", "log10_p"]
    method = f"Wald tests of differences with their covariance, {adjust} over {len(rows)} pairs."
    return result_table(rows, columns, method=method, n_subjects=scale.attrs.get("n_subjects", 0))
