"""The report's sections of answers: preference (pairs, win matrix, scale, cost beside it) and ratings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

import analysis
from analysis import result_columns as shown
from analysis.blocks import Block, figure_block, number, section, table_block, words_block
from analysis.comparisons import (
    POOLED,
    adaptive_level,
    conditions_of,
    is_adaptive,
    pair_table,
    right_answers,
    win_matrix,
    with_winner,
)
from analysis.plan import PAIRS_CHOSEN, likert_questions, within_factors
from analysis.protocol_facts import level_order
from analysis.rows import rows_of_table
from analysis.sessions import Session
from analysis.within_means import cell_means


def preference_section(
    kept: pd.DataFrame, checks: pd.DataFrame, adaptive: Mapping[str, str] | None = None
) -> dict[str, Any] | None:
    """Per block of comparisons: choices by pair, the win matrix, the Bradley-Terry scale, cost beside preference; None
    where nothing was compared. Blocks ask different questions in different ways, so that their answers are not pooled.
    Of the ``adaptive`` blocks (`analysis.protocol_facts.adaptive_blocks`) a staircase's are counted and not tested.
    """
    chosen = with_winner(kept)
    if chosen.empty:
        return None
    names = list(dict.fromkeys(chosen["block"]))
    blocks: list[Block] = []
    for place, name in enumerate(names):
        own = chosen[chosen["block"] == name].reset_index(drop=True)
        if len(names) > 1:
            kinds = ", ".join(sorted(set(own["kind"].astype(str).str.replace("_", " "))))
            blocks.append(words_block(f"Block {name} ({kinds}), {own['participant'].nunique()} participants."))
        suffix = "" if place == 0 else f"-{name}"
        if is_adaptive(own).any():
            blocks += _staircase_blocks(own, suffix)
            continue
        if name in (adaptive or {}):
            blocks.append(words_block(PAIRS_CHOSEN, kind="warning"))
        blocks += _preference_blocks(own, checks, suffix)
    return section("preference", "Preference", blocks)


def _staircase_blocks(chosen: pd.DataFrame, suffix: str) -> list[Block]:
    """What a staircase or QUEST+ showed, and how often the standard was chosen: counts, and no test of them."""
    own = right_answers(chosen).assign(value=chosen["condition"].map(adaptive_level))
    counts = own.groupby(["condition", "value"])["right"].agg(["count", "sum"]).reset_index().sort_values("value")
    people = own.groupby("condition")["participant"].nunique()
    table = pd.DataFrame({
        "value": counts["value"], "participants": counts["condition"].map(people), "answers": counts["count"],
        "right": counts["sum"].astype(int), "share": counts["sum"] / counts["count"],
    })  # fmt: skip
    said = "A staircase or QUEST+ chose each trial by the answers before: it sets the share of right answers (choices "
    said += "of the standard) itself, and no test of pairs is made. The threshold is that of the psychometric function."
    columns = [("value", "value", "g"), ("participants", "participants", "int"), ("answers", "answers", "int"),
               ("right", "right", "int"), ("share", "share right", "pct0")]  # fmt: skip
    caption = f"Answers by value ({POOLED})"
    return [words_block(said), table_block(f"staircase{suffix}", caption, table, columns)]


def _preference_blocks(chosen: pd.DataFrame, checks: pd.DataFrame, suffix: str) -> list[Block]:
    """One block's tables and figures; ``suffix`` makes their ids unique. Pairs stand in the order of p."""
    pairs = pair_table(chosen).sort_values(["log10_p", "share"], ascending=[True, False], kind="stable")
    pairs["pooled"] = [f"{row.pooled_k} of {row.pooled_n} ({row.pooled_share:.0%})" for row in rows_of_table(pairs)]
    conditions = conditions_of(chosen)
    wins = win_matrix(chosen, conditions)
    unit, hidden = "the participant is the unit; answers pooled over participants are description only", {"unit"}
    if (pairs["unit"] != "participants").all():
        unit = "one answer a participant, exact binomial test with Clopper-Pearson intervals"
        hidden = {"unit", "pooled"}
    elif (pairs["unit"] != "participants").any():
        hidden = set()
    columns = tuple(column for column in shown.PAIRS if column[0] not in hidden)
    note = "In the order of p; p Holm is adjusted over these pairs." if len(pairs) > 1 else ""
    blocks = [table_block(f"pairs{suffix}", f"Choices by pair ({unit})", pairs, columns, note)]
    rows = [
        {"label": f"{r.a} over {r.b}", "share": r.share, "low": r.exact_low, "high": r.exact_high}
        for r in rows_of_table(pairs)
    ]
    data = {"rows": rows, "chance": 0.5, "x_label": "share of choices (95 % CI)"}
    blocks.append(figure_block(f"shares{suffix}", "Preference by pair (dashed: chance)", "shares", data))
    matrix = {"conditions": conditions, "wins": wins, "answers": wins + wins.T}
    caption = f"Win matrix: row chosen over column ({POOLED})"
    blocks.append(figure_block(f"win-matrix{suffix}", caption, "win_matrix", matrix))
    scale = analysis.bradley_terry(chosen, winner="winner", loser="loser", observer="participant")
    method = f"{scale.attrs.get('method', '')} Higher: chosen more often."
    caption = f"Bradley-Terry scale (origin: {scale['item'].iloc[0]})" if "item" in scale else "Bradley-Terry scale"
    blocks.append(table_block(f"scale{suffix}", caption, scale, shown.RESULT_COLUMNS["bradley_terry"], method))
    points = [
        {"item": r.item, "estimate": _finite(r.ability), "low": _finite(r.ci_low), "high": _finite(r.ci_high)}
        for r in rows_of_table(scale)
    ]
    points.sort(key=lambda one: -(one["estimate"] if one["estimate"] is not None else np.inf))
    data = {"rows": points, "x_label": "ability (logit)"}
    blocks.append(figure_block(f"scale-plot{suffix}", "Bradley-Terry scale with 95 % intervals", "scale", data))
    front = _speed_preference(points, checks, suffix)
    return [*blocks, front] if front else blocks


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _speed_preference(points: Sequence[Mapping[str, Any]], checks: pd.DataFrame, suffix: str) -> Block | None:
    """Cost beside preference where clips carry their cost."""
    cost = dict(zip(checks["condition"], checks["cost_ms"], strict=True))
    known = [one for one in points if one["estimate"] is not None and np.isfinite(cost.get(one["item"], np.nan))]
    rows = [{**one, "label": one["item"], "cost": float(cost[one["item"]])} for one in known]
    if len(rows) < 2:
        return None
    labels = {"x_label": "cost (ms a frame, when rendered)", "y_label": "preference (logit)"}
    data = {"rows": rows, **labels}
    return figure_block(f"speed-preference{suffix}", "Cost beside preference", "speed_preference", data)


