"""Were answers about the pictures? Side, interval, key, trial-number and previous-trial effects, triads, catch trials.

Each effect is one number a participant, tested over participants (t of the mean against its value without the effect).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from scipy import stats

from analysis.comparisons import choice_row, with_winner
from analysis.sessions import Session
from analysis.within_means import one_sample

EFFECT_COLUMNS = ["effect", "measure", "n", "mean", "expected", "ci_low", "ci_high", "t", "df", "p", "status", "note"]


def _row(effect: str, measure: str, values: Sequence[float] | np.ndarray, expected: float) -> dict[str, object]:
    return {"effect": effect, "measure": measure, "expected": expected, **one_sample(values, expected)}


def response_effects(kept: pd.DataFrame, sessions: Sequence[Session]) -> pd.DataFrame:
    """`EFFECT_COLUMNS`: every effect that the answers allow to be tested, over the analysed trials."""
    rows: list[dict[str, object]] = []
    chosen = kept[kept["side"].notna()]
    for kind, what in ((("side_by_side", "forced_choice"), "side"), (("two_interval",), "interval")):
        own = chosen[chosen["kind"].isin(kind)]
        if len(own):
            rows.append(_slot_effect(own, what))
            rows.append(_repeat_effect(own, what))
    rows += _key_effects(kept, sessions)
    rated = kept[np.isfinite(kept["rating"].astype(float))]
    if len(rated):
        centred = _centred_on_condition(rated)
        slopes = _by_person(*_within_blocks(rated, centred), _slope_per_100)
        rows.append(_row("trial number", "rating per 100 trials of a block", slopes, 0.0))
        rows.append(_row("previous trial", "slope on the previous rating", _by_person(rated, centred, _lag_slope), 0.0))
    timed = kept[kept["rt_s"].astype(float) > 0]
    if len(timed):
        log_rt = pd.Series(np.log(timed["rt_s"].to_numpy(dtype=float)), index=timed.index)
        timed, log_rt = _within_blocks(timed, log_rt)
        slopes = _by_person(timed, log_rt, _slope_per_100)
        rows.append(_row("practice or fatigue", "log response time per 100 trials of a block", slopes, 0.0))
    return pd.DataFrame(rows, columns=EFFECT_COLUMNS)


def _slot_effect(own: pd.DataFrame, what: str) -> dict[str, object]:
    """Share of answers for the last slot in reading order (right, second): one half without a bias."""
    slots = sorted(own["side"].astype(str).unique())
    slot = next((name for name in ("right", "second") if name in slots), slots[-1])
    shares = (own["side"] == slot).groupby(own["participant"], sort=False).mean()
    panels = int(max(1 + own["condition"].astype(str).str.count(r"\|").max(), 2))
    if len(shares) == len(own):
        # one answer a participant: the exact test, whose interval stays a share
        found = choice_row(own.assign(chosen=(own["side"] == slot).astype(float)), 1.0 / panels)
        row: dict[str, object] = {"effect": what, "measure": f"share of '{slot}'", "expected": 1.0 / panels}
        row |= {"n": len(own), "mean": found["share"], "ci_low": found["exact_low"], "ci_high": found["exact_high"]}
        return row | {name: found[name] for name in ("t", "df", "p", "status", "note")}
    return _row(what, f"share of '{slot}'", shares.to_numpy(dtype=float), 1.0 / panels)


def _in_order(table: pd.DataFrame) -> pd.DataFrame:
    """Rows as they were shown: trials are numbered by session, and a participant may have several."""
    return table.sort_values([name for name in ("session", "trial") if name in table])


def _repeat_effect(own: pd.DataFrame, what: str) -> dict[str, object]:
    """How much more often the previous slot is chosen again than the participant's own slot shares predict."""
    excess = []
    for _, mine in _in_order(own).groupby("participant", sort=False):
        side = mine["side"].to_numpy(dtype=object)
        if len(side) < 3:
            continue
        counts = pd.Series(side).value_counts().to_numpy(dtype=float)
        # drawing two answers without replacement: the chance of a repeat in a random order of these answers
        expected = float((counts * (counts - 1)).sum() / (len(side) * (len(side) - 1)))
        excess.append(float(np.mean(side[1:] == side[:-1])) - expected)
    return _row("previous trial", f"repeated {what} beyond chance", excess, 0.0)


