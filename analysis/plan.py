"""The protocol's analysis plan decides: each planned test on its rows, and a derived plan where a study states none.

Every planned test appears in the results. What cannot be computed stands there with its reason and status.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

import analysis
from analysis.comparisons import is_adaptive, right_answers, with_winner
from analysis.exclusions import catch_results
from analysis.plan_tests import FEW_SCENES, RUNNERS
from analysis.planned_test import Plan, Result, Test, adjustment_name, column_of, reported_p
from analysis.protocol_facts import adaptive_blocks, level_order
from analysis.rows import rows_of_table
from analysis.sessions import Session
from stimuli.errors import InputError, problem

_NAMED = ("name", "test", "dv", "within", "between", "subject", "where", "separately_by", "effects")


def plan_of(sessions: Sequence[Session], kept: pd.DataFrame) -> Plan:
    """The plan stated in the sessions' headers; where none states tests, the one that `derived_tests` gives.

    Raises InputError where the sessions state different plans.
    """
    plans = {
        repr(session.header.get("analysis_plan") or {}): session.header.get("analysis_plan") for session in sessions
    }
    if len(plans) > 1:
        raise InputError(problem("sessions", "analysis plan", f"{len(plans)} versions", "one for all sessions"))
    stated = next(iter(plans.values()), None) or {}
    scales = {name: (int(one["low"]), int(one["high"])) for name, one in likert_questions(sessions).items()}
    plan = parse_plan(stated, scales)
    separate = {name for test in plan.tests for name in test.separately_by}
    levels = {name: level_order(sessions, name) for name in separate}
    plan = replace(plan, levels=levels, adaptive=adaptive_blocks(sessions))
    return plan if plan.stated else replace(plan, tests=derived_tests(kept, sessions))


def parse_plan(stated: Mapping[str, Any], scales: Mapping[str, tuple[int, int]]) -> Plan:
    """The plan as a session's header or a study stores it; ``stated`` is False where it names no test."""
    tests = tuple(_test(one, index) for index, one in enumerate(stated.get("tests") or []))
    return Plan(tests, float(stated.get("alpha", 0.05)), str(stated.get("adjust", "holm")), bool(tests), scales)


def _test(given: Mapping[str, Any], index: int) -> Test:
    for key in ("name", "test"):
        if not given.get(key):
            raise InputError(problem(f"analysis_plan.tests[{index}]", key, "nothing", f"the test's {key}"))
    options = {key: value for key, value in given.items() if key not in _NAMED and value is not None}
    listed: dict[str, Any] = {
        key: tuple(given.get(key) or ()) for key in ("within", "between", "separately_by", "effects")
    }
    where = {column: [str(level) for level in levels] for column, levels in (given.get("where") or {}).items()}
    return Test(
        name=str(given["name"]),
        test=str(given["test"]),
        dv=str(given.get("dv") or "rating"),
        subject=str(given.get("subject") or "participant"),
        where=where,
        options=options,
        **listed,
    )


def likert_questions(sessions: Sequence[Session]) -> dict[str, dict[str, Any]]:
    """Likert questions by name, as the plan words them: text, low, high, labels."""
    found: dict[str, dict[str, Any]] = {}
    for session in sessions:
        for trial in session.header.get("plan") or []:
            for question in trial.get("questions", ()):
                if question["kind"] == "likert":
                    found.setdefault(question["name"], question)
    return found


def within_factors(kept: pd.DataFrame, sessions: Sequence[Session]) -> list[str]:
    """The design's factors of the rated trials: those with several levels that are crossed within participants;
    condition (and scene) where the design names none."""
    rated = kept[np.isfinite(kept["rating"].astype(float))]
    named: list[str] = []
    for session in sessions:
        for trial in session.header.get("plan") or []:
            named += [name for name in trial.get("factors", {}) if name not in named]
    usable = [name for name in named if name in rated and _crossed(rated, name)]
    if not _determined(rated, usable):
        usable = [name for name in ("condition",) if _crossed(rated, name)] + usable
    # the factors that make up the condition come first, the scene after them
    usable.sort(key=lambda name: (name == "scene", not _determined(rated, [name])))
    if usable and "scene" not in usable and _crossed(rated, "scene") and not _determined(rated, usable, "scene"):
        usable.append("scene")
    return usable


def _crossed(rated: pd.DataFrame, name: str) -> bool:
    levels = rated.groupby("participant", sort=False)[name].nunique()
    return name not in ("repetition",) and bool(len(levels)) and bool((levels >= 2).all())


def _determined(rated: pd.DataFrame, factors: Sequence[str], column: str = "condition") -> bool:
    """True where the levels of ``factors`` say what ``column`` is."""
    if not factors:
        return False
    return bool((rated.groupby(list(factors), observed=True, sort=False)[column].nunique() <= 1).all())


