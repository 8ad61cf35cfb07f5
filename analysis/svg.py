"""Matplotlib figures as inline SVG whose colours are CSS variables: one picture serves light, dark and print."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

import matplotlib

matplotlib.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Colours that matplotlib is told, and the CSS variable that each becomes in the page.
INK, QUIET, GRID, SURFACE = "#010101", "#020202", "#030303", "#040404"
SERIES = ("#110101", "#110202", "#110303", "#110404", "#110505", "#110606")
DISAGREE = ("#210101", "#210202", "#210303")  # strong, middle, weak
NEUTRAL = "#210404"
AGREE = ("#210505", "#210606", "#210707")  # weak, middle, strong
_VARIABLES = {
    INK: "--ink",
    QUIET: "--quiet",
    GRID: "--grid",
    SURFACE: "--surface",
    **{code: f"--series-{i + 1}" for i, code in enumerate(SERIES)},
    **{code: f"--disagree-{i + 1}" for i, code in enumerate(DISAGREE)},
    NEUTRAL: "--neutral",
    **{code: f"--agree-{i + 1}" for i, code in enumerate(AGREE)},
}
MARKERS = ("o", "s", "^", "D", "v", "P")
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "report",
    "font.family": "sans-serif",
    "font.size": 11.5,
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.size": 3,
    "ytick.major.size": 0,
    "legend.frameon": False,
    "legend.fontsize": 10.5,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


@contextmanager
def canvas(width_px: float, height_px: float) -> Iterator[tuple[Figure, Axes]]:
    """A figure of this size (CSS pixels) with one set of axes, in the report's style."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width_px / 72, height_px / 72), layout="constrained")
        yield figure, figure.add_subplot()


def to_svg(figure: Figure, identity: str, alt: str, simulated: bool) -> str:
    """The figure as one ``<svg>`` element. ``identity`` makes its ids unique in the page; ``alt`` describes it."""
    buffer = io.StringIO()
    with matplotlib.rc_context(_STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    # ids are unique within a figure only
    text = re.sub(r'id="([^"]+)"', rf'id="{identity}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{identity}-\1)", text)
    text = re.sub(r'xlink:href="#([^"]+)"', rf'xlink:href="#{identity}-\1"', text)
    for code, variable in _VARIABLES.items():
        text = text.replace(code, f"var({variable})")
    text = re.sub(r"font: ([0-9.]+)px [^;\"]*", r"font: \1px var(--font)", text)
    found = re.search(r'viewBox="0 0 ([0-9.]+) ([0-9.]+)"', text)
    width, height = (float(found[1]), float(found[2])) if found else (400.0, 300.0)
    opening = (
        f'<svg xmlns:xlink="http://www.w3.org/1999/xlink" xmlns="http://www.w3.org/2000/svg" '
        f'viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(alt)}" '
        f'style="max-width:{width * 1.15:.0f}px">'
    )
    text = re.sub(r"<svg[^>]*>", lambda _: opening, text, count=1)
    if simulated:
        mark = (
            f'<text class="stamp" x="{width / 2:g}" y="{height / 2:g}" text-anchor="middle" dominant-baseline="middle" '
            f'transform="rotate(-18 {width / 2:g} {height / 2:g})" font-size="{min(width / 7, height / 3):.0f}">'
            "SIMULATED</text>"
        )
        text = text.replace("</svg>", mark + "</svg>")
    return text.strip()
