"""The report's sections, each from the tables it stands on. No number is made here that the JSON does not hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

import analysis
from analysis import apa
from analysis import result_columns as shown
from analysis.blocks import Block, figure_block, number, section, table_block, words_block
from analysis.comparisons import POOLED, conditions_of, pair_table, win_matrix, with_winner
from analysis.exclusions import Exclusions
from analysis.gaze import Gaze
from analysis.plan import catch_table, likert_questions, within_factors
from analysis.planned_test import Plan, Result
from analysis.protocol_facts import replication_of
from analysis.registration import Comparison
from analysis.rows import rows_of_table
from analysis.sessions import Session, group_text
from analysis.timing import Timing, overrides
from analysis.within_means import cell_means

FEW_SCENES = 6


def participants_section(exclusions: Exclusions, sessions: Sequence[Session]) -> dict[str, Any]:
    """Who took part, who and what was left out, and why."""
    people = exclusions.participants.copy()
    groups = {session.participant: group_text(session.header) for session in sessions}
    people["group"] = [groups.get(person) for person in people["participant"]]
    blocks = [words_block(apa.reason_sentence(exclusions.reasons, people))]
    rules = "; ".join(f"{rule.name} (limit {rule.limit:g}, {rule.of})" for rule in exclusions.rules)
    blocks.append(
        words_block(f"Exclusion rules of the plan: {rules or 'none beyond practice, catch and unfinished trials'}.")
    )
    columns = (
        ("participant", "participant", "text"), ("group", "group", "text"), ("trials", "presentations", "int"),
        ("analysed", "analysed", "int"), ("left_out", "left out", "int"), ("reason", "excluded because", "text"),
    )  # fmt: skip
    empty = {name for name in ("group", "reason") if not people[name].fillna("").astype(str).any()}
    keep = tuple(column for column in columns if column[0] not in empty)
    blocks.append(table_block("participants", "Participants", people, keep))
    reasons = (("reason", "reason", "text"), ("trials", "presentations", "int"))
    blocks.append(table_block("reasons", "Presentations left out, by reason", exclusions.reasons, reasons))
    return section("participants", "Participants and exclusions", blocks, blind=True)


def timing_section(timing: Timing, onset: str, sessions: Sequence[Session]) -> dict[str, Any]:
    """Refresh timing of every session, the histogram of intervals, and the worst trial refresh by refresh."""
    total, missed = int(timing.sessions["refreshes"].sum()), int(timing.sessions["missed"].sum())
    share = missed / (total + missed) if total + missed else 0.0
    said = f"{missed:,} of {total + missed:,} refreshes were missed ({share:.3%}). {onset}"
    blocks = [words_block(said)]
    named = overrides(sessions)
    if named:
        lines = [f"Override by {one['participant']}: {one['check']}: {one['reason']}." for one in named]
        blocks.append(words_block(*dict.fromkeys(lines), kind="warning"))
    blocks.append(table_block("timing", "Refresh timing by session", timing.sessions, shown.SESSION))
    if timing.counts.sum():
        data = {"edges": timing.edges_ms, "counts": timing.counts, "marks": [timing.period_ms]}
        caption = (
            "Intervals between refreshes, all sessions (dashed: the nominal refresh; the last bar holds all later ones)"
        )
        blocks.append(figure_block("timing-histogram", caption, "histogram", {**data, "x_label": "interval (ms)"}))
        trace = {"x": timing.trace["refresh"], "y": timing.trace["interval_ms"], "mark": timing.period_ms}
        labels = {"x_label": "refresh of the trial", "y_label": "interval (ms)"}
        caption = f"The trial with the most missed refreshes: {timing.trace_of}"
        blocks.append(figure_block("timing-trace", caption, "trace", {**trace, **labels}))
    return section("timing", "Refresh timing", blocks, blind=True)


def manipulation_section(checks: pd.DataFrame, differences: pd.DataFrame, limit: float = 0.01) -> dict[str, Any]:
    """What each condition really was: light, rate, misses, gaze, cost."""
    blocks = [table_block("manipulation", "Conditions as shown", checks, shown.MANIPULATION)]
    far = differences[differences["difference"].abs() > limit] if len(differences) else differences
    if len(far):
        lines = [
            f"{row.scene}: {row.condition} is {row.difference:+.1%} from the scene's mean luminance."
            for row in rows_of_table(far)
        ]
        blocks.append(words_block("Compared clips differ in mean luminance by more than 1 %.", *lines, kind="warning"))
    return section("manipulation", "Manipulation checks", blocks, blind=True)


def quality_section(effects: pd.DataFrame, triads: pd.DataFrame, table: pd.DataFrame) -> dict[str, Any]:
    """Effects of side, interval, keys, time and the previous trial; circular triads; catch trials."""
    words = "Each effect is one number a participant, tested over participants; none of these should be there."
    blocks = [
        words_block(words),
        table_block("response-effects", "Effects that are not the pictures'", effects, shown.EFFECTS),
    ]
    if len(triads):
        columns = [(c, c.replace("_", " "), "f2" if triads[c].dtype.kind == "f" else "text") for c in triads.columns]
        columns = [column for column in columns if column[0] not in ("status", "note")]
        blocks.append(table_block("triads", "Circular triads (A over B, B over C, C over A)", triads, columns))
    else:
        blocks.append(words_block("Circular triads: none can arise (fewer than three conditions were all compared)."))
    catch = catch_table(table)
    columns = [
        ("participant", "participant", "text"),
        ("catch_trials", "catch trials", "int"),
        ("right", "right", "int"),
        ("share", "share", "pct0"),
    ]
    if len(catch):
        blocks.append(table_block("catch", "Catch trials", catch, columns))
    else:
        blocks.append(words_block("Catch trials: the study had none."))
    return section("quality", "Quality of the answers", blocks, blind=False)


def preference_section(kept: pd.DataFrame, checks: pd.DataFrame) -> tuple[dict[str, Any] | None, pd.DataFrame]:
    """Choices by pair, the win matrix, the Bradley-Terry scale, cost beside preference; and that scale as a table."""
    chosen = with_winner(kept)
    if chosen.empty:
        return None, pd.DataFrame()
    pairs = pair_table(chosen)
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
    blocks = [table_block("pairs", f"Choices by pair ({unit})", pairs, columns)]
    rows = [
        {"label": f"{r.a} over {r.b}", "share": r.share, "low": r.exact_low, "high": r.exact_high}
        for r in rows_of_table(pairs)
    ]
    label = "share of choices (95 % CI)"
    blocks.append(
        figure_block(
            "shares", "Preference by pair (dashed: chance)", "shares", {"rows": rows, "chance": 0.5, "x_label": label}
        )
    )
    matrix = {"conditions": conditions, "wins": wins, "answers": wins + wins.T}
    blocks.append(figure_block("win-matrix", f"Win matrix: row chosen over column ({POOLED})", "win_matrix", matrix))
    scale = analysis.bradley_terry(chosen, winner="winner", loser="loser", observer="participant")
    blocks.append(
        table_block(
            "scale",
            "Bradley-Terry scale (the first item is the origin)",
            scale,
            shown.RESULT_COLUMNS["bradley_terry"],
            str(scale.attrs.get("method", "")),
        )
    )
    points = [
        {"item": r.item, "estimate": _finite(r.ability), "low": _finite(r.ci_low), "high": _finite(r.ci_high)}
        for r in rows_of_table(scale)
    ]
    points.sort(key=lambda one: -(one["estimate"] if one["estimate"] is not None else np.inf))
    blocks.append(
        figure_block(
            "scale-plot",
            "Bradley-Terry scale with 95 % intervals",
            "scale",
            {"rows": points, "x_label": "ability (logit)"},
        )
    )
    front = _speed_preference(points, checks)
    if front:
        blocks.append(front)
    return section("preference", "Preference", blocks), scale


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _speed_preference(points: Sequence[Mapping[str, Any]], checks: pd.DataFrame) -> Block | None:
    """Cost beside preference where clips carry their cost."""
    cost = dict(zip(checks["condition"], checks["cost_ms"], strict=True))
    known = [one for one in points if one["estimate"] is not None and np.isfinite(cost.get(one["item"], np.nan))]
    rows = [{**one, "label": one["item"], "cost": float(cost[one["item"]])} for one in known]
    if len(rows) < 2:
        return None
    labels = {"x_label": "cost (ms a frame, when rendered)", "y_label": "preference (logit)"}
    return figure_block("speed-preference", "Cost beside preference", "speed_preference", {"rows": rows, **labels})


def likert_section(kept: pd.DataFrame, sessions: Sequence[Session]) -> dict[str, Any] | None:
    """Per question: diverging bars and means by condition, interaction with the second factor, the counts."""
    questions = likert_questions(sessions)
    factors = within_factors(kept, sessions)
    blocks: list[Block] = []
    for name, question in questions.items():
        dv = f"rating_{name}"
        own = kept[np.isfinite(kept[dv].astype(float))] if dv in kept else kept.iloc[:0]
        if len(own):
            blocks += _likert_blocks(own, name, dv, question, factors)
    return section("likert", "Ratings", blocks) if blocks else None


def _likert_blocks(
    own: pd.DataFrame, name: str, dv: str, question: Mapping[str, Any], factors: Sequence[str]
) -> list[Block]:
    low, high = int(question["low"]), int(question["high"])
    main = factors[0] if factors else "condition"
    summary = analysis.likert_summary(own, dv=dv, by=[main], scale=(low, high))
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
    order = own.groupby(main)[dv].mean().sort_values(ascending=False).index
    rows = [
        {
            "label": level,
            "n": int(counts.loc[level].sum()),
            "shares": (counts.loc[level] / counts.loc[level].sum()).to_numpy(dtype=float),
        }
        for level in order
    ]
    blocks: list[Block] = [words_block(f"“{question['text']}” ({name}; {', '.join(words) or f'{low} to {high}'}).")]
    alt = f"Ratings of {name} by {main}, stacked from {low} to {high}, the neutral answers split at zero"
    bars = {"rows": rows, "categories": [number(int(c), 0) for c in categories]}
    blocks.append(figure_block(f"likert-{name}", f"{name}: answers by {main}", "likert_bars", bars, alt))
    columns = [(main, main, "text"), ("n", "answers", "int"), ("mean", "mean", "f2"), ("sd", "SD", "f2")]
    columns += [("median", "median", "f1"), *((share, share, "pct0") for share in ("disagree", "neutral", "agree"))]
    means = cell_means(own, dv, [main])
    levels = [str(level) for level in order]
    means = means.set_index(means[main].astype(str)).loc[levels].reset_index(drop=True)
    series = [{"name": main, "mean": means["mean"], "low": means["ci_low"], "high": means["ci_high"]}]
    by_person = own.groupby(["participant", main], observed=True)[dv].mean().reset_index()
    people = [by_person.loc[by_person[main].astype(str) == level, dv].to_numpy(dtype=float) for level in levels]
    data = {
        "x": levels,
        "series": series,
        "people": people,
        "y_label": f"mean rating, {name}",
        "y_limits": [low - 0.2, high + 0.2],
    }
    n = own["participant"].nunique()
    caption = f"{name}: means with 95 % within-subject intervals (Cousineau-Morey), n = {n} participants (dots)"
    blocks.append(figure_block(f"means-{name}", caption, "means", data))
    for other in factors[1:3]:
        blocks.append(_interaction(own, name, dv, main, other, levels, (low, high)))
    blocks.append(table_block(f"summary-{name}", f"{name}: answers ({POOLED})", summary, columns))
    return blocks


def _interaction(
    own: pd.DataFrame, name: str, dv: str, main: str, other: str, levels: Sequence[str], scale: tuple[int, int]
) -> Block:
    cells = cell_means(own, dv, [main, other])
    keyed = cells.set_index([cells[main].astype(str), cells[other].astype(str)])
    series = []
    for level in sorted(cells[other].astype(str).unique()):
        rows = keyed.reindex([(one, level) for one in levels])
        series.append({"name": level, "mean": rows["mean"], "low": rows["ci_low"], "high": rows["ci_high"]})
    data = {
        "x": levels,
        "series": series,
        "lines": True,
        "y_label": f"mean rating, {name}",
        "y_limits": [scale[0] - 0.2, scale[1] + 0.2],
    }
    return figure_block(
        f"interaction-{name}-{other}", f"{name}: {main} by {other} (95 % within-subject intervals)", "means", data
    )


def plan_section(
    results: Sequence[Result], plan: Plan, kept: pd.DataFrame, registered: Comparison | None
) -> dict[str, Any]:
    """Every planned test in the plan's order, with the sentence to paste."""
    if plan.stated:
        said = f"The tests are those of the study's analysis plan (α = {plan.alpha:g}, adjustment {plan.adjust})."
    else:
        said = "The study states no analysis plan: these tests were derived from its design, and are exploratory."
    blocks: list[Block] = [words_block(said, kind="words" if plan.stated else "warning")]
    if registered is not None:
        differ = registered.lines
        said = "The tests marked exploratory, and all figures and tables outside this section, were not registered."
        if differ:
            blocks.append(words_block("Differs from the registration:", *differ, said, kind="warning"))
        else:
            blocks.append(words_block(f"As registered. {said}"))
    scenes = kept["scene"].nunique()
    if scenes < FEW_SCENES:
        blocks.append(
            words_block(f"{scenes} scene{'s' if scenes != 1 else ''}: the results hold for these scenes only.")
        )
    for place, result in enumerate(results):
        hypothesis = result.test.options.get("hypothesis")
        primary = result.test.options.get("primary", True)
        free = registered is not None and result.test.name not in registered.registered
        words = [result.test.test, *([] if primary else ["secondary"]), *(["exploratory"] if free else [])]
        head = f"{result.test.name} ({', '.join(words)})"
        note = " ".join(
            part for part in (result.method, *result.notes, f"Hypothesis: {hypothesis}" if hypothesis else "") if part
        )
        leading = [(name, name, "text") for name in result.test.separately_by]
        columns = [*leading, ("effect", "effect", "text"), *shown.RESULT_COLUMNS.get(result.test.test, ())]
        if result.test.test == "likert_summary" and "n" in result.table:
            columns = _summary_columns(result.table)
        blocks.append(table_block(f"test-{place + 1}", head, result.table, columns, note))
        blocks.append(words_block(*apa.sentences(result), kind="sentences"))
    return section(
        "tests",
        "Planned tests" if plan.stated else "Tests derived from the design",
        [b for b in blocks if b.get("paragraphs", True)],
    )