def likert_section(kept: pd.DataFrame, sessions: Sequence[Session]) -> dict[str, Any] | None:
    """Per question: diverging bars and means by condition, interaction with the second factor, the counts.

    A factor's levels stand as the protocol lists them, else by their means. A question that several blocks ask is shown
    block by block.
    """
    questions = likert_questions(sessions)
    factors = within_factors(kept, sessions)
    blocks: list[Block] = []
    for name, question in questions.items():
        dv = f"rating_{name}"
        own = kept[np.isfinite(kept[dv].astype(float))] if dv in kept else kept.iloc[:0]
        if own.empty:
            blocks.append(words_block(f"“{question['text']}” ({name}): no analysed presentation has an answer to it."))
        names = list(dict.fromkeys(own["block"]))
        for place, block in enumerate(names):
            rated = own[own["block"] == block].reset_index(drop=True)
            shown_factors = within_factors(rated, sessions)[:3] if len(names) > 1 else factors[:3]
            levels = {factor: _levels(rated, dv, factor, sessions) for factor in shown_factors or ["condition"]}
            title, suffix = (f"{name}, block {block}", f"-{block}") if len(names) > 1 else (name, "")
            blocks += _likert_blocks(rated, title, f"{name}{suffix if place else ''}", dv, question, levels)
    return section("likert", "Ratings", blocks) if blocks else None


def _levels(own: pd.DataFrame, dv: str, factor: str, sessions: Sequence[Session]) -> list[str]:
    found = own.groupby(own[factor].astype(str))[dv].mean().sort_values(ascending=False, kind="stable").index.tolist()
    listed = level_order(sessions, factor)
    return [level for level in listed if level in found] if set(found) <= set(listed) else found


