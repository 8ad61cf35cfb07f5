"""What is left out of the analysis, by which rule, and why: the plan's rules, applied before any name is shown.

Practice and catch trials and trials without a whole presentation or an answer are always left out. The plan adds rules
(`protocols.analysis_plan.Exclusion`), each with one limit:

=================  ============  =======================================================================================
rule               default       leaves out
=================  ============  =======================================================================================
missed_refreshes   0             trials with more missed refreshes than the limit
timed_out          (no limit)    trials not answered in time
too_fast           0.2           trials answered sooner than so many seconds after onset
too_slow           60            trials answered later than so many seconds after onset
catch              0.8           participants with a smaller share of their catch trials right
straight_lining    0.95          participants who gave one and the same answer in this share of 8 or more trials
incomplete         0.9           participants with a smaller share of their planned trials answered
gaze_loss          0.3           trials (``of: participant``: people) with a larger share of invalid gaze samples
gaze_off_fixation  3             trials (people) whose median distance to the central mark is more degrees than this
side_bias          0.9           participants who chose one side in at least this share of 8 or more comparisons
=================  ============  =======================================================================================
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.rows import rows_of_table
from analysis.sessions import Session
from protocols.trial import is_right
from stimuli.errors import InputError, problem


@dataclass(frozen=True)
class Rule:
    """One exclusion rule of the plan: its name, its limit (default filled in) and what it leaves out."""

    name: str
    limit: float
    of: str
    why: str = ""


@dataclass(frozen=True)
class Exclusions:
    """``table``: all trials with ``excluded`` and ``reason``; ``participants``: one row each (participant, trials,
    analysed, left_out, excluded, reason), trials of words alone not counted; ``reasons``: trials left out by reason;
    ``rules``: what was applied."""

    table: pd.DataFrame
    participants: pd.DataFrame
    reasons: pd.DataFrame
    rules: tuple[Rule, ...]

    @property
    def kept(self) -> pd.DataFrame:
        """The trials that are analysed."""
        return self.table[~self.table["excluded"].astype(bool)].reset_index(drop=True)


# rule -> (default limit, what it leaves out unless the plan says)
_RULES: dict[str, tuple[float, str]] = {
    "missed_refreshes": (0.0, "trial"),
    "timed_out": (0.0, "trial"),
    "too_fast": (0.2, "trial"),
    "too_slow": (60.0, "trial"),
    "catch": (0.8, "participant"),
    "straight_lining": (0.95, "participant"),
    "incomplete": (0.9, "participant"),
    "gaze_loss": (0.3, "trial"),
    "gaze_off_fixation": (3.0, "trial"),
    "side_bias": (0.9, "participant"),
}
WORDS_ONLY = ("instructions", "consent", "break")
_EITHER = ("gaze_loss", "gaze_off_fixation")


def parse_rules(rules: Sequence[Mapping[str, Any]], where: str = "analysis_plan.exclusions") -> tuple[Rule, ...]:
    """Rules of a plan with their defaults; every unknown rule or key in one InputError."""
    parsed: list[Rule] = []
    problems: list[str] = []
    for index, rule in enumerate(rules):
        name = str(rule.get("rule", ""))
        if name not in _RULES:
            problems.append(problem(f"{where}[{index}]", "unknown rule", repr(name), " | ".join(_RULES)))
            continue
        limit, of = _RULES[name]
        for key in rule.keys() - {"rule", "limit", "of", "reason"}:
            problems.append(problem(f"{where}[{index}] ({name})", "unknown key", repr(key), "limit | of | reason"))
        given, asked = rule.get("limit"), rule.get("of") or of
        if asked != of and name not in _EITHER:
            problems.append(problem(f"{where}[{index}] ({name})", "of", repr(asked), of))
        parsed.append(Rule(name, limit if given is None else float(given), str(asked), str(rule.get("reason") or "")))
    if problems:
        raise InputError(*problems)
    return tuple(parsed)


def rules_of(sessions: Sequence[Session]) -> tuple[Rule, ...]:
    """The exclusion rules stated in the sessions' analysis plan; none where the study states none.

    Raises InputError where the sessions state different rules.
    """
    stated = {
        json.dumps((s.header.get("analysis_plan") or {}).get("exclusions") or [], sort_keys=True) for s in sessions
    }
    if len(stated) > 1:
        raise InputError(problem("sessions", "exclusion rules", f"{len(stated)} versions", "one for all sessions"))
    return parse_rules(json.loads(stated.pop())) if stated else ()


def _trial_reasons(table: pd.DataFrame, rules: Sequence[Rule]) -> pd.Series:
    """The first reason that applies to each trial, '' for none."""
    reason = pd.Series("", index=table.index, dtype=object)

    def mark(where: pd.Series | np.ndarray, text: pd.Series | str) -> None:
        hit = np.asarray(where, dtype=bool) & (reason == "").to_numpy()
        reason[hit] = text[hit] if isinstance(text, pd.Series) else text

    mark(table["practice"], "practice")
    mark(table["catch"], "catch trial (tested, not analysed)")
    mark(table["kind"].isin(WORDS_ONLY), "no stimulus")
    mark(table["status"] != "ok", "not shown whole: " + table["status"].astype(str))
    mark(table["timed_out"].fillna(False), "no answer in time")
    mark(table["response"].isna(), "no answer")
    for rule in rules:
        if rule.name == "missed_refreshes":
            mark(table["missed"] > rule.limit, f"more than {rule.limit:g} missed refreshes")
        elif rule.name == "too_fast":
            mark(table["rt_s"] < rule.limit, f"answered before {rule.limit:g} s")
        elif rule.name == "too_slow":
            mark(table["rt_s"] > rule.limit, f"answered after {rule.limit:g} s")
    return reason


def catch_results(table: pd.DataFrame) -> pd.DataFrame:
    """Catch trials by participant: participant, catch_trials, right, share (nan without catch trials).

    A catch trial is right where its answer (the slot or condition chosen) equals ``correct``, or its rating lies within
    ``low..high``.
    """
    catch = table[table["catch"].astype(bool) & ~table["practice"].astype(bool) & (table["status"] == "ok")]
    catch = catch[catch["correct"].notna()]
    right = [is_right(str(row.correct), str(row.side), str(row.response)) for row in rows_of_table(catch)]
    counted = pd.DataFrame({"participant": catch["participant"].to_numpy(), "right": np.array(right, dtype=bool)})
    groups = counted.groupby("participant", sort=False)["right"]
    people = pd.Index(table["participant"].unique(), name="participant")
    n = groups.size().reindex(people, fill_value=0).astype(int)
    k = groups.sum().reindex(people, fill_value=0).astype(int)
    share = np.divide(k, n, out=np.full(len(n), np.nan), where=n.to_numpy() > 0)
    return pd.DataFrame({"catch_trials": n, "right": k, "share": share}, index=people).reset_index()


def _catch_rule(table: pd.DataFrame, rule: Rule, sessions: Sequence[Session]) -> dict[str, str]:
    results = catch_results(table)
    failed = results[results["share"] < rule.limit]
    return {
        row.participant: f"{row.right} of {row.catch_trials} catch trials right, {rule.limit:.0%} needed"
        for row in rows_of_table(failed)
    }


def _incomplete_rule(table: pd.DataFrame, rule: Rule, sessions: Sequence[Session]) -> dict[str, str]:
    planned: dict[str, int] = {}
    for session in sessions:
        plan = session.header.get("plan") or []
        n = sum(1 for trial in plan if trial.get("panels") and not trial.get("practice"))
        planned[session.participant] = planned.get(session.participant, 0) + n
    usable = table[(table["status"] == "ok") & ~table["practice"].astype(bool) & table["response"].notna()]
    answered = usable.groupby("participant").size()
    found = {}
    for participant, n in planned.items():
        done = int(answered.get(participant, 0))
        if n and done / n < rule.limit:
            found[participant] = f"{done} of {n} planned trials answered, {rule.limit:.0%} needed"
    return found


def _one_answer_rule(table: pd.DataFrame, rule: Rule, sessions: Sequence[Session]) -> dict[str, str]:
    """Straight-lining looks at whatever was answered, side bias at the sides of comparisons only."""
    kept = table[table["reason"] == ""]
    found = {}
    for participant, own in kept.groupby("participant", sort=False):
        answers = own["side"] if rule.name == "side_bias" else own["side"].where(own["side"].notna(), own["response"])
        answers = answers.dropna()
        share = answers.value_counts(normalize=True)
        if len(answers) >= 8 and share.iloc[0] >= rule.limit:
            found[str(participant)] = f"the answer {share.index[0]!r} in {share.iloc[0]:.0%} of {len(answers)} trials"
    return found


Failure = tuple[str, tuple[str, int] | None, str]
"""(participant, session and trial or None for all of them, reason)"""


def _gaze_failures(sessions: Sequence[Session], table: pd.DataFrame, rule: Rule) -> list[Failure]:
    """Every gaze rule that is broken."""
    from analysis.gaze import gaze_report

    gaze = gaze_report(sessions, table)
    if gaze is None:
        return []
    rows = gaze.trials if rule.of == "trial" else gaze.participants
    failures: list[Failure] = []
    for row in rows_of_table(rows):
        place = (str(row.session), int(row.trial)) if rule.of == "trial" else None
        if rule.name == "gaze_loss" and 1.0 - row.valid_share > rule.limit:
            said = f"{1.0 - row.valid_share:.0%} of the gaze samples lost, {rule.limit:.0%} allowed"
            failures.append((row.participant, place, said))
        if rule.name == "gaze_off_fixation" and row.error_dva > rule.limit:
            said = f"gaze {row.error_dva:.2f} deg off the mark, {rule.limit:g} allowed"
            failures.append((row.participant, place, said))
    return failures


_PARTICIPANT_RULES: dict[str, Callable[[pd.DataFrame, Rule, Sequence[Session]], dict[str, str]]] = {
    "catch": _catch_rule,
    "incomplete": _incomplete_rule,
    "straight_lining": _one_answer_rule,
    "side_bias": _one_answer_rule,
}


def apply_exclusions(table: pd.DataFrame, rules: Sequence[Rule], sessions: Sequence[Session]) -> Exclusions:
    """Mark what is left out. A participant's exclusion overrides nothing: a trial keeps its own, earlier reason."""
    table = table.copy()
    table["reason"] = _trial_reasons(table, rules)
    out: dict[str, str] = {}
    for rule in rules:
        if rule.name in _PARTICIPANT_RULES:
            for participant, why in _PARTICIPANT_RULES[rule.name](table, rule, sessions).items():
                out.setdefault(participant, why)
        elif rule.name in _EITHER:
            for participant, place, why in _gaze_failures(sessions, table, rule):
                if place is None:
                    out.setdefault(participant, why)
                else:
                    own = (table["session"] == place[0]) & (table["trial"] == place[1])
                    table.loc[own & (table["reason"] == ""), "reason"] = why
    for participant, why in out.items():
        hit = (table["participant"] == participant) & (table["reason"] == "")
        table.loc[hit, "reason"] = "participant excluded: " + why
    table["excluded"] = table["reason"] != ""
    shown = table[~table["kind"].isin(WORDS_ONLY)]
    people = list(dict.fromkeys([s.participant for s in sessions] or table["participant"]))
    rows = []
    for participant in people:
        own = shown[shown["participant"] == participant]
        kept = int((~own["excluded"]).sum())
        why = out.get(participant, "" if kept else "no trial left")
        rows.append((participant, len(own), kept, len(own) - kept, bool(why), why))
    columns = ["participant", "trials", "analysed", "left_out", "excluded", "reason"]
    counts = shown.loc[shown["excluded"], "reason"].value_counts(sort=False)
    reasons = pd.DataFrame({"reason": counts.index.astype(str), "trials": counts.to_numpy(dtype=int)})
    return Exclusions(table, pd.DataFrame(rows, columns=columns), reasons, tuple(rules))