def design_blocks(sessions: Sequence[Session]) -> list[Block]:
    """What each condition's name stands for, and what the study repeats and changes of an earlier one."""
    rows = []
    for name, stated in sorted((sessions[0].header.get("conditions") or {}).items()):
        settings = ", ".join(f"{key} {value}" for key, value in (stated.get("params") or {}).items())
        rate = stated.get("rate_hz") or "the display's"
        rows.append({"condition": name, "label": stated.get("label") or "", "technique": stated.get("technique", ""),
                     "rate_hz": str(rate), "params": settings})  # fmt: skip
    blocks: list[Block] = []
    if rows:
        columns = [("condition", "condition", "text"), ("label", "label", "text"), ("technique", "technique", "text"),
                   ("rate_hz", "rate Hz", "text"), ("params", "parameters", "text")]  # fmt: skip
        blocks.append(table_block("conditions", "Conditions", pd.DataFrame(rows), columns))
    repeated = replication_of(sessions)
    if repeated:
        what = {"direct": "direct replication", "conceptual": "conceptual replication"}.get(
            str(repeated.get("kind")), "proposal"
        )
        deviations = pd.DataFrame(repeated.get("deviations") or [], columns=["paper", "here", "why"]).astype(str)
        columns = [("paper", "paper", "text"), ("here", "here", "text"), ("why", "why", "text")]
        blocks.append(
            table_block("replication", f"{what.capitalize()} of {repeated.get('of')}: deviations", deviations, columns)
        )
    return blocks


