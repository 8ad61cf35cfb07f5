"""Sentences in APA style, ready to paste, made from the result tables row by row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from analysis.blocks import number, p_words
from analysis.planned_test import Result
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
    said = []
    for row in ({str(key): value for key, value in one.items()} for one in result.table.to_dict("records")):
        status = row.get("status", "ok")
        levels = [str(row[factor]) for factor in result.test.separately_by if factor in row]
        own = replace(result, test=replace(result.test, name=", ".join([result.test.name, *levels])))
        if status == "ok":
            said.append(make(own, row))
        elif _has_numbers(status, row):
            said.append(f"{make(own, row)[:-1]} ({row['note']}).")
        else:
            name = row.get("effect") or row.get("item") or row.get("term") or result.test.name
            said.append(f"{own.test.name}, {name}: {row['status'].replace('_', ' ')} ({row.get('note', '')}).")
    return said


def _has_numbers(status: str, row: Mapping[str, Any]) -> bool:
    """Whether the row says something all the same: a variance of 0 is a result (the numbers are those of the model
    without it), and F stands where only Mauchly's test needs more participants."""
    needed = {BOUNDARY: ("p", "ci_low", "ci_high"), TOO_FEW_SUBJECTS: ("F", "p")}.get(status)
    return needed is not None and bool(np.isfinite([float(row.get(name, np.nan)) for name in needed]).all())


def _anova(result: Result, row: Mapping[str, Any]) -> str:
    eps = float(row.get("eps_gg", np.nan))
    corrected = np.isfinite(eps) and eps < 0.9999 and row["df1"] > 1
    if corrected:
        df = f"{number(row['df1'] * eps, 2)}, {number(row['df2'] * eps, 2)}"
    else:
        df = f"{row['df1']:g}, {row['df2']:g}"
    p = row["p_gg"] if corrected else row["p"]
    text = f"{result.test.name}, {row['effect']}: F({df}) = {number(row['F'], 2)}, {p_words(p)}"
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
    return f"{text}, W = {_share(row['kendall_w'])}, N = {result.n_subjects}."


def _posthoc(result: Result, row: Mapping[str, Any]) -> str:
    adjust = str(result.table.attrs.get("adjust") or result.test.options.get("adjust") or "holm").capitalize()
    text = f"{row['a']} − {row['b']}: t({row['df']:g}) = {number(row['t'], 2)}"
    text += f", p_{adjust}{p_words(row.get('p_family', row['p_adjusted']))[1:]}"
    text += f", M_diff = {number(row['mean_diff'], 2)}, {_interval(row['ci_low'], row['ci_high'])}"
    text += f", d_z = {number(row['dz'], 2)}"
    family = result.table.attrs.get("family_size", len(result.table))
    return f"{result.test.name}, {text} (family of {family})."


def _choice(result: Result, row: Mapping[str, Any]) -> str:
    interval = f"95% CI [{row['exact_low']:.0%}, {row['exact_high']:.0%}]"
    if row["unit"] == "participants":
        text = f"{result.test.name}: {row['item']} chosen in {row['share']:.0%} of a participant's answers on average"
        text += f" ({row['participants']} participants, {row['answers']} answers; participants as the unit)"
        return f"{text}, {interval}, {p_words(row['p'])}."
    counts = f"{row['k']:g} of {row['n']:g} participants ({row['share']:.0%})"
    text = f"{result.test.name}: {row['item']} was chosen by {counts}, {interval} (Clopper-Pearson)"
    return f"{text}, exact binomial {p_words(row['p'])}."


def _scale(result: Result, row: Mapping[str, Any]) -> str:
    estimate = row.get("scale", row.get("ability"))
    unit = (
        str(result.test.options.get("unit") or ("JOD" if "scale" in row else "logits"))
        .upper()
        .replace("LOGITS", "logits")
    )
    if row.get("se") == 0:
        return f"{result.test.name}: {row['item']} is the origin of the scale (0 {unit})."
    return (
        f"{result.test.name}: {row['item']} {number(estimate, 2)} {unit}, {_interval(row['ci_low'], row['ci_high'])}."
    )


def _coefficient(result: Result, row: Mapping[str, Any]) -> str:
    if np.isfinite(row.get("df", np.nan)):
        statistic = f"t({number(row['df'], 1 if row['df'] % 1 else 0)}) = {number(row['t'], 2)}"
    elif "chi2" in row:
        statistic = f"χ²(1) = {number(row['chi2'], 2)}"
    else:
        statistic = f"z = {number(row['z'], 2)}"
    estimate = f"b = {number(row['estimate'], 2)}, {_interval(row['ci_low'], row['ci_high'])}"
    return f"{result.test.name}, {row['term']}: {estimate}, {statistic}, {p_words(row['p'])}."


def _wilcoxon(result: Result, row: Mapping[str, Any]) -> str:
    z = f", z = {number(row['z'], 2)}" if np.isfinite(row["z"]) else ""
    return f"{result.test.name}: W = {row['statistic']:g}{z}, {p_words(row['p'])}, n = {row['n_used']:g}."


def _tost(result: Result, row: Mapping[str, Any]) -> str:
    bounds = f"[{number(row['low'], 2)}, {number(row['high'], 2)}]"
    text = f"{result.test.name}: equivalence within {bounds} (TOST): M_diff = {number(row['mean_diff'], 2)}, 90% CI "
    return f"{text}[{number(row['ci_low'], 2)}, {number(row['ci_high'], 2)}], {p_words(row['p'])}."


def _counts_test(result: Result, row: Mapping[str, Any]) -> str:
    return f"{result.test.name}: χ²({row['df']:g}) = {number(row['statistic'], 2)}, {p_words(row['p'])}."


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
    "mcnemar": _counts_test,
    "cochran_q": _counts_test,
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
