"""`renderers.polar.table` for people: two text tables, and plots beside the paper's Table 1."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from renderers.text_table import aligned

_MAPPING_WORDS = {"acuity": "polar, acuity (the paper's)", "equal_density": "polar, equal density"}


def times(found: Mapping[str, Any]) -> str:
    """A line a number of light samples: ms and rays of both renders, and how the time grows beside the paper's."""
    papers = found["paper_ratio_to_1_light_sample"]
    titles = ("light samples", "polar ms", "cartesian ms", "faster", "less CPU time", "polar rays", "cartesian rays")
    lines = [(*titles, "fewer", "to 1 sample", *(f"paper {rays}" for rays in papers))]
    for row in found["times"]:
        ratio = found["ratio_to_1_light_sample"].get(row["light_samples"])
        told = [paper.get(row["light_samples"]) for paper in papers.values()]
        lines.append((
            str(row["light_samples"]), f"{row['polar_ms']:.1f}", f"{row['cartesian_ms']:.1f}", f"x{row['faster']:.2f}",
            f"x{row['less_cpu_time']:.2f}", f"{row['polar_rays']:,}", f"{row['cartesian_rays']:,}",
            f"x{row['fewer_rays']:.2f}", _ratio(ratio), *(_ratio(value) for value in told),
        ))  # fmt: skip
    return aligned(lines, 0)


def errors(found: Mapping[str, Any]) -> str:
    """A line a mapping and its uniform grid: rays, RMSE (display values x 255) near the gaze and of each ring."""
    names = [f"{low:g}-{high:g}" for low, high in pairwise(found["rings_deg"])]
    lines = [("rays to", "rays", "a pixel", "within 5", *names)]
    for row in found["errors"]:
        for words, kind in ((_MAPPING_WORDS[row["mapping"]], "polar"), ("  uniform grid", "uniform")):
            one = row[kind]
            rings = ["-" if math.isnan(value) else f"{value:.2f}" for value in one["rings"]]
            lines.append((words, f"{one['rays']:,}", f"{one['rays_per_pixel']:.3f}", f"{one['near']:.2f}", *rings))
    return aligned(lines, 1)


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def plot(found: Mapping[str, Any], path: Path) -> None:
    """Frame times of both renders, their growth with light samples beside the paper's, and error by eccentricity."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4), layout="constrained")
    FigureCanvasAgg(figure)
    time_axes, growth, error = figure.subplots(1, 3)
    rows = found["times"]
    labels = [str(row["light_samples"]) for row in rows]
    for n, (name, words) in enumerate((("cartesian", "Cartesian"), ("polar", "polar"))):
        places = [k + (n - 0.5) * 0.38 for k in range(len(rows))]
        time_axes.bar(places, [row[f"{name}_ms"] for row in rows], 0.36, label=words)
    for k, row in enumerate(rows):
        time_axes.text(k + 0.19, row["polar_ms"], f"x{row['faster']:.1f}", ha="center", va="bottom", fontsize=8)
    time_axes.set_yscale("log")
    time_axes.set_xticks(range(len(rows)), labels)
    time_axes.set_xlabel("light samples")
    time_axes.set_ylabel(f"ms: four viewports scaled by {found['viewports_scaled_by']:g}, probes in both")
    time_axes.legend(fontsize=8)
    for rays, paper in found["paper_ratio_to_1_light_sample"].items():
        growth.plot([str(n) for n in paper], list(paper.values()), "--o", label=f"the paper, {rays} rays")
    ours = found["ratio_to_1_light_sample"]
    growth.plot([str(n) for n in ours], list(ours.values()), "k-o", label="here")
    growth.set_yscale("log")
    growth.set_xlabel("light samples")
    growth.set_ylabel("frame time over that of 1 light sample")
    growth.legend(fontsize=8)
    for n, row in enumerate(found["errors"]):
        for kind, style, words in (
            ("polar", "-", _MAPPING_WORDS[row["mapping"]]),
            ("uniform", ":", "uniform, as many"),
        ):
            edges = found["rings_deg"]
            error.stairs(row[kind]["rings"], edges, color=f"C{n}", ls=style, label=words, baseline=None)
    error.set_xlabel("eccentricity (degrees)")
    error.set_ylabel("RMSE (display values x 255)")
    error.legend(fontsize=8)
    figure.savefig(path, dpi=110)
