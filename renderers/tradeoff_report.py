"""The rows of a tradeoff as a table for people, CSV, JSON and a plot."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from renderers.operating_points import operating_points
from renderers.text_table import aligned
from renderers.tradeoff import pareto_front

_COLUMNS = (
    ("setting", "label", "{}"),
    ("ms", "ms_per_refresh", "{:.2f}"),
    ("CPU ms", "cpu_ms_per_refresh", "{:.1f}"),
    ("/vanilla", "ratio_to_vanilla", "{:.2f}"),
    ("Mrays/s", "rays_per_s", "{:.2f}"),
    ("primary/s", "primary_per_s", "{:.3g}"),
    ("RMSE still", "rmse_still", "{:.2f}"),
    ("tracking", "rmse_tracking", "{:.2f}"),
    ("FLIP still", "flip_still", "{:.4f}"),
    ("tracking", "flip_tracking", "{:.4f}"),
    ("gaze", "rmse_gaze", "{:.2f}"),
    ("flicker", "flicker", "{:.2f}"),
)
_CODES = {"rmse_still", "rmse_tracking", "rmse_gaze", "flicker"}  # shown in display codes, x 255
_BUSY = 1.5  # a run alone loads each core by about 1
_PERCEPTUAL = {"jod": "JOD", "jod_gaze": "JOD gaze"}
_COLORS = (*(f"C{k}" for k in range(10)), "black", "gold", "navy")
_MARKERS = "osD^v<>pPX*hd"


def with_ratios(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows with ``ratio_to_vanilla``: cost over that of vanilla at the display's rate in the same run, or None."""
    base = next((row["ms_per_content_frame"] for row in rows if row["label"] == "vanilla"), None)
    return [{**row, "ratio_to_vanilla": None if base is None else row["ms_per_refresh"] / base} for row in rows]


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Aligned text; errors x 255; a star marks the Pareto front of cost and error (both eyes)."""
    front = set(pareto_front(rows))
    extra = [(title, name, "{:.2f}") for name, title in _PERCEPTUAL.items() if any(name in row for row in rows)]
    columns = [*_COLUMNS, *extra]
    cells = [["", *(title for title, _, _ in columns)]]
    for i, row in enumerate(rows):
        line = ["*" if i in front else " "]
        for _, name, form in columns:
            value = row.get(name)
            if value is None:
                line.append("-")
                continue
            if name in _CODES:
                value *= 255
            if name == "rays_per_s":
                value /= 1e6
            line.append(form.format(value))
        cells.append(line)
    return aligned(cells, 2)


def spread(rows: Sequence[Mapping[str, Any]]) -> str:
    """A line a technique: how far cost and error (both eyes, x 255) go over all its settings at the display's rate."""
    fastest = max(row["content_hz"] for row in rows)
    lines = []
    for name in dict.fromkeys(row["technique"] for row in rows):
        own = [row for row in rows if row["technique"] == name and row["content_hz"] == fastest]
        errors, costs = [row["rmse_eyes"] * 255 for row in own], [row["ms_per_refresh"] for row in own]
        if own:
            lines.append(
                f"  {name:<22} {len(own):>3} settings  RMSE {min(errors):6.2f} to {max(errors):6.2f}"
                f"   ms {min(costs):7.2f} to {max(costs):7.2f}"
            )
    return "\n".join(lines)


def gold_error(rows: Sequence[Mapping[str, Any]]) -> str:
    """What the gold standard itself errs by, in words: it is part of every error measured against it."""
    own = [row["gold_rmse"] for row in rows if row.get("gold_rmse") is not None]
    return f"{own[0] * 255:.2f}" if own else "not known from one sample"


def busy(rows: Sequence[Mapping[str, Any]]) -> str:
    """A warning where the machine did much else while the rows were measured; '' where not."""
    load = max(row["load_per_core"] for row in rows)
    if load <= _BUSY:
        return ""
    return (
        f"the machine was busy (load {load:.1f} a core): ms of a refresh are not its own; go by CPU ms and rays, "
        "or measure anew with --fresh"
    )


def equal_cost(rows: Sequence[Mapping[str, Any]], cost: str, limit: float) -> list[Mapping[str, Any]]:
    """Each technique's most accurate row that costs at most ``limit`` (5 % allowed for noise), the best first."""
    best: dict[str, Mapping[str, Any]] = {}
    for row in sorted(rows, key=lambda row: row["rmse_eyes"]):
        if row[cost] <= limit * 1.05:
            best.setdefault(row["technique"], row)
    return list(best.values())


