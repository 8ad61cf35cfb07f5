"""The report's sections, each from the tables it stands on. No number is made here that the JSON does not hold."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from analysis import apa
from analysis import result_columns as shown
from analysis.blocks import Block, figure_block, section, table_block, words_block
from analysis.comparisons import POOLED
from analysis.exclusions import Exclusions
from analysis.gaze import Gaze
from analysis.plan import catch_table
from analysis.plan_tests import FEW_SCENES
from analysis.planned_test import Plan, Result
from analysis.protocol_facts import replication_of
from analysis.recruitment import recruitment_words
from analysis.registration import Comparison
from analysis.rows import rows_of_table
from analysis.sessions import Session, group_text
from analysis.timing import Timing, overrides


def participants_section(exclusions: Exclusions, sessions: Sequence[Session]) -> dict[str, Any]:
    """Who took part, who and what was left out, and why."""
    people = exclusions.participants.copy()
    groups = {session.participant: group_text(session.header) for session in sessions}
    people["group"] = [groups.get(person) for person in people["participant"]]
    slots = {session.participant: str(session.slot) for session in sessions}
    people["slot"] = [slots.get(person, "") for person in people["participant"]]
    if (people["slot"] == people["participant"].astype(str)).all():
        people["slot"] = ""
    blocks = [words_block(apa.reason_sentence(exclusions.reasons, people))]
    blocks += [words_block(" ".join(said))] if (said := recruitment_words(sessions, exclusions)) else []
    rules = "; ".join(f"{rule.name} (limit {rule.limit:g}, {rule.of})" for rule in exclusions.rules)
    blocks.append(
        words_block(f"Exclusion rules of the plan: {rules or 'none beyond practice, catch and unfinished trials'}.")
    )
    columns = (
        ("participant", "participant", "text"), ("slot", "slot", "text"), ("group", "group", "text"),
        ("trials", "presentations", "int"), ("analysed", "analysed", "int"), ("left_out", "left out", "int"),
        ("reason", "excluded because", "text"),
    )  # fmt: skip
    empty = {name for name in ("slot", "group", "reason") if not people[name].fillna("").astype(str).any()}
    keep = tuple(column for column in columns if column[0] not in empty)
    blocks.append(table_block("participants", "Participants", people, keep))
    reasons = (("reason", "reason", "text"), ("trials", "presentations", "int"))
    if len(exclusions.reasons):
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
        if not missed:
            caption = f"No refresh was missed; as an example, {timing.trace_of}"
        blocks.append(figure_block("timing-trace", caption, "trace", {**trace, **labels}))
    return section("timing", "Refresh timing", blocks, blind=True)


def manipulation_section(
    checks: pd.DataFrame,
    differences: pd.DataFrame,
    matches: pd.DataFrame,
    limit: float = 0.01,
    unmatched: Sequence[tuple[str, list[str]]] = (),
) -> dict[str, Any]:
    """What each condition really was: light, rate, misses, gaze, cost; and whether what was to be equal is.
    ``unmatched``: blocks whose comparison nothing was to make equal, and the conditions concerned."""
    blocks = [table_block("manipulation", "Conditions as shown", checks, shown.MANIPULATION)]
    far = differences[differences["difference"].abs() > limit] if len(differences) else differences
    if len(far):
        lines = [
            f"{row.scene}: {row.condition} is {row.difference:+.1%} from the scene's mean luminance."
            for row in rows_of_table(far)
        ]
        blocks.append(words_block("Compared clips differ in mean luminance by more than 1 %.", *lines, kind="warning"))
    if len(matches):
        blocks.append(table_block("match", "What was to be made equal (match)", matches, shown.MATCH))
        off = [
            f"{row.condition}, {row.scene}: {row.measure} is {row.difference:+.1%} from its target."
            for row in rows_of_table(matches[matches["matched"] == "no"])
        ]
        if off:
            blocks.append(words_block("Not equal within the stated tolerance:", *off, kind="warning"))
    if unmatched:
        lines = [f"block {block}: {', '.join(conditions)}" for block, conditions in unmatched]
        said = "Unmatched comparison: nothing says that these conditions are equal in cost or in quality."
        blocks.append(words_block(said, *lines))
    return section("manipulation", "Manipulation checks", blocks, blind=True)


def quality_section(effects: pd.DataFrame, triads: pd.DataFrame, table: pd.DataFrame) -> dict[str, Any]:
    """Effects of side, interval, keys, time and the previous trial; circular triads; catch trials."""
    words = "Each effect is one number a participant, tested over participants; none of these should be there."
    blocks = [
        words_block(words),
        table_block("response-effects", "Effects that are not the pictures'", effects, shown.EFFECTS),
    ]
    if len(triads):
        forms = {"consistency": "f2", "p": "p", "circular": "int", "judged": "int", "items": "int"}
        columns = [(c, c.replace("_", " "), forms.get(c, "text")) for c in triads.columns]
        columns = [column for column in columns if column[0] not in ("status", "note")]
        said = "p: that choices at random have at most so many."
        caption = "Circular triads (A over B, B over C, C over A)"
        blocks.append(table_block("triads", caption, triads, columns, said))
    else:
        said = "no participant was shown three conditions all against each other (or chose each of two equally often)"
        blocks.append(words_block(f"Circular triads: none can arise, {said}."))
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
    else:
        said = f"{scenes} scenes: a random factor in the mixed models; other tests average over them"
        blocks.append(words_block(f"{said}, and each has such a model beside it where its effects do not name scenes."))
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
            head = f"{head}: answers, {POOLED}"
        elif result.test.test in _DIRECTIONS:
            note = f"{note} {_DIRECTIONS[result.test.test]}"
        blocks.append(table_block(f"test-{place + 1}-{_plain(result.test.name)}", head, result.table, columns, note))
        blocks.append(words_block(*apa.sentences(result), kind="sentences"))
    return section(
        "tests",
        "Planned tests" if plan.stated else "Tests derived from the design",
        [b for b in blocks if b.get("paragraphs", True)],
    )


_DIRECTIONS = {
    "posthoc_t": "A positive difference: a has the larger mean.",
    "tost": "A positive difference: a has the larger mean.",
    "wilcoxon": "A positive r: a is larger more often.",
    "bradley_terry": "Higher: chosen more often.",
    "thurstone": "Higher: chosen more often.",
}


def _plain(name: str) -> str:
    """A test's name as part of an id and of a file's name."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-") or "test"


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
        head = (
            f"{what.capitalize()} of {repeated.get('of')}" if what != "proposal" else f"Proposal: {repeated.get('of')}"
        )
        if len(deviations):
            blocks.append(table_block("replication", f"{head}: deviations", deviations, columns))
        else:
            blocks.append(words_block(f"{head}."))
    return blocks


def _summary_columns(table: pd.DataFrame) -> list[tuple[str, str, str]]:
    """Likert summaries: the levels, then n, moments, and the share of every category."""
    forms = {"n": "int", "mean": "f2", "sd": "f2", "median": "f1"}
    shares = [c for c in table.columns if c.startswith("share_")]
    forms |= dict.fromkeys([*shares, "disagree", "neutral", "agree"], "pct0")
    names = [column for column in table.columns if column not in ("status", "note")]
    heads = {"n": "answers", "sd": "SD"} | {name: name.removeprefix("share_").replace("-", "−") for name in shares}
    return [(name, heads.get(name, name), forms.get(name, "text")) for name in names]


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