def derived_tests(kept: pd.DataFrame, sessions: Sequence[Session]) -> tuple[Test, ...]:
    """What a design without a plan is given: per block of choices Bradley-Terry, or a psychometric function where a
    staircase or QUEST+ chose the trials; per Likert question the repeated-measures ANOVA with the rank tests beside it,
    and Holm's post-hoc tests of the first factor."""
    tests: list[Test] = []
    compared = list(dict.fromkeys(kept.loc[kept["winner"].notna(), "block"]))
    adaptive = adaptive_blocks(sessions)
    for block in compared:
        only = {"block": block} if len(compared) > 1 else {}
        name = f"preference: {block}" if only else "preference"
        if adaptive.get(block, "active_pairs") != "active_pairs":
            tests.append(Test(f"threshold: {block}", "psychometric", dv="correct", options={"block": block}))
        else:
            tests.append(Test(name, "bradley_terry", dv="choice", options=only))
    factors = within_factors(kept, sessions)
    for question in likert_questions(sessions):
        if not factors or not np.isfinite(kept.get(f"rating_{question}", pd.Series(dtype=float)).astype(float)).any():
            continue
        own: Mapping[str, Any] = {"question": question}
        tests.append(Test(f"{question}: ANOVA", "rm_anova", within=tuple(factors), options=own))
        tests.append(Test(f"{question}: aligned ranks", "aligned_rank_anova", within=tuple(factors), options=own))
        tests.append(Test(f"{question}: Friedman, {factors[0]}", "friedman", within=(factors[0],), options=own))
        tests.append(Test(f"{question}: post hoc, {factors[0]}", "posthoc_t", within=(factors[0],), options=own))
    return tuple(tests)


def with_scenes(plan: Plan, kept: pd.DataFrame) -> Plan:
    """The plan, with a mixed model that has scenes as a random factor after each test that averages over enough of
    them (``FEW_SCENES`` or more): repeated-measures ANOVA without scene among its factors, and binomial_choice."""
    tests: list[Test] = []
    for test in plan.tests:
        tests.append(test)
        if test.test not in ("rm_anova", "binomial_choice") or {"scene"} & {*test.within, *test.where}:
            continue
        try:
            scenes = rows_of(kept, test)[0]["scene"].nunique()
        except InputError:
            continue
        if scenes >= FEW_SCENES and "scene" not in test.separately_by and not test.between:
            model = "linear_mixed" if test.test == "rm_anova" else "binomial_mixed"
            options = {**test.options, "scenes_random": True, "primary": False, "hypothesis": None, "family": None}
            tests.append(replace(test, name=f"{test.name}, scenes random", test=model, options=options, effects=()))
    return replace(plan, tests=tuple(tests))


def rows_of(kept: pd.DataFrame, test: Test) -> tuple[pd.DataFrame, str]:
    """The test's rows and the name of its dependent column. Raises InputError where a named column does not exist."""
    own = kept
    question = test.options.get("question")
    if test.options.get("block") is not None:
        own = own[own["block"] == test.options["block"]]
    for column, levels in test.where.items():
        own = own[column_of(own, column, test).astype(str).isin(levels)]
    if test.dv in ("choice", "correct"):
        return (with_winner(own, question), "chosen") if test.dv == "choice" else (right_answers(own), "right")
    dv = f"{test.dv}_{question}" if question else test.dv
    values = column_of(own, dv, test).astype(float)
    return own[np.isfinite(values)].reset_index(drop=True), dv


def run_plan(plan: Plan, kept: pd.DataFrame, progress: Callable[[], object] = lambda: None) -> list[Result]:
    """Every test of the plan in its order, one result each (``separately_by``: its levels as leading columns). Families
    are adjusted together (column ``p_family``)."""
    results: list[Result] = []
    for test in plan.tests:
        if test.test not in RUNNERS:
            raise InputError(
                problem(f"analysis plan: {test.name}", "unknown test", repr(test.test), " | ".join(RUNNERS))
            )
        results.append(_run_separately(test, kept, plan) if test.separately_by else _run(test, kept, plan))
        progress()
    return _adjust_families(results, plan)


def _run_separately(test: Test, kept: pd.DataFrame, plan: Plan) -> Result:
    """The test once for each combination of levels of ``separately_by`` among its rows, in one table."""
    columns = list(test.separately_by)
    try:
        own, _ = rows_of(kept, test)
        levels = pd.concat([column_of(own, name, test) for name in columns], axis=1).dropna().astype(str)
    except InputError as error:
        return _without(test, "undefined", str(error))
    places = {name: {level: i for i, level in enumerate(plan.levels.get(name, ()))} for name in columns}
    levels = levels.drop_duplicates().sort_values(columns)
    found = sorted(
        rows_of_table(levels),
        key=lambda row: [places[name].get(level, len(places[name])) for name, level in zip(columns, row, strict=True)],
    )
    if not found:
        return _without(test, "undefined", "no analysed trial answers this test")
    parts, notes = [], []
    for combination in found:
        where = {**test.where, **{column: [level] for column, level in zip(columns, combination, strict=True)}}
        result = _run(replace(test, where=where), kept, plan)
        # a test by condition returns the condition itself: it is not named twice
        kept_columns = [column for column in result.table.columns if column not in columns]
        table = result.table[kept_columns]
        for place, (column, level) in enumerate(zip(columns, combination, strict=True)):
            table.insert(place, column, level)
        parts.append((result, table))
        notes += [f"{', '.join(combination)}: {note}" for note in result.notes]
    said = list(dict.fromkeys(result.method for result, _ in parts if result.method))
    if len(said) > 1:  # where levels differ (in who answered), each has its own sentence
        said = [f"{', '.join(one)}: {part.method}" for one, (part, _) in zip(found, parts, strict=True) if part.method]
    joined = pd.concat([table for _, table in parts], ignore_index=True)
    others = [one for one in columns if one != "condition"]
    if "condition" in joined and any(joined["condition"].astype(str).equals(joined[one]) for one in others):
        joined = joined.drop(columns="condition")  # by each condition under another name
    adjust = next((part.table.attrs["adjust"] for part, _ in parts if "adjust" in part.table.attrs), None)
    joined.attrs.update({"adjust": adjust} if adjust else {})
    return Result(test, joined, " ".join(said), max(result.n_subjects for result, _ in parts), tuple(notes))


