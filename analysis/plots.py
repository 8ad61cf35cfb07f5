"""The report's figures: each takes the JSON data of its block and draws only what stands there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import FuncFormatter, MaxNLocator

from analysis.svg import AGREE, DISAGREE, INK, MARKERS, NEUTRAL, QUIET, SERIES, SURFACE, canvas, to_svg

WIDTH_PX = 430.0
Data = Mapping[str, Any]


def draw(plot: str, data: Data, identity: str, alt: str, simulated: bool) -> str:
    """The SVG of one figure block. Raises KeyError for a plot that does not exist."""
    figure = _PLOTS[plot](data)
    return to_svg(figure, identity, alt, simulated)


def _shorten(text: object, most: int = 22) -> str:
    words = str(text)
    return words if len(words) <= most else words[: most - 1] + "…"


def _rows_axes(axes: Axes, labels: Sequence[object], most: int = 22) -> np.ndarray:
    """Horizontal rows, the first on top; returns their y positions."""
    y = np.arange(len(labels), dtype=float)
    axes.set_yticks(y, [_shorten(label, most) for label in labels])
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.spines["left"].set_visible(False)
    return y


def likert_bars(data: Data) -> Figure:
    """Diverging stacked bars. ``rows``: label, n, shares (one a category, low to high); ``categories``: their names;
    the middle category of an odd scale is split at zero."""
    rows, categories = data["rows"], data["categories"]
    n = len(categories)
    half = n // 2
    colors = [*_spread(DISAGREE, half), *([NEUTRAL] if n % 2 else []), *_spread(AGREE, half)]
    with canvas(WIDTH_PX, 86 + 34 * len(rows)) as (figure, axes):
        y = _rows_axes(axes, [f"{_shorten(row['label'])} (n {row['n']})" for row in rows], 32)
        shares = np.array([row["shares"] for row in rows], dtype=float).reshape(len(rows), n)
        left = -shares[:, :half].sum(axis=1) - (shares[:, half] / 2 if n % 2 else 0.0)
        reach = float(np.max(np.abs(np.concatenate([left, left + shares.sum(axis=1)])), initial=0.1))
        for category in range(n):
            width = shares[:, category]
            axes.barh(y, width, left=left, height=0.72, color=colors[category], edgecolor=SURFACE, linewidth=1.2,
                      label=str(categories[category]))  # fmt: skip
            left = left + width
        axes.axvline(0, color=INK, linewidth=0.9)
        axes.set_xlim(-reach * 1.04, reach * 1.04)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{abs(v):.0%}"))
        axes.grid(axis="x")
        figure.legend(loc="outside upper center", ncols=n, handlelength=1, columnspacing=0.9, handletextpad=0.4)
    return figure


def _spread(colors: Sequence[str], n: int) -> list[str]:
    """n of the colours, from the first to the last (repeating where there are fewer)."""
    if n == 0:
        return []
    places = np.linspace(0, len(colors) - 1, n) if n > 1 else np.array([len(colors) // 2])
    return [colors[round(float(place))] for place in places]


def means(data: Data) -> Figure:
    """Means with intervals. ``x``: levels; ``series``: name, mean, low, high (one a level, null: none);
    ``lines``: joined or not; ``people``: values of participants behind a single series; ``y_label``, ``y_limits``."""
    levels, series = data["x"], data["series"]
    with canvas(WIDTH_PX, 270 + (18 if len(series) > 1 else 0)) as (figure, axes):
        x = np.arange(len(levels), dtype=float)
        for place, people in enumerate(data.get("people") or []):
            offset = _scatter_offsets(len(people))
            axes.plot(place + offset, people, "o", color=QUIET, alpha=0.5, markersize=3.4, markeredgewidth=0)
        for i, one in enumerate(series):
            shift = 0.0 if len(series) == 1 else (i - (len(series) - 1) / 2) * min(0.14, 0.6 / len(series))
            mean, low, high = (_numbers(one[key]) for key in ("mean", "low", "high"))
            known = np.isfinite(mean)
            bars = np.nan_to_num(np.stack([mean - low, high - mean]))[:, known]
            axes.errorbar(
                (x + shift)[known], mean[known], yerr=bars, color=SERIES[i % 6], marker=MARKERS[i % 6], markersize=5.5,
                markeredgecolor=SURFACE, markeredgewidth=0.8, linewidth=1.6 if data.get("lines") else 0, elinewidth=1.6,
                capsize=3, label=_shorten(one["name"], 26),
            )  # fmt: skip
        steep = max((len(str(level)) for level in levels), default=0) * len(levels) > 48
        axes.set_xticks(
            x, [_shorten(level, 18) for level in levels], rotation=28 if steep else 0, ha="right" if steep else "center"
        )
        axes.set_xlim(-0.5, len(levels) - 0.5)
        if data.get("y_limits"):
            axes.set_ylim(*data["y_limits"])
        axes.set_ylabel(data["y_label"])
        axes.grid(axis="y")
        if len(series) > 1:
            figure.legend(loc="outside upper center", ncols=min(len(series), 3), handletextpad=0.4, columnspacing=1.2)
    return figure


def _scatter_offsets(n: int) -> np.ndarray:
    """Fixed sideways offsets (golden-ratio sequence), so that the picture is the same every time."""
    return ((np.arange(n) * 0.6180339887) % 1.0 - 0.5) * 0.3


def _numbers(values: Sequence[float | None]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def shares(data: Data) -> Figure:
    """Shares with intervals against chance. ``rows``: label, share, low, high; ``chance``; ``x_label``."""
    rows = data["rows"]
    # many pairs stand closer together
    height = 34 if len(rows) <= 12 else 19
    with canvas(WIDTH_PX, 72 + height * len(rows)) as (figure, axes):
        y = _rows_axes(axes, [row["label"] for row in rows], 46 if len(rows) > 12 else 34)
        axes.tick_params(axis="y", labelsize=11.5 if len(rows) <= 12 else 10)
        share, low, high = (_numbers([row[key] for row in rows]) for key in ("share", "low", "high"))
        axes.axvline(data["chance"], color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        bars = np.clip(np.nan_to_num(np.stack([share - low, high - share])), 0, None)
        axes.errorbar(share, y, xerr=bars, fmt="o", color=SERIES[0], markersize=6.5, elinewidth=1.8, capsize=3)
        axes.set_xlim(-0.03, 1.03)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:.0%}"))
        axes.set_xlabel(data["x_label"])
        axes.grid(axis="x")
    return figure


def scale(data: Data) -> Figure:
    """A preference scale. ``rows``: item, estimate, low, high (null: no finite value); ``x_label``."""
    rows = data["rows"]
    with canvas(WIDTH_PX, 72 + 34 * len(rows)) as (figure, axes):
        y = _rows_axes(axes, [row["item"] for row in rows], 28)
        estimate, low, high = (_numbers([row[key] for row in rows]) for key in ("estimate", "low", "high"))
        known = np.isfinite(estimate)
        bars = np.nan_to_num(np.stack([estimate - low, high - estimate]))[:, known]
        axes.axvline(0, color=INK, linewidth=0.9)
        axes.errorbar(
            estimate[known], y[known], xerr=bars, fmt="o", color=SERIES[0], markersize=6.5, elinewidth=1.8, capsize=3
        )
        for place in np.flatnonzero(~known):
            axes.annotate(
                "no finite estimate", (0.5, y[place]), xycoords=("axes fraction", "data"), ha="center", color=QUIET
            )
        axes.set_xlabel(data["x_label"])
        axes.grid(axis="x")
    return figure


def win_matrix(data: Data) -> Figure:
    """How often the row was chosen over the column. ``conditions``; ``wins``: rows of counts; ``answers``: of pairs."""
    names, wins, answers = data["conditions"], np.array(data["wins"]), np.array(data["answers"])
    n = len(names)
    with canvas(WIDTH_PX, 120 + 44 * n) as (figure, axes):
        for i in range(n):
            for j in range(n):
                if i == j or answers[i, j] == 0:
                    continue
                share = wins[i, j] / answers[i, j]
                axes.fill([j - 0.5, j + 0.5, j + 0.5, j - 0.5], [i - 0.5, i - 0.5, i + 0.5, i + 0.5], color=SERIES[0],
                          alpha=0.06 + 0.6 * share, linewidth=0)  # fmt: skip
                axes.text(j, i, f"{wins[i, j]}/{answers[i, j]}", ha="center", va="center", fontsize=min(11, 74 / n))
        steep = n > 2
        axes.set_xticks(
            range(n),
            [_shorten(name, 16) for name in names],
            rotation=32 if steep else 0,
            ha="right" if steep else "center",
        )
        axes.set_yticks(range(n), [_shorten(name, 20) for name in names])
        axes.set_xlim(-0.5, n - 0.5)
        axes.set_ylim(n - 0.5, -0.5)
        axes.set_xlabel("over this one")
        axes.set_ylabel("chosen")
        for side in axes.spines.values():
            side.set_visible(False)
    return figure


def histogram(data: Data) -> Figure:
    """Counts on a logarithmic axis. ``edges``, ``counts``, ``marks`` (vertical lines), ``x_label``."""
    edges, counts = np.array(data["edges"]), np.array(data["counts"], dtype=float)
    with canvas(WIDTH_PX, 230) as (figure, axes):
        shown = counts > 0
        axes.bar(
            edges[:-1][shown], counts[shown], width=np.diff(edges)[shown], align="edge", color=SERIES[0], linewidth=0
        )
        for mark in data["marks"]:
            axes.axvline(mark, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.set_yscale("log")
        axes.set_ylim(bottom=0.5)
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:,.0f}" if v >= 1 else ""))
        axes.minorticks_off()
        axes.set_xlim(edges[0], edges[-1])
        axes.set_xlabel(data["x_label"])
        axes.set_ylabel("refreshes")
        axes.grid(axis="y")
    return figure


def trace(data: Data) -> Figure:
    """One number a refresh. ``x``, ``y``, ``mark`` (horizontal line), ``x_label``, ``y_label``."""
    with canvas(WIDTH_PX, 230) as (figure, axes):
        axes.axhline(data["mark"], color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.plot(data["x"], data["y"], color=SERIES[0], linewidth=0.9)
        axes.set_ylim(0, max([*data["y"], data["mark"]], default=1.0) * 1.15)
        axes.set_xlabel(data["x_label"])
        axes.set_ylabel(data["y_label"])
        axes.grid(axis="y")
    return figure


def heat_map(data: Data) -> Figure:
    """Where people looked. ``edges_x``, ``edges_y`` (degrees); ``cells``: [column, row, share] where share > 0."""
    edges_x, edges_y, cells = np.array(data["edges_x"]), np.array(data["edges_y"]), data["cells"]
    with canvas(WIDTH_PX, WIDTH_PX * 0.86) as (figure, axes):
        most = max((cell[2] for cell in cells), default=1.0)
        # one compound path a step of strength: a path a cell would make the page megabytes larger
        steps: dict[int, list[np.ndarray]] = {}
        for column, row, share in cells:
            (x0, x1), (y0, y1) = edges_x[column : column + 2], edges_y[row : row + 2]
            corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
            steps.setdefault(max(1, round(16 * float(np.sqrt(share / most)))), []).append(corners)
        for step, squares in sorted(steps.items()):
            codes = np.tile([Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY], len(squares))
            path = Path(np.concatenate(squares), codes)
            axes.add_patch(PathPatch(path, facecolor=SERIES[0], alpha=step / 16, linewidth=0))
        axes.plot([0], [0], "+", color=INK, markersize=9)
        axes.set_xlim(edges_x[0], edges_x[-1])
        axes.set_ylim(edges_y[0], edges_y[-1])
        axes.set_aspect("equal")
        axes.set_xlabel("degrees to the right")
        axes.set_ylabel("degrees up")
    return figure


def speed_preference(data: Data) -> Figure:
    """Cost beside preference. ``rows``: label, cost, estimate, low, high; ``x_label``, ``y_label``."""
    rows = data["rows"]
    with canvas(WIDTH_PX, 290) as (figure, axes):
        cost, estimate, low, high = (
            _numbers([row[key] for row in rows]) for key in ("cost", "estimate", "low", "high")
        )
        bars = np.nan_to_num(np.stack([estimate - low, high - estimate]))
        axes.errorbar(cost, estimate, yerr=bars, fmt="o", color=SERIES[0], markersize=6.5, elinewidth=1.6, capsize=3)
        if cost.min() > 0 and cost.max() / cost.min() > 10:
            axes.set_xscale("log")
            axes.xaxis.set_minor_formatter(FuncFormatter(lambda v, _: ""))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.margins(x=0.25)
        axes.set_xlabel(data["x_label"])
        axes.set_ylabel(data["y_label"])
        axes.grid(axis="both")
        _name_points(figure, axes, [_shorten(row["label"]) for row in rows], cost, estimate)
    return figure


def _name_points(figure: Figure, axes: Axes, names: Sequence[str], x: np.ndarray, y: np.ndarray) -> None:
    """Names beside points without overlaps: each takes the first free place around its point, with a line where it had
    to go far; measured in points after a first layout."""
    figure.draw_without_rendering()
    scale = 72 / figure.dpi
    points = axes.transData.transform(np.column_stack([x, y])) * scale
    left, right = (edge * scale for edge in (axes.bbox.x0, axes.bbox.x1))
    bottom, top = (edge * scale for edge in (axes.bbox.y0, axes.bbox.y1))
    # boxes (x0, y0, x1, y1) that are taken: the markers first
    taken = [(px - 5, py - 5, px + 5, py + 5) for px, py in points]
    for i in np.argsort(-points[:, 1], kind="stable"):
        width, height = 5.9 * len(names[i]), 12.0
        best: tuple[float, tuple[float, float, float, float]] | None = None
        for step in range(0, 14):
            for side in (1, -1):
                for rise in {0.5 * step * height, -0.5 * step * height}:
                    x0 = points[i, 0] + (8 if side > 0 else -8 - width)
                    y0 = points[i, 1] - height / 2 + rise
                    box = (x0, y0, x0 + width, y0 + height)
                    out = max(left - box[0], box[2] - right, bottom - box[1], box[3] - top, 0.0)
                    covered = sum(
                        max(0.0, min(box[2], t[2]) - max(box[0], t[0]))
                        * max(0.0, min(box[3], t[3]) - max(box[1], t[1]))
                        for t in taken
                    )
                    cost = covered * 10 + out * 50 + step
                    if best is None or cost < best[0]:
                        best = (cost, box)
        assert best is not None
        box = best[1]
        taken.append(box)
        far = abs((box[1] + box[3]) / 2 - points[i, 1]) > height
        axes.annotate(
            names[i], (x[i], y[i]), xytext=(box[0] - points[i, 0], (box[1] + box[3]) / 2 - points[i, 1]),
            textcoords="offset points", va="center", fontsize=10.5,
            arrowprops={"arrowstyle": "-", "color": QUIET, "linewidth": 0.6, "shrinkB": 4} if far else None,
        )  # fmt: skip


_PLOTS: Mapping[str, Callable[[Data], Figure]] = {
    "likert_bars": likert_bars,
    "means": means,
    "shares": shares,
    "scale": scale,
    "win_matrix": win_matrix,
    "histogram": histogram,
    "trace": trace,
    "heat_map": heat_map,
    "speed_preference": speed_preference,
}
