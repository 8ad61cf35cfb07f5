"""`renderers.foveated.table` for people: two text tables, and bars beside the paper's Table 1."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from renderers.foveated.table import PAPER, PAPER_MEANS, RINGS_DEG, SCENES, SETTINGS, Cell, Setting, summary
from renderers.text_table import aligned

_STAGES = ("state", "move", "raster", "crossing", "marks", "select", "trace", "extract", "compose", "post filter")
_WORDS: dict[Setting, str] = {"point": "point light", "area": "area light", "ambient_occlusion": "ambient occlusion"}


def paper_speedup(cell: Cell) -> float | None:
    """What the paper has for the scene that the cell's is, or stands in for; None where it is not in Table 1."""
    named = SCENES.get(cell.scene)
    return None if named is None else PAPER[named][cell.setting][1]


def table(cells: Sequence[Cell]) -> str:
    """A line a cell: samples, times of frames and stages (ms), speed-up; the means and the paper's below."""
    stages = [stage for stage in _STAGES if any(stage in cell.stages_ms for cell in cells)]
    lines = [("scene", "light", "fewer", "full", "ours", "trace", "frame", "paper", *stages)]
    for cell in cells:
        told = paper_speedup(cell)
        lines.append((
            cell.scene, _WORDS[cell.setting], f"{100 * (1 - cell.share):.1f} %", f"{cell.full_ms:.1f}",
            f"{cell.total_ms:.1f}", f"x{cell.trace_speedup:.2f}", f"x{cell.speedup:.2f}",
            "-" if told is None else f"x{told:.2f}", *(f"{cell.stages_ms.get(stage, 0):.1f}" for stage in stages),
        ))  # fmt: skip
    found = summary(cells)
    by_light = ", ".join(f"{_WORDS[s]} x{v:.2f}" for s, v in found["trace_speedup"].items())
    return (
        f"{aligned(lines, 2)}\n"
        f"mean: {found['fewer_samples_percent']:.1f} % fewer samples (the paper: "
        f"{PAPER_MEANS['fewer_samples_percent']} %), frame x{found['speedup_mean']:.2f} ({PAPER_MEANS['speedup_mean']})"
        f", best x{found['speedup_best']:.2f} ({PAPER_MEANS['speedup_best']}); trace alone: {by_light}"
    )


def rings(cells: Sequence[Cell]) -> str:
    """A line a cell: RMSE (display values x 255) and mean FLIP of each ring of eccentricity."""
    names = [f"{low:g}-{high:g}" for low, high in pairwise(RINGS_DEG)]
    lines = [("scene", "light", *(f"rmse {name}" for name in names), *(f"flip {name}" for name in names))]
    for cell in cells:
        rmse = [_number(value, ".2f") for value in cell.rmse_by_ring]
        lines.append((cell.scene, _WORDS[cell.setting], *rmse, *(_number(value, ".3f") for value in cell.flip_by_ring)))
    return aligned(lines, 2)


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)


def plot(cells: Sequence[Cell], path: Path) -> None:
    """Speed-up of each cell beside the paper's, the time of each stage beside the full frame's, error by ring."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    speed, stage_axes, error = figure.subplots(1, 3)
    scenes = list(dict.fromkeys(cell.scene for cell in cells))
    width = 0.26
    for n, setting in enumerate(SETTINGS):
        found = [cell for cell in cells if cell.setting == setting]
        places = [scenes.index(cell.scene) + (n - 1) * width for cell in found]
        speed.bar(places, [cell.speedup for cell in found], width, color=f"C{n}", label=_WORDS[setting])
        speed.plot(
            places, [cell.trace_speedup for cell in found], ".", color="0.3", label="trace alone" if n == 0 else None
        )
        told = [(place, paper_speedup(cell)) for place, cell in zip(places, found, strict=True)]
        known = [(place, value) for place, value in told if value is not None]
        label = "the paper's frame" if n == 0 else None
        speed.plot([p for p, _ in known], [v for _, v in known], "_", color="k", ms=12, mew=2, label=label)
    speed.axhline(PAPER_MEANS["speedup_mean"], color="k", lw=0.8, ls=":")
    speed.text(len(scenes) - 0.5, PAPER_MEANS["speedup_mean"], "the paper's mean", ha="right", va="bottom", fontsize=7)
    speed.axhline(1, color="0.6", lw=0.8)
    speed.set_xticks(range(len(scenes)), scenes, fontsize=8)
    speed.set_ylabel("times faster than full ray tracing")
    speed.legend(fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.07))
    rows = [f"{cell.scene}\n{_WORDS[cell.setting]}" for cell in cells]
    left = [0.0] * len(cells)
    for n, stage in enumerate(_STAGES):
        times = [cell.stages_ms.get(stage, 0.0) for cell in cells]
        if max(times) > 0:
            stage_axes.barh(rows, times, left=left, color=f"C{n}", label=stage)
        left = [a + b for a, b in zip(left, times, strict=True)]
    stage_axes.plot([cell.full_ms for cell in cells], rows, "|", color="k", ms=10, mew=2, label="full frame")
    stage_axes.invert_yaxis()
    stage_axes.tick_params(axis="y", labelsize=6)
    stage_axes.set_xlabel("ms")
    stage_axes.legend(fontsize=6, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    for n, setting in enumerate(SETTINGS):
        for cell in (cell for cell in cells if cell.setting == setting):
            style = ("-", "--", "-.", ":")[scenes.index(cell.scene) % 4]
            label = f"{cell.scene}, {_WORDS[setting]}"
            error.stairs(cell.rmse_by_ring, RINGS_DEG, color=f"C{n}", ls=style, label=label, baseline=None)
    error.set_xlabel("eccentricity (degrees)")
    error.set_ylabel("RMSE (display values x 255)")
    error.legend(fontsize=6, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(path, dpi=110)