def _run(test: Test, kept: pd.DataFrame, plan: Plan) -> Result:
    try:
        own, dv = rows_of(kept, test)
        if own.empty:
            return _without(test, "undefined", "no analysed trial answers this test")
        if test.test != "psychometric" and test.dv in ("choice", "correct") and is_adaptive(own).any():
            return _without(test, "undefined", SET_BY_THE_PROCEDURE)
        table = RUNNERS[test.test](own, dv, test, plan)
    except InputError as error:
        return _without(test, "undefined", str(error))
    method = str(table.attrs.get("method", ""))
    n = int(table.attrs.get("n_subjects", own[test.subject].nunique()))
    notes = [f"left out: {who}: {why}" for who, why in dict(table.attrs.get("dropped") or {}).items()]
    notes += [str(note) for note in table.attrs.get("notes") or []]
    if test.dv == "choice" and test.test not in _SCALES and {*own["block"]} & {*plan.adaptive}:
        notes.append(PAIRS_CHOSEN)
    return Result(test, table, method, n, tuple(notes))


SET_BY_THE_PROCEDURE = (
    "a staircase or QUEST+ chose these trials by the answers before, and so sets the shares itself: "
    "plan a psychometric function, or name a block of a fixed design"
)
PAIRS_CHOSEN = (
    "The pairs of this block were chosen by the answers before (active_pairs): numbers of answers depend on them, and "
    "a test of one pair does not keep its level exactly; the scale's likelihood takes all answers in."
)
_SCALES = ("bradley_terry", "thurstone")


def _without(test: Test, status: str, note: str) -> Result:
    table = pd.DataFrame([{"effect": test.name, "status": status, "note": note}])
    return Result(test, table, "", 0, ())


def _adjust_families(results: Sequence[Result], plan: Plan) -> list[Result]:
    """Tests of one family have their p values adjusted together: column ``p_family``, and a note with its size."""
    families: dict[str, list[tuple[int, int]]] = {}
    for place, result in enumerate(results):
        family = result.test.options.get("family")
        if family and "p" in result.table:
            families.setdefault(str(family), []).extend((place, row) for row in _family_rows(result))
    adjusted = list(results)
    for family, members in families.items():
        p = [reported_p(results[place].table.iloc[row].to_dict()) for place, row in members]
        size = int(np.isfinite(p).sum())
        method = next(
            (str(results[i].test.options["adjust"]) for i, _ in members if results[i].test.options.get("adjust")),
            plan.adjust,
        )
        p_family = np.asarray(analysis.adjust_p(p, method))
        for place in dict.fromkeys(place for place, _ in members):
            result = adjusted[place]
            table = result.table.copy()
            table.attrs |= {"family_size": size, "family_adjust": method}
            table["p_family"] = np.nan
            for (where, row), value in zip(members, p_family, strict=True):
                if where == place:
                    table.loc[table.index[row], "p_family"] = float(value)
            note = f"p_family: {adjustment_name(method)} over the {size} tests of family '{family}'"
            note += " (Greenhouse-Geisser p where it corrects)." if "p_gg" in table else "."
            adjusted[place] = Result(result.test, table, result.method, result.n_subjects, (*result.notes, note))
    return adjusted


def _family_rows(result: Result) -> list[int]:
    """Rows that belong to the family: the effects the hypothesis names, or all."""
    if result.test.effects and "effect" in result.table:
        wanted = set(result.test.effects)
        return [i for i, effect in enumerate(result.table["effect"]) if effect in wanted]
    if result.test.test == "cumulative_link" and "term" in result.table:
        # thresholds are no hypotheses
        return [i for i, term in enumerate(result.table["term"]) if "|" not in str(term)]
    return list(range(len(result.table)))


def catch_table(table: pd.DataFrame) -> pd.DataFrame:
    """Catch trials by participant (`exclusions.catch_results`), those with any only."""
    results = catch_results(table)
    return results[results["catch_trials"] > 0].reset_index(drop=True)