def comparisons(rows: Sequence[Mapping[str, Any]]) -> str:
    """What each technique reaches at the primary rays, and at the milliseconds, of temporally_dense's default."""
    base = next((row for row in rows if row["technique"] == "temporally_dense" and row["origin"] == "default"), None)
    if base is None:
        return ""
    lines = []
    for cost, words in (("primary_per_s", "primary rays a second"), ("ms_per_refresh", "ms a refresh")):
        lines.append(f"  at no more than {base[cost]:.4g} {words} (temporally_dense), RMSE still / tracking:")
        lines += [
            f"    {row['label']:<58} {row['rmse_still'] * 255:6.2f} / {row['rmse_tracking'] * 255:6.2f}"
            for row in equal_cost(rows, cost, base[cost])
        ]
        for eye in ("still", "tracking"):
            better = beaten_by(rows, base, cost, f"rmse_{eye}")
            lines.append(f"    its default is beaten for the {eye} eye by: {', '.join(better) or 'none'}")
    return "\n".join(lines)


def beaten_by(rows: Sequence[Mapping[str, Any]], base: Mapping[str, Any], cost: str, error: str) -> list[str]:
    """Other techniques with a row of less ``error`` than ``base`` at no more than its ``cost`` (5 % allowed for noise),
    the best first."""
    affordable = [row for row in rows if row[cost] <= 1.05 * base[cost] and row["technique"] != base["technique"]]
    affordable.sort(key=lambda row: row[error])
    return list(dict.fromkeys(row["technique"] for row in affordable if row[error] < base[error]))


def precision(rows: Sequence[Mapping[str, Any]]) -> str:
    """What half floats and 8-bit codes add to the pictures of each technique's default, in display codes."""
    lines = []
    for row in rows:
        if row["origin"] == "default":
            parts = [
                f"{kind}: adds {e['rmse_added'] * 255:.4f} (largest {e['most_added'] * 255:.3f}),"
                f" RMSE grows by {e['rmse_growth'] * 255:+.4f}"
                for kind, e in row["precision"].items()
            ]
            lines.append(f"  {row['technique']:<22} " + "   ".join(parts))
    return "\n".join(lines)


def write_csv(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """One line a row; parameters and rays as JSON text."""
    names = list(dict.fromkeys(name for row in rows for name in row if name not in ("key", "rmse_by_refresh")))
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for row in rows:
            values = [row.get(name) for name in names]
            writer.writerow([json.dumps(value) if isinstance(value, dict | list) else value for value in values])


def plot(rows_by_scene: Mapping[str, Sequence[Mapping[str, Any]]], path: Path, size_px: tuple[int, int]) -> None:
    """Error (both eyes, x 255) over cost, a panel a scene; the line is the Pareto front."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = len(rows_by_scene)
    figure = Figure(figsize=(6.4 * count + 2.2, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    names = sorted({row["technique"] for rows in rows_by_scene.values() for row in rows})
    for k, (scene, rows) in enumerate(rows_by_scene.items()):
        axes = figure.add_subplot(1, count, k + 1)
        for n, name in enumerate(names):
            own = [row for row in rows if row["technique"] == name]
            axes.plot(
                [row["ms_per_refresh"] for row in own],
                [row["rmse_eyes"] * 255 for row in own],
                _MARKERS[n % len(_MARKERS)], color=_COLORS[n % len(_COLORS)], label=name, alpha=0.85, markersize=6,
            )  # fmt: skip
        own = operating_points(rows)
        axes.plot(
            [row["ms_per_refresh"] for row in own], [row["rmse_eyes"] * 255 for row in own], "o", ms=12, mfc="none",
            mec="0.3", mew=1, label="operating point",
        )  # fmt: skip
        front = [rows[i] for i in pareto_front(rows)]
        axes.step(
            [row["ms_per_refresh"] for row in front],
            [row["rmse_eyes"] * 255 for row in front],
            where="post",
            color="0.4",
            lw=1,
            label="Pareto front",
        )
        axes.set_xscale("log")
        axes.set_xlabel("ms a refresh on this machine (log)")
        axes.set_ylabel("RMSE of both eyes, display codes")
        axes.set_title(f"{scene}, {size_px[0]}x{size_px[1]}")
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    handles = {h: label for axes in figure.axes for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    once = {label: h for h, label in handles.items()}
    figure.legend(list(once.values()), list(once), fontsize=8, loc="outside right upper")
    figure.savefig(path, dpi=130)
