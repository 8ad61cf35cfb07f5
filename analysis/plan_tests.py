"""Each kind of planned test on its rows: from the plan's words to the arguments of `analysis`'s functions."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

import analysis
from analysis.blocks import f_words
from analysis.comparisons import adaptive_level, choice_row
from analysis.planned_test import Plan, Test, column_of
from analysis.results import TOO_FEW_SUBJECTS
from stimuli.errors import InputError, problem


@dataclass(frozen=True)
class _Pair:
    """Participant means ``x`` and ``y`` at the levels ``a`` and ``b``; ``dropped``: who lacks one of them."""

    x: np.ndarray
    y: np.ndarray
    a: str
    b: str
    dropped: dict[str, str]

    def named(self, table: pd.DataFrame) -> pd.DataFrame:
        """The test's table with what was compared in front, and who was left out."""
        table.insert(0, "comparison", f"{self.a} − {self.b}")
        table.attrs.setdefault("n_subjects", len(self.x))
        table.attrs["dropped"] = {**(table.attrs.get("dropped") or {}), **self.dropped}
        return table


def pair_of(own: pd.DataFrame, dv: str, test: Test) -> _Pair:
    """Participant means of the two levels ``a`` and ``b`` of the first factor (else its first and last by name)."""
    factor = test.within[0] if test.within else "condition"
    levels = sorted(column_of(own, factor, test).astype(str).unique())
    a, b = str(test.options.get("a") or levels[0]), str(test.options.get("b") or levels[-1])
    for level in (a, b):
        if level not in levels:
            raise InputError(problem(f"analysis plan: {test.name}", f"level of {factor}", level, " | ".join(levels)))
    means = (
        own.assign(_level=own[factor].astype(str)).groupby([test.subject, "_level"], sort=False)[dv].mean().unstack()
    )
    both = means[[a, b]].dropna()
    lost = means.index.difference(both.index, sort=False)
    dropped = {str(person): f"no value at {a if np.isnan(means.loc[person, a]) else b}" for person in lost}
    return _Pair(both[a].to_numpy(dtype=float), both[b].to_numpy(dtype=float), a, b, dropped)


def _chosen(own: pd.DataFrame, test: Test) -> pd.DataFrame:
    """Comparisons in which the condition asked about took part, with ``chosen`` 0/1."""
    names = sorted(set(own["winner"]) | set(own["loser"]))
    asked = str(test.options.get("choice") or test.options.get("a") or names[0])
    own = own[(own["winner"] == asked) | (own["loser"] == asked)]
    if own.empty:
        raise InputError(problem(f"analysis plan: {test.name}", "choice", repr(asked), " | ".join(names)))
    return own.assign(chosen=(own["winner"] == asked).astype(float), asked=asked)


def _pictures(own: pd.DataFrame) -> np.ndarray:
    """How many pictures each trial showed to choose between (1: it was rated)."""
    if "condition" not in own:
        return np.ones(len(own), dtype=int)
    return own["condition"].astype(str).str.count(r"\|").to_numpy() + 1


def _by_chance(own: pd.DataFrame, test: Test, otherwise: float) -> float:
    """The stated share of right answers by chance; else that of the trials, 1 / m (``otherwise``: where nothing is
    right or wrong, or one picture stands alone). Raises InputError where trials differ in it."""
    found = sorted(set(_pictures(own).tolist()))
    if test.options.get("p0") is not None or test.dv != "correct" or found == [1]:
        return float(test.options.get("p0") or otherwise)
    if len(found) > 1:
        got = f"choices between {' and '.join(map(str, found))} pictures"
        raise InputError(problem(f"analysis plan: {test.name}", "p0", got, "one number of pictures (choose by where)"))
    return 1 / found[0]


