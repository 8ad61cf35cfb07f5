"""The report's tables as CSV (unrounded) and LaTeX (as the page shows them)."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from analysis.blocks import written

_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$", "–": "--", "∞": r"$\infty$", "η": r"$\eta$",
    "²": r"$^2$", "χ": r"$\chi$", "ε": r"$\varepsilon$", "′": "$'$", "<": "$<$", ">": "$>$", "“": "``", "”": "''",
}  # fmt: skip


def latex_text(text: str) -> str:
    """Text with LaTeX's own characters escaped and the report's symbols in mathematics."""
    return "".join(_LATEX.get(character, character) for character in text)


def to_csv(block: Mapping[str, Any], simulated: bool) -> str:
    """Every column of the block, unrounded; and ``observer_kind`` where no person answered."""
    names = list(dict.fromkeys(name for row in block["rows"] for name in row))
    if not names:
        names = [column["key"] for column in block["columns"]]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*names, *(["observer_kind"] if simulated else [])])
    for row in block["rows"]:
        values = ["" if row.get(name) is None else row[name] for name in names]
        writer.writerow([*values, *(["simulated"] if simulated else [])])
    return text.getvalue()


def to_latex(block: Mapping[str, Any], simulated: bool) -> str:
    """A booktabs table with the page's columns, headings and rounding; the caption says where it is simulated.

    A row's note stands under it, as on the page.
    """
    columns = block["columns"]
    shape = "".join("l" if column["format"] == "text" else "r" for column in columns)
    caption = ("SIMULATED, no person answered. " if simulated else "") + block["caption"]
    lines = [
        r"\begin{table}",
        rf"\caption{{{latex_text(caption)}}}",
        rf"\label{{tab:{block['id']}}}",
        rf"\begin{{tabular}}{{{shape}}}",
        r"\toprule",
        " & ".join(latex_text(column["label"]) for column in columns) + r" \\",
        r"\midrule",
    ]
    for row in block["rows"]:
        cells = [latex_text(written(row.get(column["key"]), column["format"])) for column in columns]
        lines.append(" & ".join(cells) + r" \\")
        if block["row_notes"] and row.get("note"):
            said = rf"\footnotesize {latex_text(row['note'])}"
            lines.append(rf"\multicolumn{{{len(columns)}}}{{p{{\linewidth}}}}{{{said}}} \\")
    lines += [r"\bottomrule", r"\end{tabular}"]
    if block.get("note"):
        lines.append(rf"\par\smallskip\footnotesize {latex_text(block['note'])}")
    return "\n".join([*lines, r"\end{table}", ""])


def write_tables(results: Mapping[str, Any], folder: Path) -> list[Path]:
    """``ID.csv`` and ``ID.tex`` for every table of the report; returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for part in results["sections"]:
        for block in part["blocks"]:
            if block["type"] != "table":
                continue
            for ending, make in (("csv", to_csv), ("tex", to_latex)):
                path = folder / f"{block['id']}.{ending}"
                path.write_text(make(block, bool(results["simulated"])), encoding="utf-8")
                paths.append(path)
    return paths
