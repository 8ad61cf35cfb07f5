"""Sentences in APA style, ready to paste, made from the result tables row by row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from analysis.blocks import f_words, number, p_words
from analysis.planned_test import Result, adjustment_name, reported_p, sphericity_corrected
from analysis.results import BOUNDARY, TOO_FEW_SUBJECTS
from analysis.rows import rows_of_table


def _share(value: float, digits: int = 2) -> str:
    """A number that cannot exceed 1: without the leading zero."""
    text = number(value, digits)
    return text.replace("0.", ".", 1) if abs(value) < 1 else text


def _interval(low: float, high: float, digits: int = 2) -> str:
    return f"95% CI [{number(low, digits)}, {number(high, digits)}]"


def sentences(result: Result) -> list[str]:
    """One sentence a row of the result; rows without a finite statistic say so in words."""
    make = _SENTENCES.get(result.test.test)
    if make is None:
        return []
    said = _joint(result)
    for row in ({str(key): value for key, value in one.items()} for one in result.table.to_dict("records")):
        status = row.get("status", "ok")
        if result.test.test == "cumulative_link" and "|" in str(row.get("term", "")):
            continue  # thresholds between answers are no hypotheses
        levels = [str(row[factor]) for factor in result.test.separately_by if factor in row]
        own = replace(result, test=replace(result.test, name=", ".join([result.test.name, *levels])))
        if status == "ok":
            said.append(_in_family(result, row, make(own, row)))
        elif _has_numbers(status, row):
            said.append(f"{_in_family(result, row, make(own, row))[:-1]} ({row['note']}).")
        else:
            names = [own.test.name, *([what] if (what := _what(row)) not in ("", result.test.name) else [])]
            said.append(f"{', '.join(names)}: {row['status'].replace('_', ' ')} ({row.get('note', '')}).")
    return said


def _what(row: Mapping[str, Any]) -> str:
    """The effect, pair, item or term that a row is about; '' where its test has one row."""
    if "mean_diff" in row and "a" in row:
        return f"{row['a']} − {row['b']}"
    names = ("effect", "comparison", "item", "term", "parameter", "measure")
    return next((str(row[name]) for name in names if row.get(name)), "")


def _in_family(result: Result, row: Mapping[str, Any], sentence: str) -> str:
    """The sentence with the p value adjusted over the family of tests that the plan names."""
    p, attrs = float(row.get("p_family", np.nan)), result.table.attrs
    if not np.isfinite(p) or result.test.test == "posthoc_t":
        return sentence
    how = str(attrs.get("family_adjust", "holm"))
    return f"{sentence[:-1]}, {_p_adjusted(p, how)} (family of {attrs.get('family_size')})."


def _p_adjusted(p: float, method: str) -> str:
    label = "uncorrected " if method == "none" else ""
    mark = "" if method == "none" else f"_{adjustment_name(method)}"
    return f"{label}p{mark}{p_words(p)[1:]}"


def _alike(result: Result, row: Mapping[str, Any]) -> pd.DataFrame:
    """The rows made with ``row``: those of the same levels of ``separately_by``."""
    table = result.table
    for name in result.test.separately_by:
        if name in table and name in row:
            table = table[table[name] == row[name]]
    return table


def _has_numbers(status: str, row: Mapping[str, Any]) -> bool:
    """Whether the row says something all the same: a variance of 0 is a result (the numbers are those of the model
    without it), and F stands where only Mauchly's test needs more participants."""
    needed = {BOUNDARY: ("p", "ci_low", "ci_high"), TOO_FEW_SUBJECTS: ("F", "p")}.get(status)
    return needed is not None and bool(np.isfinite([float(row.get(name, np.nan)) for name in needed]).all())


def _anova(result: Result, row: Mapping[str, Any]) -> str:
    eps, corrected = float(row.get("eps_gg", np.nan)), sphericity_corrected(row)
    if corrected:
        df = f"{number(row['df1'] * eps, 2)}, {number(row['df2'] * eps, 2)}"
    else:
        df = f"{row['df1']:g}, {row['df2']:g}"
    text = f"{result.test.name}, {row['effect']}: F({df}) = {number(row['F'], 2)}, {p_words(reported_p(row))}"
    if "eta2_generalized" in row:
        text += f", η²_G = {_share(row['eta2_generalized'])}, η²_p = {_share(row['eta2_partial'])}"
        low, high = (float(row.get(f"eta2_partial_{end}", np.nan)) for end in ("low", "high"))
        if np.isfinite(low) and np.isfinite(high):
            text += f", 90% CI [{_share(low)}, {_share(high)}]"
    elif "eta2" in row:
        text += f", η² = {_share(row['eta2'])}"
    return text + (f", Greenhouse-Geisser ε = {_share(eps)}." if corrected else ".")


