"""Refresh timing from the per-refresh record: was every frame on the screen when it was due, and at what rate."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pandas as pd

from analysis.rows import rows_of_table
from analysis.sessions import Session
from analysis.streams import read_flips
from protocols.records import FLIP_EARLY, FLIP_PHASE_SLIP

HISTOGRAM_BINS = 60


@dataclass(frozen=True)
class Timing:
    """``sessions``: one row a session; ``panels``: one row a panel shown (participant, trial, condition, achieved_hz,
    missed, refreshes); ``edges_ms``/``counts``: histogram of the interval from refresh to refresh over all sessions;
    ``trace``: intervals of the trial with the most missed refreshes. ``period_ms``: the nominal refresh."""

    sessions: pd.DataFrame
    panels: pd.DataFrame
    edges_ms: np.ndarray
    counts: np.ndarray
    trace: pd.DataFrame
    trace_of: str
    period_ms: float


SESSION_COLUMNS = [
    "participant",
    "session",
    "stamp_class",
    "nominal_hz",
    "measured_hz",
    "trials",
    "refreshes",
    "missed",
    "missed_share",
    "worst_trial_missed",
    "interval_median_ms",
    "interval_sd_ms",
    "interval_p99_ms",
    "interval_max_ms",
    "late_p99_ms",
    "phase_slips",
    "early",
    "upload_median_ms",
    "draw_median_ms",
    "gaze_age_p95_ms",
]


def refresh_timing(sessions: Sequence[Session], progress: Callable[[], object] = lambda: None) -> Timing:
    """Summarise every session's flips; ``progress`` is called once a session.

    Sessions without a per-refresh record still appear, with the trial table's counts and nan intervals.
    """
    rows, panels, all_counts = [], [], np.zeros(HISTOGRAM_BINS, dtype=np.int64)
    nominal = [_refresh_hz(session) for session in sessions]
    known = [hz for hz in nominal if np.isfinite(hz)]
    period_ms = 1000.0 / known[0] if known else 1000.0 / 240.0
    # one histogram for all: 0 to 4 periods, later intervals in the last bin
    edges_ms = np.linspace(0.0, 4.0 * period_ms, HISTOGRAM_BINS + 1)
    worst: tuple[int, str, pd.DataFrame] = (-1, "", pd.DataFrame(columns=["refresh", "interval_ms"]))
    for session, nominal_hz in zip(sessions, nominal, strict=True):
        flips = read_flips(session)
        row, own_counts = _session_row(session, flips, nominal_hz, edges_ms)
        rows.append(row)
        all_counts += own_counts
        panels += _panel_rows(session, flips)
        trial, missed = _worst_trial(flips)
        if missed > worst[0]:
            worst = (missed, f"participant {session.participant}, trial {trial}", _trace(flips[trial]))
        progress()
    table = pd.DataFrame(rows, columns=SESSION_COLUMNS)
    columns = ["participant", "trial", "slot", "condition", "rate_hz", "achieved_hz", "missed", "refreshes"]
    return Timing(table, pd.DataFrame(panels, columns=columns), edges_ms, all_counts, worst[2], worst[1], period_ms)


def _refresh_hz(session: Session) -> float:
    """The display's rate as the header has it: a number, or an exact rational as text."""
    stated = session.header.get("refresh_hz")
    return float(Fraction(str(stated))) if stated is not None else float("nan")


