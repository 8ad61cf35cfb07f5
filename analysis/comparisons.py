"""Comparison trials: who beat whom, by pair, with the participant as the unit; pooled numbers under their own name."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pandas as pd

from analysis import adjust_p, binomial_choice
from analysis.rows import rows_of_table
from protocols.study import varied_value
from protocols.trial import is_right

POOLED = "pooled, not for inference"


def with_winner(table: pd.DataFrame, question: str | None = None) -> pd.DataFrame:
    """The trials in which one of two candidates was chosen, with ``winner`` and ``loser`` for ``question`` (None: the
    trial's first choice)."""
    if question is None or f"response_{question}" not in table:
        return table[table["winner"].notna()].reset_index(drop=True)
    response = table[f"response_{question}"]
    pairs = [str(condition).split("|") for condition in table["condition"]]
    won = [len(pair) == 2 and answer in pair for pair, answer in zip(pairs, response, strict=True)]
    chosen = table[np.array(won, dtype=bool)].copy() if len(table) else table.copy()
    kept = [(pair, answer) for pair, answer, good in zip(pairs, response, won, strict=True) if good]
    chosen["winner"] = [answer for _, answer in kept]
    chosen["loser"] = [pair[1] if pair[0] == answer else pair[0] for pair, answer in kept]
    return chosen.reset_index(drop=True)


def adaptive_level(conditions: str) -> float:
    """The value at which an adaptive trial's test stood ('full|less@400' -> 400); nan for other trials."""
    members = str(conditions).split("|")
    values = [value for value in map(varied_value, members) if value is not None]
    return values[0] if len(members) == 2 and len(values) == 1 else np.nan


def is_varied(condition: str) -> bool:
    """Whether a condition is an adaptive block's test at one of its values."""
    return varied_value(condition) is not None


def is_adaptive(table: pd.DataFrame) -> pd.Series:
    """Which trials a staircase or QUEST+ chose: those whose test stands at one of its values."""
    return table["condition"].map(adaptive_level).notna()


def right_answers(table: pd.DataFrame) -> pd.DataFrame:
    """The trials with a right answer, ``right`` 0/1: a known answer, or in adaptive trials the standard's choice."""
    known = table["correct"].notna()
    adaptive = ~known & table["winner"].notna() & is_adaptive(table)
    own = table[known | adaptive].copy()
    right = [
        is_right(str(one.correct), str(one.side), str(one.response)) if known[i] else not is_varied(str(one.winner))
        for i, one in zip(own.index, rows_of_table(own), strict=True)
    ]
    own["right"] = np.array(right, dtype=float)
    return own


def conditions_of(comparisons: pd.DataFrame) -> list[str]:
    """Every condition that was compared, in alphabetical order."""
    return sorted(set(comparisons["winner"]) | set(comparisons["loser"]))


def win_matrix(comparisons: pd.DataFrame, conditions: Sequence[str]) -> np.ndarray:
    """(C, C) int: how often the row's condition was chosen over the column's, all answers pooled."""
    place = {name: i for i, name in enumerate(conditions)}
    wins = np.zeros((len(conditions), len(conditions)), dtype=np.int64)
    for winner, loser in zip(comparisons["winner"], comparisons["loser"], strict=True):
        wins[place[winner], place[loser]] += 1
    return wins


def pair_table(comparisons: pd.DataFrame, p0: float = 0.5) -> pd.DataFrame:
    """One row a pair of conditions: a, b and `CHOICE_COLUMNS`, with p_adjusted (Holm over all pairs) after p.

    ``a`` is the one chosen more often. Where every participant gave one answer, k of n answers is tested (exact
    binomial, Clopper-Pearson); else the participant is the unit (`analysis.binomial_choice` on the table), and the
    pooled counts are given as description only.
    """
    rows = []
    pairs = combinations(conditions_of(comparisons), 2)
    for one, other in pairs:
        both = comparisons["winner"].isin([one, other]) & comparisons["loser"].isin([one, other])
        own = comparisons[both]
        if own.empty:
            continue
        first = int((own["winner"] == one).sum())
        a, b = (one, other) if 2 * first >= len(own) else (other, one)
        rows.append({"a": a, "b": b, **choice_row(own.assign(chosen=(own["winner"] == a).astype(float)), p0)})
    columns = ["a", "b", *CHOICE_COLUMNS]
    table = pd.DataFrame(rows, columns=columns)
    table.insert(columns.index("p") + 1, "p_adjusted", adjust_p(table["p"].to_numpy(dtype=float), "holm"))
    return table


CHOICE_COLUMNS = [
    "unit", "participants", "answers", "k", "n", "share", "t", "df", "p", "log10_p", "exact_low", "exact_high",
    "pooled_k", "pooled_n", "pooled_share", "status", "note",
]  # fmt: skip


def choice_row(own: pd.DataFrame, p0: float, subject: str = "participant") -> dict[str, object]:
    """`CHOICE_COLUMNS` for answers coded 0/1 in ``chosen``."""
    answers = own.groupby(subject, sort=False)["chosen"].count()
    k, n = int(own["chosen"].sum()), len(own)
    single = bool((answers == 1).all())
    if single:
        made = binomial_choice(k, n, p0=p0)
    else:
        made = binomial_choice(own, choice="chosen", observer=subject, p0=p0)
    found = made.iloc[0]
    return {
        "unit": "one answer a participant" if single else "participants",
        "participants": len(answers),
        "answers": n,
        "t": made.attrs.get("t", np.nan),
        "df": made.attrs.get("df", np.nan),
        **{name: found[name] for name in ("k", "n", "share", "p", "log10_p", "exact_low", "exact_high")},
        "pooled_k": k,
        "pooled_n": n,
        "pooled_share": k / n,
        "status": found["status"],
        "note": found["note"],
    }