def _ranks(result: Result, row: Mapping[str, Any]) -> str:
    df = f"{row['df1']:g}, {row['df2']:g}"
    return f"{result.test.name} (aligned ranks), {row['effect']}: F({df}) = {number(row['F'], 2)}, {p_words(row['p'])}."


def _friedman(result: Result, row: Mapping[str, Any]) -> str:
    text = f"{result.test.name}: χ²_F({row['df']:g}) = {number(row['chi2'], 2)}, {p_words(row['p'])}"
    return f"{text}, W = {_share(row['kendall_w'])}, N = {row['n']:g}."


def _posthoc(result: Result, row: Mapping[str, Any]) -> str:
    attrs, together = result.table.attrs, "p_family" in row
    adjust = str(attrs.get("family_adjust" if together else "adjust") or "holm")
    text = f"{row['a']} − {row['b']}: t({row['df']:g}) = {number(row['t'], 2)}"
    text += f", {_p_adjusted(row['p_family'] if together else row['p_adjusted'], adjust)}"
    text += f", M_diff = {number(row['mean_diff'], 2)}, {_interval(row['ci_low'], row['ci_high'])}"
    text += f", d_z = {number(row['dz'], 2)}"
    family = attrs.get("family_size") if together else int(_alike(result, row)["p"].notna().sum())
    return f"{result.test.name}, {text} (family of {family})."


def _choice(result: Result, row: Mapping[str, Any]) -> str:
    interval = f"95% CI [{row['exact_low']:.0%}, {row['exact_high']:.0%}]"
    if row["unit"] == "participants":
        said = f"{row['item']} chosen in {row['share']:.0%} of a participant's answers"
        if result.test.dv == "correct":
            said = f"{row['share']:.0%} of a participant's answers right"
        text = f"{result.test.name}: {said} on average"
        text += f" ({row['participants']} participants, {row['answers']} answers; participants as the unit)"
        t = f"t({row['df']:g}) = {number(row['t'], 2)}, " if np.isfinite(row.get("t", np.nan)) else ""
        p0 = number(float(result.table.attrs.get("p0", 0.5)), 2).replace("0.", ".", 1)
        return f"{text}, {interval}, against {p0}: {t}{p_words(row['p'])}."
    counts = f"{row['k']:g} of {row['n']:g} participants ({row['share']:.0%})"
    text = f"{result.test.name}: {row['item']} was chosen by {counts}, {interval} (Clopper-Pearson)"
    return f"{text}, exact binomial {p_words(row['p'])}."


def _scale(result: Result, row: Mapping[str, Any]) -> str:
    """Items are told as differences from the origin of their own scale: higher is preferred."""
    estimate, unit = float(row.get("ability", np.nan)), "logits"
    if "scale" in row:
        estimate = float(row["scale"])
        unit = {"jod": "JOD", "z": "z units"}[str(result.test.options.get("unit") or "jod")]
    items = _alike(result, row)
    origin = items.loc[items["se"] == 0, "item"]
    if row.get("se") == 0 or origin.empty:
        return f"{result.test.name}: {row['item']} is the origin of the scale (0 {unit})."
    interval = _interval(row["ci_low"], row["ci_high"])
    return f"{result.test.name}: {row['item']} − {origin.iloc[0]}: {number(estimate, 2)} {unit}, {interval}."


def _coefficient(result: Result, row: Mapping[str, Any]) -> str:
    if np.isfinite(row.get("df", np.nan)):
        statistic = f"t({number(row['df'], 1 if row['df'] % 1 else 0)}) = {number(row['t'], 2)}"
    elif "chi2" in row:
        statistic = f"χ²(1) = {number(row['chi2'], 2)}"
    else:
        statistic = f"z = {number(row['z'], 2)}"
    estimate = f"b = {number(row['estimate'], 2)}, {_interval(row['ci_low'], row['ci_high'])}"
    term = _term_words(str(row["term"]), result.table["term"], result.table.attrs.get("references") or {})
    return f"{result.test.name}, {term}: {estimate}, {statistic}, {p_words(row['p'])}."


def _joint(result: Result) -> list[str]:
    """The type III tests of a mixed model's terms, which come before its coefficients; those of one level each."""
    tests = result.table.attrs.get("f_tests") or []
    return [f"{result.test.name}, {f_words(one)} (type III)." for one in tests]