def exclusion_lock(exclusions: Exclusions, sessions: Sequence[Session]) -> dict[str, Any]:
    """What `--blind` writes to ``exclusions.lock.json``: the rules, who and what is left out, and the data's hash."""
    table = exclusions.table[exclusions.table["excluded"]]
    left_out = [[str(r.participant), str(r.run), int(r.trial), r.reason] for r in rows_of_table(table)]
    return {
        "rules": [{"rule": rule.name, "limit": rule.limit, "of": rule.of} for rule in exclusions.rules],
        "participants": {r.participant: r.reason for r in rows_of_table(exclusions.participants) if r.excluded},
        "trials": left_out,
        "sessions": {session.path.name: file_sha256(session.path) for session in sessions},
    }


def compare_with_lock(lock: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Where the exclusions (both as `exclusion_lock` gives them) differ from the locked ones, in words."""
    said = []
    for key, what in (("rules", "rules"), ("participants", "participants left out"), ("trials", "trials left out")):
        if json.loads(json.dumps(now[key])) != lock.get(key):
            said.append(f"{what} differ from those locked before names were shown")
    if lock.get("sessions") != now["sessions"]:
        said.append("the session files are not those that were locked")
    return said


def file_sha256(path: Any) -> str:
    """sha256 (hex) of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