def _summary_columns(table: pd.DataFrame) -> list[tuple[str, str, str]]:
    """Likert summaries: the levels, then n, moments, and the share of every category."""
    forms = {"n": "int", "mean": "f2", "sd": "f2", "median": "f1"}
    shares = [c for c in table.columns if c.startswith("share_")]
    forms |= dict.fromkeys([*shares, "disagree", "neutral", "agree"], "pct0")
    names = [column for column in table.columns if column not in ("status", "note")]
    return [(name, name.removeprefix("share_").replace("-", "−"), forms.get(name, "text")) for name in names]


def gaze_section(gaze: Gaze | None) -> dict[str, Any] | None:
    """Gaze quality by participant and heat maps; None where no gaze was recorded."""
    if gaze is None:
        return None
    blocks = [table_block("gaze", "Gaze by participant", gaze.participants, shown.GAZE)]
    for place, one in enumerate(gaze.maps):
        rows, columns = np.nonzero(one.share > 0)
        cells = [[int(c), int(r), float(one.share[r, c])] for r, c in zip(rows, columns, strict=True)]
        data = {"edges_x": one.x_edges_dva, "edges_y": one.y_edges_dva, "cells": cells}
        caption = f"Where people looked, {one.name} ({one.samples:,} valid samples; cross: screen centre)"
        blocks.append(figure_block(f"gaze-map-{place}", caption, "heat_map", data))
    return section("gaze", "Gaze", blocks, blind=True)
