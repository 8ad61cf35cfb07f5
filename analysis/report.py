"""Session files to one report: the JSON structure first, then one self-contained HTML page rendered from it alone."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from markupsafe import Markup

from analysis import sections
from analysis.answer_sections import likert_section, preference_section
from analysis.blind import code_conditions
from analysis.blocks import plain, section, words_block, written
from analysis.comparisons import with_winner
from analysis.exclusions import Exclusions, apply_exclusions, exclusion_lock, rules_of
from analysis.gaze import gaze_report
from analysis.manipulation import luminance_differences, manipulation_checks
from analysis.matching import match_checks, unmatched_comparisons
from analysis.observers import triads_by_block
from analysis.plan import plan_of, run_plan, with_scenes
from analysis.plots import draw
from analysis.protocol_facts import title_of
from analysis.quality import response_effects
from analysis.registration import compare
from analysis.sessions import Session, combine, read_sessions
from analysis.timing import Timing, onset_statement, refresh_timing

FORMAT = 1


def analyse(
    data: Iterable[str | Path],
    blind: bool = False,
    progress: Callable[[str], object] = lambda step: None,
    registration: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Everything the report says, as JSON-ready data. ``progress`` is told each step as it begins.

    Keys: format, title, study, observer_kind, simulated, blind, glance (headline figures), sections (blocks as
    `analysis.blocks` makes them), exclusion_lock. ``registration``: what `studyapp freeze` wrote. Raises InputError
    for data that cannot be analysed together.
    """
    progress("reading sessions")
    sessions = read_sessions(data)
    lock_sessions = sessions
    if blind:
        sessions = code_conditions(sessions)
    exclusions = apply_exclusions(combine(sessions), rules_of(sessions), sessions)
    progress("refresh timing")
    timing = refresh_timing(sessions)
    progress("gaze")
    gaze = gaze_report(sessions, exclusions.table)
    checks = manipulation_checks(sessions, timing, gaze)
    kept = exclusions.kept
    found: list[dict[str, Any] | None] = []
    if blind:
        checks = checks[["condition", "shown", "missed", "missed_share", "gaze_error_dva"]]
        found = [sections.manipulation_section(checks, pd.DataFrame(), pd.DataFrame())]
    else:
        progress("tests")
        plan = with_scenes(plan_of(sessions, kept), kept)
        results = run_plan(plan, kept, lambda: progress("tests"))
        analysed = int((exclusions.participants["analysed"] > 0).sum())
        registered = compare(registration, sessions, analysed) if registration is not None else None
        preference = preference_section(kept, checks, plan.adaptive)
        ratings = likert_section(kept, sessions) if len(kept) else None
        said = f"No presentation is left to analyse: none of the {len(plan.tests)} planned tests could be made."
        planned = section("tests", "Planned tests", [words_block(said, kind="warning")])
        if len(kept):
            planned = sections.plan_section(results, plan, kept, registered)
        found = [preference, ratings, planned]
        shown = checks, luminance_differences(sessions), match_checks(sessions)
        found += [sections.manipulation_section(*shown, unmatched=unmatched_comparisons(sessions))]
        found += [
            sections.quality_section(
                response_effects(kept, sessions), triads_by_block(with_winner(kept)), exclusions.table
            )
        ]
    onset = onset_statement(sessions)
    first = sections.participants_section(exclusions, sessions)
    whole = [first, *found, sections.timing_section(timing, onset, sessions), sections.gaze_section(gaze)]
    made = [] if blind or not len(kept) else [result.method for result in results]
    whole.append(_methods(sessions, exclusions, timing, onset, blind, made))
    kind = sessions[0].observer_kind
    results_json = {
        "format": FORMAT,
        "title": title_of(sessions),
        "study": str(sessions[0].header.get("study", "")),
        "observer_kind": kind,
        "simulated": kind == "simulated",
        "blind": blind,
        "glance": _glance(exclusions, timing),
        "sections": [one for one in whole if one is not None],
        "exclusion_lock": exclusion_lock(exclusions, lock_sessions),
    }
    return json.loads(json.dumps(plain(results_json), allow_nan=False))


