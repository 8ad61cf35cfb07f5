"""How consistent observers are in paired comparisons: circular triads, and who answers unlike the others."""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from analysis.log_tails import p_chi2
from analysis.paired_comparison import count_comparisons, solve
from analysis.results import OK, UNDEFINED, coded, require_columns, result_table


def circular_triads(table: pd.DataFrame, winner: str, loser: str, observer: str) -> pd.DataFrame:
    """Circular triads (a over b, b over c, c over a) of each observer, by majority over repetitions; one row each.

    ``consistency`` is Kendall & Babington Smith's (1940) zeta where all pairs were judged, 1 - circular / triads judged
    relative to the most possible; ``p`` that choices at random have at most so many: exact for 5 to 7 items, by their
    chi-square for more. Nothing is tested, and the row is ``undefined``, where not every pair was judged or there are
    fewer than 5 items (with 4 even no circle at all is no evidence: p is .375).
    """
    require_columns("circular_triads", table, [winner, loser, observer])
    person, observers = coded(table, observer)
    both = pd.DataFrame({"item": pd.concat([table[winner], table[loser]], ignore_index=True).astype(object)})
    codes, items = coded(both, "item")
    won, lost = codes[: len(table)], codes[len(table) :]
    k = len(items)
    use = (person >= 0) & (won >= 0) & (lost >= 0) & (won != lost)
    wins = np.zeros((len(observers), k, k))
    np.add.at(wins, (person[use], won[use], lost[use]), 1.0)
    beats = wins > wins.transpose(0, 2, 1)
    most = (k**3 - (4 * k if k % 2 == 0 else k)) / 24
    rows: list[dict[str, Any]] = []
    for name, b in zip(observers, beats, strict=True):
        circular = judged = 0
        for i, j, l in itertools.combinations(range(k), 3):
            if (b[i, j] | b[j, i]) and (b[j, l] | b[l, j]) and (b[i, l] | b[l, i]):
                judged += 1
                circular += bool((b[i, j] and b[j, l] and b[l, i]) or (b[j, i] and b[l, j] and b[i, l]))
        row: dict[str, Any] = {"observer": name, "circular": circular, "judged": judged, "items": k}
        if judged == 0:
            row |= {"consistency": math.nan, "p": math.nan, "status": UNDEFINED, "note": "no triad was judged whole"}
        else:
            row["consistency"] = 1 - circular / most * math.comb(k, 3) / judged
            tested = k > 4 and judged == math.comb(k, 3)
            row["p"] = _random_choice_p(circular, k) if tested else math.nan
            row["status"] = OK if tested else UNDEFINED
            row["note"] = "" if tested else "no test: not every pair was judged, or fewer than 5 items"
        rows.append(row)
    columns = ["observer", "circular", "judged", "items", "consistency", "p"]
    method = "Circular triads by observer (Kendall & Babington Smith 1940), majority over repetitions."
    return result_table(rows, columns, method=method, n_subjects=len(observers))


def triads_by_block(kept: pd.DataFrame) -> pd.DataFrame:
    """`circular_triads` of each block (column ``block`` first) of comparison trials with ``winner`` and ``loser``.

    Blocks ask different questions, whose answers form no triad together. Blocks of fewer than three conditions and
    participants without a whole triad are left out.
    """
    tables = []
    for block, own in kept.groupby("block", sort=False):
        if len(set(own["winner"]) | set(own["loser"])) < 3:
            continue
        table = circular_triads(own, winner="winner", loser="loser", observer="participant")
        table.insert(0, "block", str(block))
        tables.append(table[table["judged"] > 0])
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def _random_choice_p(circular: int, k: int) -> float:
    """P(at most so many circular triads) if choices are random: counted over all outcomes up to 7 items (where the
    chi-square is far off: .022 for .117 of 5 items without any), else Kendall's chi-square, upper tail = consistent.
    """
    if k <= 7:
        counts = _triads_of_all_outcomes(k)
        return float(counts[: circular + 1].sum() / counts.sum())
    df = k * (k - 1) * (k - 2) / (k - 4) ** 2
    chi2 = 8 / (k - 4) * (math.comb(k, 3) / 4 - circular + 0.5) + df
    return p_chi2(max(chi2, 0.0), df)


@functools.cache
def _triads_of_all_outcomes(k: int) -> np.ndarray:
    """How many of the 2^(k(k-1)/2) outcomes of all pairs have 0, 1, ... circular triads (from the numbers of wins)."""
    pairs = list(itertools.combinations(range(k), 2))
    outcomes = np.arange(2 ** len(pairs), dtype=np.int32)
    wins = np.zeros((k, len(outcomes)), dtype=np.int8)
    for bit, (i, j) in enumerate(pairs):
        first = (outcomes >> bit & 1).astype(np.int8)
        wins[i] += first
        wins[j] += 1 - first
    transitive = (wins.astype(np.int16) * (wins - 1) // 2).sum(axis=0)
    return np.bincount(math.comb(k, 3) - transitive)


def screen_observers(table: pd.DataFrame, winner: str, loser: str, observer: str) -> pd.DataFrame:
    """Each observer's mean log-likelihood under the scale of the others; ``flagged`` where it is an outlier.

    The scale is fitted without the observer (Bradley-Terry). A distance above 1.5 interquartile ranges below the lower
    quartile is flagged (Perez-Ortiz & Mantiuk 2017): a reason to look, not to exclude.
    """
    found = count_comparisons("screen_observers", table, winner, loser, None, None, observer, None)
    counts, names = found.counts, found.observers
    pairs = found.pairs
    value = np.full(len(names), math.nan)
    for i in range(len(names)):
        rest = counts.sum(axis=0) - counts[i]
        # Half an answer each way keeps the others' scale finite.
        smooth = pairs.reweighted(rest[0] + 0.5, rest[1] + 0.5, 0 * rest[2])
        ability = solve(type(found)(found.items, smooth, [], counts, {}), "logit", False, False)["ability"]
        eta = ability[pairs.first] - ability[pairs.second]
        log_p = special.log_expit(eta) * counts[i, 0] + special.log_expit(-eta) * counts[i, 1]
        value[i] = log_p.sum() / counts[i].sum()
    finite = np.isfinite(value)
    lower, upper = np.quantile(value[finite], [0.25, 0.75]) if finite.any() else (math.nan, math.nan)
    rows: list[dict[str, Any]] = []
    for name, v in zip(names, value, strict=True):
        row: dict[str, Any] = {"observer": name, "mean_log_likelihood": float(v), "flagged": False}
        row["flagged"] = bool(v < lower - 1.5 * (upper - lower))
        row |= {"status": OK if math.isfinite(v) else UNDEFINED, "note": "" if math.isfinite(v) else "not comparable"}
        rows.append(row)
    method = "Leave-one-out log-likelihood of observers; flagged below the lower quartile by 1.5 interquartile ranges."
    columns = ["observer", "mean_log_likelihood", "flagged"]
    return result_table(rows, columns, method=method, n_subjects=len(names), dropped=found.dropped)
