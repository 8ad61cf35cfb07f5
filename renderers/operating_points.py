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
    """The most accurate of the ``rows`` that dominate ``row``; None where it is on the front."""

    def dominates(other: Row) -> bool:
        no_worse = other[cost] <= row[cost] and other[error] <= row[error]
        return no_worse and (other[cost] < (1 - CLEARLY) * row[cost] or other[error] < (1 - CLEARLY) * row[error])

    return min((other for other in rows if dominates(other)), key=lambda other: other[error], default=None)


def operating_points(rows: Sequence[Row]) -> list[Row]:
    """The rows at each technique's operating point, in the order they were measured."""
    return [row for row in rows if row["origin"] == "default"]


def judged(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """``rows``; those of operating points with ``dominated_by``: column of the cost -> label of what dominates, or None
    on the front."""
    found = []
    for row in rows:
        error = error_column(row["technique"])
        by = {cost: dominating(row, rows, cost, error) for cost in COSTS}
        labels = {cost: None if other is None else other["label"] for cost, other in by.items()}
        found.append({**row, "dominated_by": labels} if row["origin"] == "default" else dict(row))
    return found


def lines(rows: Sequence[Row]) -> str:
    """Three lines a technique: what its operating point errs (display codes) at which cost, and whether it is on the
    front of time, of CPU time and of rays."""
    out = []
    for row in operating_points(rows):
        error = error_column(row["technique"])
        for place, (cost, words) in enumerate(COSTS.items()):
            other = dominating(row, rows, cost, error)
            verdict = "on the front"
            if other is not None:
                verdict = f"dominated by {other['label']}: {other[error] * 255:.2f} at {other[cost]:.4g}"
            what = f"{row['technique']:<22} {row[error] * 255:6.2f}" if place == 0 else " " * 29
            out.append(f"  {what} at {row[cost]:>9.4g} {words:<21}  {verdict}")
    return "\n".join(out)