def _glance(exclusions: Exclusions, timing: Timing) -> list[dict[str, str]]:
    people = exclusions.participants
    included = int((people["analysed"] > 0).sum())
    total = int(timing.sessions["refreshes"].sum() + timing.sessions["missed"].sum())
    missed = int(timing.sessions["missed"].sum())
    return [
        {"label": "participants analysed", "value": f"{included}", "detail": f"of {len(people)}"},
        {
            "label": "presentations analysed",
            "value": f"{people['analysed'].sum():,}",
            "detail": f"of {people['trials'].sum():,}",
        },
        {"label": "missed refreshes", "value": f"{missed:,}", "detail": f"of {total:,}"},
    ]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _methods(
    sessions: Sequence[Session],
    exclusions: Exclusions,
    timing: Timing,
    onset: str,
    blind: bool,
    made: Sequence[str] = (),
) -> dict[str, Any]:
    """The methods paragraph, with versions, seeds and hashes; ``made``: the sentences of the tests' methods."""
    who = "simulated observers" if sessions[0].observer_kind == "simulated" else "participants"
    seeds = sorted({str(session.header.get("seed")) for session in sessions})
    hashes = sorted({str(session.header.get("protocol_sha256", "unknown")) for session in sessions})
    software = sorted(
        {f"{name} {number}" for s in sessions for name, number in (s.header.get("software") or {}).items()}
    )
    used = ", ".join(f"{name} {_version(name)}" for name in ("studyapp", "numpy", "scipy", "pandas", "statsmodels"))
    observers = sorted({str(session.header.get("observer", "unknown")) for session in sessions})
    rates = sorted({f"{rate:g}" for rate in timing.sessions["nominal_hz"].dropna()})
    models = any("ixed model" in one or "logit model" in one or "probit model" in one for one in made)
    unit = "repetitions are averaged within participants before any test"
    if models:
        unit = "repetitions are averaged within participants, or modelled with random effects of participants"
    resampled = any("resamples" in one for one in made)
    text = (
        f"{len(exclusions.participants)} {who} ({', '.join(observers)}) took part in {len(sessions)} session(s) on a "
        f"display at {' / '.join(rates) or 'an unknown rate of'} Hz. {onset} The unit of inference is the participant: "
        f"{unit}, and counts pooled over participants are marked as such. Intervals are at 95 % unless said."
        f"{' Bootstraps use seed 0 and 2,000 resamples.' if resampled else ''}"
    )
    lines = [
        text,
        f"Analysis: Python {platform.python_version()}, {used}.",
        f"Sessions: {', '.join(software) or 'software not recorded'}.",
    ]
    lines.append(f"Study seed(s): {', '.join(seeds)}. Protocol sha256: {', '.join(hashes)}.")
    if len(hashes) > 1:
        lines.append("The sessions were run under different versions of the protocol.")
    blocks = [words_block(*lines)]
    if not blind:
        blocks += sections.design_blocks(sessions)
    return section("methods", "Methods", blocks, blind=True)


def render_html(results: Mapping[str, Any]) -> str:
    """The whole page from the results' JSON: styles, figures and tables inline, nothing fetched."""
    simulated = bool(results["simulated"])
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    template = environment.from_string((Path(__file__).parent / "report.html.jinja").read_text(encoding="utf-8"))

    def figure(block: Mapping[str, Any]) -> Markup:
        return Markup(draw(block["plot"], block["data"], block["id"], block["alt"], simulated))

    def groups(blocks: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[Mapping[str, Any]]]]:
        return [(kind, list(members)) for kind, members in groupby(blocks, key=lambda block: block["type"])]

    return template.render(results=results, figure=figure, groups=groups, written=written)