def _likert_blocks(
    own: pd.DataFrame, name: str, key: str, dv: str, question: Mapping[str, Any], levels_of: Mapping[str, Sequence[str]]
) -> list[Block]:
    """``name`` in words, ``key`` in ids; ``levels_of``: the levels of the first factors in the order in which they are
    shown, the main one first."""
    low, high = int(question["low"]), int(question["high"])
    main, *others = levels_of
    levels = list(levels_of[main])
    own = own.assign(**{main: own[main].astype(str)})
    summary = analysis.likert_summary(own, dv=dv, by=[main], scale=(low, high))
    summary = summary.sort_values(main, key=lambda column: column.map(levels.index), kind="stable")
    categories = [str(point) for point in range(low, high + 1)]
    words = [
        f"{number(point, 0)} {question['labels'][str(point)]}"
        for point in range(low, high + 1)
        if str(point) in question.get("labels", {})
    ]
    counts = (
        own.groupby([main, dv], observed=True)
        .size()
        .unstack(fill_value=0)
        .reindex(columns=range(low, high + 1), fill_value=0)
    )
    shares = counts.div(counts.sum(axis=1), axis=0)
    rows = [
        {"label": one, "n": int(counts.loc[one].to_numpy().sum()), "shares": shares.loc[one].to_numpy()}
        for one in levels
    ]
    blocks: list[Block] = [
        words_block(f"“{question['text']}” ({name}; {', '.join(words) or f'{number(low, 0)} to {number(high, 0)}'}).")
    ]
    alt = f"Ratings of {name} by {main}, stacked from {low} to {high}, the neutral answers split at zero"
    bars = {"rows": rows, "categories": [number(int(c), 0) for c in categories]}
    blocks.append(
        figure_block(
            f"likert-{key}", f"{name}: all answers by {main}, neutral ones split at zero", "likert_bars", bars, alt
        )
    )
    columns = [(main, main, "text"), ("n", "answers", "int"), ("mean", "mean", "f2"), ("sd", "SD", "f2")]
    columns += [("median", "median", "f1"), *((share, share, "pct0") for share in ("disagree", "neutral", "agree"))]
    means = cell_means(own, dv, [main])
    means = means.set_index(means[main].astype(str)).loc[levels].reset_index(drop=True)
    series = [{"name": main, "mean": means["mean"], "low": means["ci_low"], "high": means["ci_high"]}]
    by_person = own.groupby(["participant", main], observed=True)[dv].mean().reset_index()
    people = [by_person.loc[by_person[main].astype(str) == level, dv].to_numpy(dtype=float) for level in levels]
    data = {
        "x": levels,
        "series": series,
        "people": people,
        "y_label": f"mean rating, {name}",
        "y_limits": _limits(means, low, high),
    }
    n = own["participant"].nunique()
    caption = f"{name}: means with 95 % within-subject intervals (Cousineau-Morey), n = {n} participants (dots)"
    if n < 2:
        caption = f"{name}: means of one participant, without intervals"
    blocks.append(figure_block(f"means-{key}", caption, "means", data))
    for other in others:
        blocks.append(_interaction(own, name, key, dv, main, other, levels_of, (low, high)))
    blocks.append(table_block(f"summary-{key}", f"{name}: answers ({POOLED})", summary, columns))
    return blocks


def _limits(means: pd.DataFrame, low: int, high: int) -> list[float]:
    """The whole scale, and what of the intervals lies beyond its ends: none is cut off."""
    return [min(low, means["ci_low"].min()) - 0.2, max(high, means["ci_high"].max()) + 0.2]


def _interaction(
    own: pd.DataFrame, name: str, key: str, dv: str, main: str, other: str, levels_of: Mapping[str, Sequence[str]],
    scale: tuple[int, int],
) -> Block:  # fmt: skip
    cells = cell_means(own, dv, [main, other])
    keyed = cells.set_index([cells[main].astype(str), cells[other].astype(str)])
    series = []
    for level in levels_of[other]:
        rows = keyed.reindex([(one, level) for one in levels_of[main]])
        series.append({"name": level, "mean": rows["mean"], "low": rows["ci_low"], "high": rows["ci_high"]})
    data = {
        "x": list(levels_of[main]),
        "series": series,
        "lines": True,
        "y_label": f"mean rating, {name}",
        "y_limits": _limits(cells, *scale),
    }
    return figure_block(
        f"interaction-{key}-{other}", f"{name}: {main} by {other} (95 % within-subject intervals)", "means", data
    )