def _session_row(
    session: Session, flips: dict[int, np.ndarray], nominal_hz: float, edges_ms: np.ndarray
) -> tuple[dict, np.ndarray]:
    trials = session.trials
    shown, missed = int(trials["refreshes"].sum()), int(trials["missed"].sum())
    certificate = session.header.get("certificate") or {}
    row = {
        "participant": session.participant,
        "session": session.path.stem,
        "stamp_class": session.header.get("stamp_class", "unknown"),
        "nominal_hz": nominal_hz,
        "measured_hz": float(certificate.get("measured_hz") or np.nan),
        "trials": int((trials["refreshes"] > 0).sum()),
        "refreshes": shown,
        "missed": missed,
        "missed_share": missed / (shown + missed) if shown + missed else np.nan,
        "worst_trial_missed": int(trials["missed"].max()) if len(trials) else 0,
        "phase_slips": 0,
        "early": 0,
    }
    for name in SESSION_COLUMNS[10:15] + SESSION_COLUMNS[17:]:
        row[name] = np.nan
    if not flips:
        return row, np.zeros(len(edges_ms) - 1, dtype=np.int64)
    # intervals within a trial only: the pause between trials is not an interval
    interval_ms = np.concatenate([np.diff(trial["shown_ns"]) for trial in flips.values()]) * 1e-6
    record = np.concatenate(list(flips.values()))
    late_ms = (record["shown_ns"] - record["due_ns"]) * 1e-6
    gaze_age_ms = record["gaze_age_ns"][record["gaze_age_ns"] >= 0] * 1e-6
    row.update(
        late_p99_ms=float(np.quantile(late_ms, 0.99)),
        phase_slips=int(np.count_nonzero(record["flags"] & FLIP_PHASE_SLIP)),
        early=int(np.count_nonzero(record["flags"] & FLIP_EARLY)),
        upload_median_ms=float(np.median(record["upload_ns"])) * 1e-6,
        draw_median_ms=float(np.median(record["draw_ns"])) * 1e-6,
        gaze_age_p95_ms=float(np.quantile(gaze_age_ms, 0.95)) if gaze_age_ms.size else np.nan,
    )
    if interval_ms.size:
        row.update(
            interval_median_ms=float(np.median(interval_ms)),
            interval_sd_ms=float(interval_ms.std(ddof=1)) if interval_ms.size > 1 else np.nan,
            interval_p99_ms=float(np.quantile(interval_ms, 0.99)),
            interval_max_ms=float(interval_ms.max()),
        )
    inside = np.clip(interval_ms, edges_ms[0], edges_ms[-1])
    return row, np.histogram(inside, bins=edges_ms)[0]


def _panel_rows(session: Session, flips: dict[int, np.ndarray]) -> list[tuple]:
    """Achieved content rate of every panel: new source frames per second of its own showing."""
    rows = []
    plan = session.header.get("plan") or []
    for trial in rows_of_table(session.trials):
        record = flips.get(trial.trial)
        if record is None or not 0 <= trial.planned < len(plan):
            continue
        for place, panel in enumerate(plan[trial.planned].get("panels", ())):
            shown = record[record["source"][:, place] >= 0]
            if len(shown) < 2:
                continue
            frames = 1 + int(np.count_nonzero(np.diff(shown["source"][:, place])))
            # the last refresh stays for one period as well
            span_ns = int(shown["shown_ns"][-1] - shown["shown_ns"][0])
            seconds = span_ns * 1e-9 * len(shown) / (len(shown) - 1)
            achieved = frames / seconds if seconds > 0 else np.nan
            rate_hz = float(Fraction(str(panel.get("rate_hz", "nan")))) if panel.get("rate_hz") else np.nan
            lost = int(shown["missed"].sum())
            rows.append(
                (
                    session.participant,
                    trial.trial,
                    panel["slot"],
                    panel["condition"],
                    rate_hz,
                    achieved,
                    lost,
                    len(shown),
                )
            )
    return rows


def _worst_trial(flips: dict[int, np.ndarray]) -> tuple[int, int]:
    if not flips:
        return -1, -1
    missed = {trial: int(record["missed"].sum()) for trial, record in flips.items()}
    trial = max(missed, key=lambda t: (missed[t], len(flips[t])))
    return trial, missed[trial]


def _trace(record: np.ndarray) -> pd.DataFrame:
    """Interval before each refresh of one trial, in milliseconds to the microsecond."""
    interval_ms = np.round(np.diff(record["shown_ns"]) * 1e-6, 3)
    return pd.DataFrame({"refresh": record["refresh"][1:] - record["refresh"][0], "interval_ms": interval_ms})


def onset_statement(sessions: Sequence[Session]) -> str:
    """How well the moment of light is known: one sentence for the methods paragraph.

    A sensor counts only where the certificate holds its measurement (``light``: mean and SD of flip to light).
    """
    classes = sorted({str(session.header.get("stamp_class", "unknown")) for session in sessions})
    lights = [(session.header.get("certificate") or {}).get("light") for session in sessions]
    if lights and all(isinstance(light, dict) and "mean_ms" in light for light in lights):
        mean_ms = float(np.mean([light["mean_ms"] for light in lights if light]))
        sd_ms = float(np.max([light.get("sd_ms", np.nan) for light in lights if light]))
        return f"Onset measured by a light sensor: {mean_ms:.2f} ms after the flip (largest SD {sd_ms:.2f} ms)."
    return f"Onset by software stamp (stamp class {', '.join(classes)}); no light sensor confirmed it."


def overrides(sessions: Sequence[Session]) -> list[dict[str, str]]:
    """Named overrides that stand in the data: participant, check, reason."""
    rows = []
    for session in sessions:
        for one in session.header.get("overrides") or []:
            said = one if isinstance(one, dict) else json.loads(one)
            rows.append({"participant": session.participant, "check": said["check"], "reason": said["reason"]})
    return rows
