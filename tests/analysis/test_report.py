"""The report: numbers from the generating model, HTML from JSON alone, marks on simulated data, one offline page."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from analysis.blocks import table_block
from analysis.report import analyse, render_html
from analysis.tables import to_latex
from tests.analysis.fabricate import DEMO_CONDITIONS, demo_study


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo")
    demo_study(folder, participants=12, gaze_hz=120)
    return folder


@pytest.fixture(scope="module")
def results(study: Path) -> dict[str, Any]:
    return analyse([study])


@pytest.fixture(scope="module")
def page(results: dict[str, Any]) -> str:
    return render_html(results)


def block(results: dict[str, Any], identity: str) -> dict[str, Any]:
    return next(one for part in results["sections"] for one in part["blocks"] if one.get("id") == identity)


def blocks(results: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [one for part in results["sections"] for one in part["blocks"] if one["type"] == kind]


def test_the_best_condition_of_the_model_is_ranked_first(results: dict[str, Any]) -> None:
    assert block(results, "scale-plot")["data"]["rows"][0]["item"] == "tdrt_240"
    means = block(results, "means-smooth")["data"]
    assert means["x"] == ["tdrt_240", "taa_240", "vanilla_60"]
    assert np.all(np.diff(means["series"][0]["mean"]) < 0)


@pytest.mark.parametrize(
    ("listed", "shown"),
    [
        ("{condition: {taa_240: {}, vanilla_60: {}, tdrt_240: {}}, scene: [toy_car, bar]}", True),
        ("{condition: [taa_240, vanilla_60], scene: [toy_car, bar]}", False),  # not all: by their means
    ],
)
def test_levels_stand_as_the_protocol_lists_them(tmp_path: Path, listed: str, shown: bool) -> None:
    text = f"blocks:\n  - {{name: hello, kind: text}}\n  - {{name: main, factors: {listed}}}\n"
    demo_study(tmp_path, participants=3, header={"protocol_text": text})
    made = analyse([tmp_path])
    levels = ["taa_240", "vanilla_60", "tdrt_240"] if shown else ["tdrt_240", "taa_240", "vanilla_60"]
    assert block(made, "means-smooth")["data"]["x"] == levels
    assert [row["label"] for row in block(made, "likert-smooth")["data"]["rows"]] == levels
    assert [row["condition"] for row in block(made, "summary-smooth")["rows"]] == levels
    lines = block(made, "interaction-smooth-scene")["data"]
    assert lines["x"] == levels
    assert [one["name"] for one in lines["series"]] == ["toy_car", "bar"]


def test_win_matrix_counts_every_analysed_comparison_once(results: dict[str, Any]) -> None:
    data = block(results, "win-matrix")["data"]
    assert data["conditions"] == sorted(DEMO_CONDITIONS)
    assert np.sum(data["wins"]) == 12 * 3 * 2
    assert np.array_equal(np.add(data["wins"], np.transpose(data["wins"])), data["answers"])


def test_pooled_counts_are_named_so_and_the_participant_is_the_unit(results: dict[str, Any]) -> None:
    pairs = block(results, "pairs")
    assert {row["unit"] for row in pairs["rows"]} == {"participants"}
    assert [c["label"] for c in pairs["columns"] if c["key"] == "pooled"] == ["pooled, not for inference"]
    assert all(row["n"] == 12 and row["pooled_n"] == 24 for row in pairs["rows"])


def test_onset_is_by_software_stamp_without_a_sensor(page: str) -> None:
    assert "Onset by software stamp" in page


def test_html_is_the_same_from_the_json_file(results: dict[str, Any], page: str, tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text(json.dumps(results, allow_nan=False))
    assert render_html(json.loads(path.read_text())) == page


def shown_cells(page: str) -> dict[str, list[list[str]]]:
    """table id -> rows of cell texts, read back from the page."""
    found = {}
    for identity, body in re.findall(r'<div class="table" id="([^"]+)">.*?<tbody>(.*?)</tbody>', page, flags=re.S):
        rows = re.findall(r"<tr>(.*?)</tr>", body, flags=re.S)
        found[identity] = [
            [unescape(cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", row, flags=re.S)] for row in rows
        ]
    return found


def test_every_number_in_a_table_of_the_page_is_that_of_the_json(results: dict[str, Any], page: str) -> None:
    cells = shown_cells(page)
    checked = 0
    for table in blocks(results, "table"):
        columns = table["columns"]
        for row, texts in zip(table["rows"], cells[table["id"]], strict=False):
            for column, text in zip(columns, texts, strict=True):
                value = row[column["key"]]
                if not isinstance(value, float | int) or isinstance(value, bool) or column["format"] in ("text", "p"):
                    continue
                number = float(text.replace("−", "-").replace(",", "").removesuffix(" %"))
                scale = 100.0 if column["format"].startswith("pct") else 1.0
                decimals = len(text.removesuffix(" %").partition(".")[2])
                tolerance = max(0.5000001 * 10.0**-decimals, 5e-4 * abs(value) * (column["format"] == "g"))
                assert abs(number - scale * value) <= tolerance, (table["id"], column, text, value)
                checked += 1
    assert checked > 300


def test_a_note_stands_under_its_row() -> None:
    rows = [{"effect": "a", "p": 0.01, "note": ""}, {"effect": "b", "p": 0.02, "note": "p is <right>"}]
    columns = [("effect", "effect", "text"), ("p", "p", "p"), ("note", "note", "text")]
    made = pd.DataFrame(rows).assign(status=["ok", "boundary"])
    assert not table_block("t", "t", made.iloc[:1], columns)["row_notes"]
    table = table_block("t", "t", made, columns)
    head = {"title": "t", "study": "s", "simulated": False, "blind": False, "glance": [], "observer_kind": "person"}
    page = render_html({**head, "format": 1, "sections": [{"id": "x", "title": "x", "blocks": [table]}]})
    assert shown_cells(page)["t"] == [["a", ".010", "ok"], ["b", ".020", "boundary"]]
    under = re.findall(r'<tr class="under"><td class="text" colspan="3">(.*?)</td></tr>', page)
    assert under == ["p is &lt;right&gt;"]
    lines = to_latex(table, simulated=False).splitlines()
    assert r"effect & p & status \\" in lines
    under = lines[lines.index(r"b & .020 & boundary \\") + 1]
    assert under == r"\multicolumn{3}{p{\linewidth}}{\footnotesize p is $<$right$>$} \\"
    assert sum("multicolumn" in line for line in lines) == 1


def test_simulated_stands_across_every_figure_and_table(results: dict[str, Any], page: str) -> None:
    tables = [re.split(r"<figure|<h2|<footer", one)[0] for one in page.split('<div class="table"')[1:]]
    figures = re.findall(r"<figure.*?</figure>", page, flags=re.S)
    assert len(tables) == len(blocks(results, "table")) > 10
    assert len(figures) == len(blocks(results, "figure")) > 8
    assert all("SIMULATED" in one for one in [*tables, *figures])


def test_a_study_of_persons_is_not_marked(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=3, observer_kind="person")
    assert "SIMULATED" not in render_html(analyse([tmp_path]))


def test_the_page_fetches_nothing(page: str) -> None:
    rest = page.replace("http://www.w3.org/1999/xlink", "").replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?:|//[a-z]|@import|<script|<link|src=", rest)
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))


def test_the_same_sessions_give_the_same_bytes(study: Path, results: dict[str, Any], page: str) -> None:
    again = analyse([study])
    assert again == results
    assert render_html(again) == page
