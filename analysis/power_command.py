"""``python -m analysis power PROTOCOL``: whole studies simulated through the planned analysis, for several n."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from analysis.blocks import plain, written
from analysis.exclusions import apply_exclusions, parse_rules
from analysis.plan import parse_plan, run_plan
from analysis.planned_test import Plan, Result
from analysis.preference import exact_interval
from analysis.simulated_table import simulated_table, slot
from protocols import load_study
from protocols.study import Study
from stimuli.errors import InputError, problem

COLUMNS = ["n", "test", "effect", "power", "mc_low", "mc_high", "simulations", "undefined"]


def main(argv: Sequence[str]) -> int:
    """Print the table (and write ``--json``); the exit code is 0."""
    parser = argparse.ArgumentParser(
        prog="python -m analysis power",
        description="How often the planned test rejects, by simulation with the protocol's observers, for each n.",
        epilog="example: python -m analysis power foveated_2016 --n 8,12,16 --simulations 200",
    )
    parser.add_argument("protocol", help="a protocol file, or the name of a shipped one")
    parser.add_argument("--n", help="numbers of participants, comma between (default: half, all, twice the target)")
    parser.add_argument("--test", help="name of the planned test (default: the plan's power_for, or the first)")
    parser.add_argument("--simulations", type=int, default=200, help="studies for each n (default 200)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", metavar="FILE", help="write the table as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    args = parser.parse_args(argv)
    if args.simulations < 1:
        raise InputError(problem("--simulations", "studies", args.simulations, "at least 1"))
    study = load_study(args.protocol)
    target = study.participants.target
    numbers = _numbers(args.n) if args.n else sorted({max(2, target // 2), target, 2 * target})
    name = args.test or study.analysis.power_for
    table = planned_power(study, numbers, name, args.simulations, args.seed, show_progress=not args.quiet)
    print(_said(table, study))
    if args.json:
        Path(args.json).write_text(json.dumps(plain(table.to_dict("records")), indent=1) + "\n", encoding="utf-8")
    return 0


def _numbers(text: str) -> list[int]:
    try:
        numbers = sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise InputError(
            problem("--n", "numbers of participants", repr(text), "whole numbers, comma between")
        ) from None
    if not numbers or numbers[0] < 2:
        raise InputError(problem("--n", "numbers of participants", repr(text), "at least 2 each"))
    return numbers


def planned_power(
    study: Study, numbers: Sequence[int], name: str | None, simulations: int, seed: int, show_progress: bool = False
) -> pd.DataFrame:
    """`COLUMNS`: for each n and each effect that the test names (all, where it names none), the share of simulated
    studies that reject at the plan's level, with its exact 95 % Monte Carlo interval. Studies whose p is undefined
    count as not rejecting, and are counted. Raises InputError where the plan holds no such test, or one without p."""
    plan = _plan(study, name)
    rules = parse_rules(study.analysis_plan().get("exclusions") or [])
    slots = [slot(study, participant) for participant in range(1, max(numbers) + 1)]
    rows: list[dict[str, Any]] = []
    hidden = None if show_progress else True
    with tqdm(total=len(numbers) * simulations, desc="power", disable=hidden, leave=False) as bar:
        for n in numbers:
            hits: dict[str, list[float]] = {}
            for k in range(simulations):
                own_seed = int(np.random.SeedSequence([seed, n, k]).generate_state(1)[0])
                table = simulated_table(study, slots[:n], own_seed)
                kept = apply_exclusions(table, rules, ()).kept
                for effect, p in _p_values(run_plan(plan, kept)[0]).items():
                    hits.setdefault(effect, []).append(p)
                bar.update()
            for effect, p_values in hits.items():
                rejected = int(np.sum(np.array(p_values) < plan.alpha))
                low, high = exact_interval(rejected, simulations)
                undefined = simulations - int(np.isfinite(p_values).sum())
                row = (n, plan.tests[0].name, effect, rejected / simulations, low, high, simulations, undefined)
                rows.append(dict(zip(COLUMNS, row, strict=True)))
    return pd.DataFrame(rows, columns=COLUMNS)


def _plan(study: Study, name: str | None) -> Plan:
    scales = {key: (one.low, one.high) for key, one in study.questions.items() if one.kind == "likert"}
    plan = parse_plan(study.analysis_plan(), scales)
    names = [test.name for test in plan.tests]
    if not names:
        raise InputError(problem(study.study, "analysis plan", "no test", "at least one planned test"))
    if name is not None and name not in names:
        raise InputError(problem("--test", "planned test", repr(name), " | ".join(names)))
    test = plan.tests[names.index(name) if name is not None else 0]
    return Plan((test,), plan.alpha, plan.adjust, plan.stated, plan.scales)


def _p_values(result: Result) -> dict[str, float]:
    """effect -> p of one study; the corrected or adjusted p where the test has one."""
    table = result.table
    column = next((c for c in ("p_family", "p_adjusted", "p_gg", "p") if c in table), None)
    if column is None:
        if "effect" in table and (table["status"] == "undefined").all():
            return {}
        raise InputError(problem(result.test.name, "power", f"{result.test.test}, which gives no p", "a test with p"))
    label = next((c for c in ("effect", "term", "item") if c in table), None)
    found: dict[str, float] = {}
    for index, row in enumerate(table.to_dict("records")):
        text = str(row[label]) if label else f"{row['a']} - {row['b']}" if "a" in row and "b" in row else "the test"
        p = float(row[column]) if row[column] is not None else float("nan")
        plain_p = float(row["p"]) if "p" in row else p
        if (
            not result.test.effects
            or text in result.test.effects
            or set(text.split(":")) in map(set, (effect.split(":") for effect in result.test.effects))
        ):
            found[text if text not in found else f"{text} ({index})"] = p if np.isfinite(p) else plain_p
    return found


def _said(table: pd.DataFrame, study: Study) -> str:
    """The table for a terminal, and which n reaches the wanted power for every effect."""
    lines = [f"{'n':>5}  {'effect':<28} {'power':>7}   95 % Monte Carlo"]
    for row in table.to_dict("records"):
        interval = f"{written(row['mc_low'], 'f3')} to {written(row['mc_high'], 'f3')}"
        undefined = f"   ({row['undefined']} undefined)" if row["undefined"] else ""
        lines.append(f"{row['n']:>5}  {row['effect']!s:<28} {row['power']:>7.3f}   {interval}{undefined}")
    wanted = study.analysis.power
    enough = [n for n in table["n"].unique().tolist() if (table.loc[table["n"] == n, "power"] >= wanted).all()]
    reached = f"n = {min(enough)}" if enough else "none of these n"
    lines.append(f"power {wanted:g} for every effect listed: {reached}. SIMULATED observers of the protocol.")
    return "\n".join(lines)