def _binomial_choice(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    p0 = _by_chance(own, test, 0.5)
    if test.dv == "choice":
        own = _chosen(own, test)
        name = str(own["asked"].iloc[0])
    else:
        own, name = own.assign(chosen=own[dv]), "right answers"
    row = choice_row(own, p0, test.subject)
    if row["unit"] != "participants":
        del row["t"], row["df"]  # an exact test has none
    table = pd.DataFrame([{"item": name, **row}])
    how = f"Exact two-sided binomial test against {p0:g}, one answer a participant; Clopper-Pearson interval."
    if row["unit"] == "participants":
        how = (
            f"Student's t test of the participants' shares against {p0:g}; interval of Korn and Graubard at the "
            "effective sample size (near the limit the two can disagree)."
        )
    table.attrs.update(method=how, n_subjects=row["participants"], p0=p0)
    return table


def _options(test: Test, *names: str) -> dict[str, Any]:
    return {name: test.options[name] for name in names if test.options.get(name) is not None}


def _rm_anova(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    between = list(test.between) or None
    return analysis.rm_anova(own, dv=dv, within=list(test.within), subject=test.subject, between=between)


def _oneway(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    means = own.groupby([test.subject, test.between[0]], sort=False)[dv].mean().reset_index()
    return analysis.oneway_anova(means, dv=dv, between=test.between[0])


def _posthoc(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    adjust = str(test.options.get("adjust") or plan.adjust)
    return analysis.posthoc_t(own, dv=dv, within=_first_within(test), subject=test.subject, adjust=adjust)


def _first_within(test: Test) -> str:
    return test.within[0] if test.within else "condition"


def _aligned_ranks(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    """Without Mauchly's test: aligned ranks are not corrected for sphericity, so that its lack says nothing of them."""
    table = analysis.aligned_rank_anova(own, dv=dv, within=list(test.within), subject=test.subject)
    complete = (table["status"] == TOO_FEW_SUBJECTS) & np.isfinite(table["F"].astype(float))
    table.loc[complete, ["status", "note"]] = ["ok", ""]
    return table.drop(columns=["mauchly_w", "mauchly_chi2", "mauchly_df", "mauchly_p"], errors="ignore")


def _friedman(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    return analysis.friedman(own, dv=dv, within=_first_within(test), subject=test.subject)


def _wilcoxon(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    pair = pair_of(own, dv, test)
    return pair.named(analysis.wilcoxon(pair.x, pair.y))


def _tost(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    low, high = test.options.get("low"), test.options.get("high")
    if low is None or high is None:
        raise InputError(problem(f"analysis plan: {test.name}", "bounds", f"low {low}, high {high}", "both bounds"))
    pair = pair_of(own, dv, test)
    table = analysis.tost(pair.x, pair.y, low=float(low), high=float(high))
    table.insert(0, "low", float(low))
    table.insert(1, "high", float(high))
    return pair.named(table)


def _likert_summary(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    question = str(test.options.get("question") or next(iter(plan.scales), ""))
    scale = plan.scales.get(question, (int(own[dv].min()), int(own[dv].max())))
    return analysis.likert_summary(own, dv=dv, by=list(test.within) or ["condition"], scale=scale)


def _bradley_terry(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    return analysis.bradley_terry(own, winner="winner", loser="loser", observer=test.subject)


def _thurstone(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    return analysis.thurstone(
        own, winner="winner", loser="loser", observer=test.subject, **_options(test, "unit", "method")
    )


FEW_SCENES = 6
"""From so many scenes on they are a sample of scenes, and a random factor; fewer are these scenes only."""


def random_terms(own: pd.DataFrame, test: Test, formula: str) -> list[str]:
    """The stated random effects; else participants, their own effect of each within factor that they judged several
    times a level (without it their trials would count as independent), and scenes where there are enough and no effect
    names them; with ``scenes_random`` (`plan.with_scenes`) effects that differ by scene as well."""
    if test.test == "linear_mixed" and test.options.get("scenes_random"):
        by_scene = ["(1|scene)", *(f"(1|scene:{name})" for name in test.within), f"(1|{test.subject})"]
        return by_scene + [f"(1|{test.subject}:{name})" for name in test.within]
    stated = test.options.get("random")
    if stated:
        return [str(stated)]
    terms = [f"(1|{test.subject})"]
    if test.test == "linear_mixed":
        named = set(re.findall(r"[A-Za-z_]\w*", formula.partition("~")[2]))
        factors = [one for one in own if one in named and not pd.api.types.is_numeric_dtype(own[one])]
        for name in [one for one in factors if one != test.subject]:
            cells = own.groupby([test.subject, name], observed=True).size()
            if cells.groupby(level=0).size().max() > 1 and cells.max() > 1:
                terms.append(f"(1|{test.subject}:{name})")
    if own["scene"].nunique() >= FEW_SCENES and "scene" not in formula:
        terms.append("(1|scene)")
    return terms


def formula_of(dv: str, test: Test) -> str:
    """The stated formula; else the within factors (condition) with all their interactions."""
    given = test.options.get("formula")
    return str(given) if given else f"{dv} ~ {' * '.join(test.within or ('condition',))}"


def _binomial_mixed(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    if test.dv == "choice":
        own = _chosen(own, test)
    formula = str(test.options.get("formula") or f"{dv} ~ 1")
    return analysis.binomial_mixed(own, formula, random=random_terms(own, test, formula))


def _cumulative_link(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    formula = formula_of(dv, test)
    return analysis.cumulative_link(own, formula, random=random_terms(own, test, formula), test=None)


def _linear_mixed(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    """With ``scenes_random`` (`plan.with_scenes`): effects that differ by participant and by scene too. Variances may
    be negative: they are there for the tests, which hold their level so (`analysis.linear_mixed`)."""
    formula = formula_of(dv, test)
    random = random_terms(own, test, formula)
    table = analysis.linear_mixed(own, formula, random=random, variances="unbounded")
    joint = [f"{f_words(one)}." for one in table.attrs.get("f_tests") or []]
    table.attrs["notes"] = [*(table.attrs.get("notes") or []), *joint]
    return table


def _psychometric(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    x = str(test.options.get("x") or "x")
    levels = own["condition"].map(adaptive_level) if "condition" in own and x not in own else None
    found = levels is not None and levels.notna().any()  # an adaptive block's values stand in its conditions' names
    own = own.assign(_x=levels if found else column_of(own, x, test).astype(float))
    right = _chosen(own, test)["chosen"] if test.dv == "choice" else own[dv].astype(float)
    rows = pd.DataFrame({"x": own.loc[right.index, "_x"], "who": own.loc[right.index, test.subject], "k": right})
    # the participant is the unit: counts stay apart, and errors are those over participants
    counted = rows.groupby(["who", "x"], sort=False)["k"].agg(["sum", "count"])
    counted = counted.rename(columns={"sum": "k", "count": "n"}).reset_index()
    guess = _by_chance(own, test, 0.0)
    return analysis.psychometric(
        counted, x="x", k="k", n="n", link=str(test.options.get("method") or "logit"), guess=guess, observer="who"
    )


def _mcnemar(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    pair = pair_of(own, dv, test)
    if not (np.isin(pair.x, (0, 1)).all() and np.isin(pair.y, (0, 1)).all()):
        wanted = "one answer (0 or 1) a participant and level"
        raise InputError(problem(f"analysis plan: {test.name}", "mcnemar", "several answers", wanted))
    table = analysis.mcnemar(int(np.sum(pair.x > pair.y)), int(np.sum(pair.x < pair.y)), exact=True)
    table.attrs["n_subjects"] = len(pair.x)
    return pair.named(table)


def _cochran(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    return analysis.cochran_q(own, dv=dv, within=_first_within(test), subject=test.subject)


def _dprime(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    """Of every participant, and of every number of pictures to choose between."""
    own = _chosen(own, test) if test.dv == "choice" else own.assign(chosen=own[dv])
    own = own.assign(m=_pictures(own))
    if (own["m"] < 2).any():
        wanted = "choices between two or more pictures"
        raise InputError(problem(f"analysis plan: {test.name}", "dprime", "trials with one picture", wanted))
    people = own.groupby([test.subject, "m"], sort=False)["chosen"].agg(["sum", "count"]).reset_index()
    tables = [
        analysis.dprime(int(row["sum"]), int(row["count"]), m=int(row["m"])).assign(
            participant=str(row[test.subject]), m=int(row["m"])
        )
        for row in people.to_dict("records")
    ]
    table = pd.concat(tables, ignore_index=True)
    how = ", ".join(f"{m}-alternative" for m in sorted(set(own["m"])))
    method = f"d' per participant, {how} forced choice: the picture with the largest of m independent normal "
    method += "evidences is chosen, without bias to a place (Hacker & Ratcliff 1979)."
    if "side_by_side" in set(own.get("kind", ())):
        method += " The reference beside the pictures is left out of account: d' is not that of a matching task."
    table.attrs.update(method=method, n_subjects=own[test.subject].nunique())
    return table


def _agreement(own: pd.DataFrame, dv: str, test: Test, plan: Plan) -> pd.DataFrame:
    factors = list(test.within) or [name for name in ("scene", "condition") if own[name].nunique() > 1]
    item = own[factors].astype(str).agg(" / ".join, axis=1)
    means = own.assign(item=item).groupby(["item", test.subject], sort=False)[dv].mean().reset_index()
    return analysis.agreement(means, item="item", rater=test.subject, rating=dv)


RUNNERS: dict[str, Callable[[pd.DataFrame, str, Test, Plan], pd.DataFrame]] = {
    "rm_anova": _rm_anova,
    "oneway_anova": _oneway,
    "posthoc_t": _posthoc,
    "aligned_rank_anova": _aligned_ranks,
    "friedman": _friedman,
    "wilcoxon": _wilcoxon,
    "likert_summary": _likert_summary,
    "binomial_choice": _binomial_choice,
    "binomial_mixed": _binomial_mixed,
    "bradley_terry": _bradley_terry,
    "thurstone": _thurstone,
    "cumulative_link": _cumulative_link,
    "linear_mixed": _linear_mixed,
    "psychometric": _psychometric,
    "tost": _tost,
    "mcnemar": _mcnemar,
    "cochran_q": _cochran,
    "dprime": _dprime,
    "agreement": _agreement,
}