def _term_words(term: str, terms: pd.Series, references: Mapping[str, str]) -> str:
    """What a coefficient is the difference of: ``conditiongold`` as 'condition: gold − dense', beside an interaction
    with the level of the other factor at which it holds."""
    if term == "(Intercept)" or not references:
        return term
    factor_of = {
        part: max((f for f in references if part.startswith(f) and part != f), key=len, default="")
        for one in terms.astype(str)
        for part in one.split(":")
    }
    parts = term.split(":")
    words = [f"{f}: {part[len(f) :]} − {references[f]}" if (f := factor_of[part]) else part for part in parts]
    beside = {
        factor_of[other]
        for one in terms.astype(str)
        if len(one.split(":")) > len(parts) and set(parts) <= set(one.split(":"))
        for other in one.split(":")
    } - {factor_of[part] for part in parts}
    at = [f"{factor} {references[factor]}" for factor in references if factor in beside]
    return " × ".join(words) + (f", at {', '.join(at)}" if at else "")


def _wilcoxon(result: Result, row: Mapping[str, Any]) -> str:
    z = f", z = {number(row['z'], 2)}" if np.isfinite(row["z"]) else ""
    zeros = f" ({row['zeros']:g} zeros dropped)" if row["zeros"] else ""
    text = f"{result.test.name}, {row['comparison']}: W = {row['statistic']:g}{z}, {p_words(row['p'])}"
    return f"{text}, r_rb = {_share(row['rank_biserial'])}, n = {row['n_used']:g}{zeros}."


def _tost(result: Result, row: Mapping[str, Any]) -> str:
    bounds = f"[{number(row['low'], 2)}, {number(row['high'], 2)}]"
    text = f"{result.test.name}, {row['comparison']}: equivalence within {bounds} (two one-sided tests): "
    text += f"M_diff = {number(row['mean_diff'], 2)}, 90% CI [{number(row['ci_low'], 2)}, {number(row['ci_high'], 2)}]"
    t = row["t_low"] if row["p_low"] >= row["p_high"] else row["t_high"]
    return f"{text}, the larger p of both from t({row['df']:g}) = {number(t, 2)}, {p_words(row['p'])}."


def _mcnemar(result: Result, row: Mapping[str, Any]) -> str:
    a, b = str(row["comparison"]).split(" − ")
    text = f"{result.test.name}: of {result.n_subjects} participants {row['b']:g} said yes under {a} only and "
    return f"{text}{row['c']:g} under {b} only, exact McNemar test, {p_words(row['p'])}."


def _cochran(result: Result, row: Mapping[str, Any]) -> str:
    return f"{result.test.name}: Cochran's Q({row['df']:g}) = {number(row['statistic'], 2)}, {p_words(row['p'])}."


def _psychometric(result: Result, row: Mapping[str, Any]) -> str:
    interval = f"95% CI [{row['ci_low']:.3g}, {row['ci_high']:.3g}]".replace("-", "−")
    return f"{result.test.name}, {row['parameter']}: {row['estimate']:.3g}".replace("-", "−") + f", {interval}."


def _agreement(result: Result, row: Mapping[str, Any]) -> str:
    interval = f"95% CI [{_share(row['ci_low'])}, {_share(row['ci_high'])}]"
    return f"{result.test.name}, {row['measure']}: {_share(row['value'])}, {interval}."


_SENTENCES = {
    "rm_anova": _anova,
    "oneway_anova": _anova,
    "aligned_rank_anova": _ranks,
    "friedman": _friedman,
    "posthoc_t": _posthoc,
    "binomial_choice": _choice,
    "bradley_terry": _scale,
    "thurstone": _scale,
    "binomial_mixed": _coefficient,
    "cumulative_link": _coefficient,
    "linear_mixed": _coefficient,
    "wilcoxon": _wilcoxon,
    "tost": _tost,
    "mcnemar": _mcnemar,
    "cochran_q": _cochran,
    "psychometric": _psychometric,
    "agreement": _agreement,
}


def reason_sentence(exclusions: pd.DataFrame, participants: pd.DataFrame) -> str:
    """Who and what was left out, in one sentence."""
    out = participants[participants["excluded"]]
    people = (
        f"{len(out)} of {len(participants)} participants"
        if len(out)
        else f"None of the {len(participants)} participants"
    )
    trials = int(participants["left_out"].sum())
    total = int(participants["trials"].sum())
    reasons = "; ".join(f"{row.reason}: {row.trials}" for row in rows_of_table(exclusions))
    return f"{people} left out; {trials} of {total} presentations not analysed" + (f" ({reasons})." if reasons else ".")
