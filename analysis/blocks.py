"""What a report is made of, as JSON-ready mappings: tables, figures, words; and how a number is written.

HTML, CSV and LaTeX are rendered from these mappings alone, so they cannot show a number that the JSON lacks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

Block = dict[str, Any]


def plain(value: Any) -> Any:
    """JSON-ready: numpy and pandas scalars as Python's, nan as None, infinities as 'inf' and '-inf'."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple | np.ndarray | pd.Series | pd.Index):
        return [plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or value is pd.NA or value is pd.NaT:
        return None
    if isinstance(value, float):
        if math.isnan(value):
            return None
        return value if math.isfinite(value) else ("inf" if value > 0 else "-inf")
    return value


def table_block(
    identity: str,
    caption: str,
    table: pd.DataFrame,
    columns: Sequence[tuple[str, str, str]],
    note: str = "",
) -> Block:
    """A table. ``columns``: (column, heading, format of `written`); columns that ``table`` lacks are left out, and so
    is status where every row is ok. The JSON keeps every column of ``table``. ``row_notes``: the rows' notes are
    shown, each under its row and never as a column."""
    shown = [(key, label, form) for key, label, form in columns if key in table and key != "note"]
    not_ok = "status" in table and bool((table["status"].astype(str) != "ok").any())
    if not_ok:
        shown.append(("status", "status", "text"))
    return {
        "type": "table",
        "id": identity,
        "caption": caption,
        "columns": [{"key": key, "label": label, "format": form} for key, label, form in dict.fromkeys(shown)],
        "rows": [plain(row) for row in table.to_dict("records")],
        "row_notes": not_ok and "note" in table,
        "note": note,
    }


def figure_block(identity: str, caption: str, plot: str, data: Mapping[str, Any], alt: str = "") -> Block:
    """A figure: ``plot`` is a name in `analysis.plots`, ``data`` all that it draws."""
    return {
        "type": "figure",
        "id": identity,
        "caption": caption,
        "plot": plot,
        "alt": alt or caption,
        "data": plain(data),
    }


def words_block(*paragraphs: str, kind: str = "words") -> Block:
    """Paragraphs; ``kind`` 'words', 'warning' or 'sentences' (to be pasted)."""
    return {"type": kind, "paragraphs": [paragraph for paragraph in paragraphs if paragraph]}


def section(identity: str, title: str, blocks: Sequence[Block], blind: bool = False) -> dict[str, Any]:
    """A section of the report; ``blind``: may be shown while condition names are coded."""
    return {"id": identity, "title": title, "blocks": list(blocks), "blind": blind}


def number(value: float, digits: int) -> str:
    """Fixed digits with a true minus sign and no negative zero."""
    text = f"{value:.{digits}f}"
    if float(text) == 0:
        text = text.lstrip("-")
    return text.replace("-", "−")


def p_text(p: float) -> str:
    """APA: '.034', '< .001', '> .999'."""
    if p < 0.001:
        return "< .001"
    return f"{p:.3f}".removeprefix("0") if p < 0.9995 else "> .999"


def p_words(p: float) -> str:
    """APA: 'p = .034', 'p < .001'."""
    text = p_text(p)
    return f"p {text}" if text[0] in "<>" else f"p = {text}"


def f_words(test: Mapping[str, Any]) -> str:
    """A joint test ({term, df1, df2, F, p}) in APA: 'condition: F(2, 22.0) = 4.96, p = .015'."""
    statistic = f"F({test['df1']:g}, {number(test['df2'], 1)}) = {number(test['F'], 2)}"
    return f"{test['term']}: {statistic}, {p_words(test['p'])}"


def written(value: Any, form: str) -> str:
    """One cell. Forms: text, int, f1..f4 (fixed digits), p, pct0..pct2 (share as per cent), g (4 significant)."""
    if value is None:
        return "–"
    if form == "text":
        return str(value)
    if value in ("inf", "-inf"):
        return "∞" if value == "inf" else "−∞"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if form == "int":
        return f"{round(value):,}" if float(value).is_integer() else number(float(value), 1)
    if form == "p":
        return p_text(float(value))
    if form.startswith("pct"):
        return number(100.0 * float(value), int(form[3:])) + " %"
    if form.startswith("f"):
        return number(float(value), int(form[1:]))
    if form == "g":
        return f"{float(value):.4g}".replace("-", "−")
    raise ValueError(f"unknown format {form!r}")
