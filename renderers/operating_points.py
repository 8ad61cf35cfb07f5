"""Is a technique, where its paper used it, worth its cost: or does another setting do better for less?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from renderers.catalogue import CATALOGUE

COSTS: Mapping[str, str] = {
    "ms_per_refresh": "ms a refresh",
    "cpu_ms_per_refresh": "ms of CPU a refresh",
    "primary_per_s": "primary rays a second",
}
"""Column of a cost -> its words. Times are this machine's (the CPU's, over all cores, suffers less from what else it
does); rays are what the papers count."""
CLEARLY = 0.02
"""A point is dominated by one that is nowhere worse and by this share better in cost or error; less is noise."""

Row = Mapping[str, Any]


def error_column(technique: str) -> str:
    """The error that a technique is judged by: of both eyes, or, where it follows the gaze, as far as an eye that looks
    there resolves it."""
    known = CATALOGUE.get(technique)
    return "rmse_gaze" if known is not None and known.gaze_contingent else "rmse_eyes"


def dominating(row: Row, rows: Sequence[Row], cost: str, error: str) -> Row | None:
    """The most accurate of the ``rows`` that dominate ``row``; None where it is on their front."""

    def dominates(other: Row) -> bool:
        no_worse = other[cost] <= row[cost] and other[error] <= row[error]
        return no_worse and (other[cost] < (1 - CLEARLY) * row[cost] or other[error] < (1 - CLEARLY) * row[error])

    return min((other for other in rows if dominates(other)), key=lambda other: other[error], default=None)


def operating_points(rows: Sequence[Row]) -> list[Row]:
    """The rows at each technique's operating point, in the order they were measured."""
    return [row for row in rows if row["origin"] == "default"]


def verdict(row: Row, rows: Sequence[Row], cost: str) -> tuple[Row | None, Row | None]:
    """What dominates ``row`` among the rows of other techniques, and among those of its own; None: nothing does."""
    error = error_column(row["technique"])
    others = [other for other in rows if other["technique"] != row["technique"]]
    own = [other for other in rows if other["technique"] == row["technique"]]
    return dominating(row, others, cost, error), dominating(row, own, cost, error)


def judged(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """``rows``; those of operating points with ``dominated_by``: column of the cost -> label of the other technique's
    setting that dominates, or None on the front of techniques."""
    found = []
    for row in rows:
        if row["origin"] != "default":
            found.append(dict(row))
            continue
        by = {cost: verdict(row, rows, cost)[0] for cost in COSTS}
        found.append({**row, "dominated_by": {c: None if other is None else other["label"] for c, other in by.items()}})
    return found


def lines(rows: Sequence[Row]) -> str:
    """Three lines a technique: what its operating point errs (display codes) at which cost, and whether it is on the
    front of techniques by time, by CPU time and by rays; and whether settings of its own do better."""
    out = []
    for row in operating_points(rows):
        error = error_column(row["technique"])
        for place, (cost, words) in enumerate(COSTS.items()):
            other, own = verdict(row, rows, cost)
            said = "on the front" if other is None else f"dominated by {_told(other, error, cost)}"
            if other is None and own is not None:
                said += f" (tuned: {_told(own, error, cost)})"
            what = f"{row['technique']:<22} {row[error] * 255:6.2f}" if place == 0 else " " * 29
            out.append(f"  {what} at {row[cost]:>9.4g} {words:<21}  {said}")
    return "\n".join(out)


def _told(row: Row, error: str, cost: str) -> str:
    return f"{row['label']}: {row[error] * 255:.2f} at {row[cost]:.4g}"