def _key_effects(kept: pd.DataFrame, sessions: Sequence[Session]) -> list[dict[str, object]]:
    """Welch's t between participants with different key mappings, on the mean rating or the share of one condition."""
    mapping = {session.participant: key_mapping(session) for session in sessions}
    groups = sorted({name for name in mapping.values() if name})
    if len(groups) != 2:
        return []
    rows = []
    rated = kept[np.isfinite(kept["rating"].astype(float))]
    if len(rated):
        means = rated.groupby("participant", sort=False)["rating"].mean()
        rows.append(_two_groups("mean rating", means, mapping, groups))
    compared = with_winner(kept)
    if len(compared):
        first = sorted(set(compared["winner"]) | set(compared["loser"]))[0]
        own = compared[(compared["winner"] == first) | (compared["loser"] == first)]
        shares = (own["winner"] == first).groupby(own["participant"], sort=False).mean()
        rows.append(_two_groups(f"share choosing {first}", shares, mapping, groups))
    return rows


def key_mapping(session: Session) -> str:
    """The participant's key mapping in words ('f=left j=right'), '' where the plan holds none."""
    for trial in session.header.get("plan") or []:
        for question in trial.get("questions", ()):
            if question.get("keys"):
                return " ".join(f"{key}={answer}" for key, answer in sorted(question["keys"].items()))
    return ""


def _two_groups(measure: str, values: pd.Series, mapping: dict[str, str], groups: Sequence[str]) -> dict[str, object]:
    parts = [
        values[[person for person in values.index if mapping.get(person) == name]].to_numpy(float) for name in groups
    ]
    nan = float("nan")
    row: dict[str, object] = dict.fromkeys(EFFECT_COLUMNS, nan)
    row |= {
        "effect": "key mapping",
        "measure": f"{measure}: {groups[0]} less {groups[1]}",
        "expected": 0.0,
        "n": sum(map(len, parts)),
    }
    if min(map(len, parts)) < 2:
        return row | {"status": "too_few_subjects", "note": "2 participants a mapping needed"}
    variance = [part.var(ddof=1) / len(part) for part in parts]
    error = float(np.sqrt(sum(variance)))
    difference = float(parts[0].mean() - parts[1].mean())
    row["mean"] = difference
    if error <= 64 * np.finfo(float).eps * max(float(np.abs(np.concatenate(parts)).max()), 1e-300):
        return row | {"status": "zero_error_variance", "note": "no spread within either mapping"}
    df = sum(variance) ** 2 / sum(v**2 / (len(part) - 1) for v, part in zip(variance, parts, strict=True))
    half = float(stats.t.ppf(0.975, df)) * error
    t = difference / error
    row |= {"ci_low": difference - half, "ci_high": difference + half, "t": t, "df": float(df)}
    return row | {"p": float(2 * stats.t.sf(abs(t), df)), "status": "ok", "note": ""}


def _centred_on_condition(rated: pd.DataFrame) -> pd.Series:
    """Ratings less the mean of their scene and condition, so that the order of conditions plays no part."""
    rating = rated["rating"].astype(float)
    return rating - rating.groupby([rated["scene"], rated["condition"]], sort=False).transform("mean")


def _within_blocks(table: pd.DataFrame, values: pd.Series) -> tuple[pd.DataFrame, pd.Series]:
    """Trial numbers and values less the participant's mean in their block: blocks ask for different things, and one
    that is slower and comes later is no fatigue."""
    keys = [table["participant"], table["block"]]
    trial = table["trial"].astype(float)
    centred = table.assign(trial=trial - trial.groupby(keys, sort=False).transform("mean"))
    return centred, values - values.groupby(keys, sort=False).transform("mean")


def _by_person(
    table: pd.DataFrame, values: pd.Series, measure: Callable[[np.ndarray, np.ndarray], float]
) -> list[float]:
    found = []
    for _, rows in _in_order(table).groupby("participant", sort=False):
        found.append(measure(rows["trial"].to_numpy(dtype=float), values[rows.index].to_numpy(dtype=float)))
    return found


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    """Least-squares slope; nan where x does not vary."""
    x, y = x - x.mean(), y - y.mean()
    return float(x @ y / (x @ x)) if len(x) > 2 and x @ x > 0 else float("nan")


def _slope_per_100(trial: np.ndarray, value: np.ndarray) -> float:
    return 100.0 * _slope(trial, value)


def _lag_slope(trial: np.ndarray, value: np.ndarray) -> float:
    """Slope of a trial's value on the one before; the bias of -1/(n - 1) that a random order gives is added back."""
    return _slope(value[:-1], value[1:]) + 1.0 / (len(value) - 1) if len(value) > 3 else float("nan")
