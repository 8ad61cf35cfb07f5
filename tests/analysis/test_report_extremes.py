"""The report of data that a real study can produce at its edges: a page every time, and never a silent nan."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.report import analyse, render_html
from tests.analysis.fabricate import DEMO_CONDITIONS, Model, choice_plan, demo_study, write_session


def changed(*statements: str) -> Callable[[Path], None]:
    """The demo study of three participants after these SQL statements in every session file."""

    def make(folder: Path) -> None:
        for path in demo_study(folder, participants=3):
            with sqlite3.connect(path) as db:
                for statement in statements:
                    db.execute(statement)

    return make


def separated(folder: Path) -> None:
    model = Model(preference={"tdrt_240": 60.0, "vanilla_60": -60.0, "taa_240": 0.0}, person_sd=0.0)
    for number in range(3):
        rng = np.random.default_rng(number)
        plan = choice_plan(DEMO_CONDITIONS, ("a",), rng)
        write_session(folder / f"{number}.sqlite", str(number), plan, model, rng, refreshes=4)


def strange_names(folder: Path) -> None:
    for number in range(3):
        rng = np.random.default_rng(number)
        plan = choice_plan(("a <script>alert(1)</script>", "b & c"), ('sc"ene', "naïve"), rng, catch=0, practice=0)
        write_session(folder / f"{number}.sqlite", f"{number}é<b>", plan, Model(), rng, refreshes=4)


EDGES: dict[str, Callable[[Path], Any]] = {
    "one participant": lambda folder: demo_study(folder, participants=1),
    "two participants": lambda folder: demo_study(folder, participants=2),
    "all answers the same": changed(
        "UPDATE responses SET rating = 2, answer = '2' WHERE kind = 'likert'",
        "UPDATE responses SET answer = 'left' WHERE kind = 'choice'",
    ),
    "ties only": changed("UPDATE responses SET answer = 'tie', chosen = NULL WHERE kind = 'choice'"),
    "no answers": changed("DELETE FROM responses"),
    "no trials": changed("DROP TABLE trials", "DROP TABLE responses", "DROP TABLE flips"),
    "no flips, no clips": changed("DROP TABLE flips", "DROP TABLE clips"),
    "choices only": changed("DELETE FROM trials WHERE kind = 'likert'"),
    "ratings only": changed("DELETE FROM trials WHERE kind != 'likert'"),
    "an empty cell": changed("DELETE FROM trials WHERE kind = 'likert' AND scene = 'bar' AND panels LIKE '%taa%'"),
    "every trial failed": changed("UPDATE trials SET status = 'timing_failed'"),
    "a bare header": changed(
        "DELETE FROM header WHERE key NOT IN ('schema_version', 'participant', 'observer_kind', 'run', 'study')"
    ),
    "separated": separated,
    "strange names": strange_names,
}


@pytest.mark.parametrize("edge", EDGES)
def test_there_is_a_page_and_every_undefined_number_has_a_status(tmp_path: Path, edge: str) -> None:
    EDGES[edge](tmp_path)
    results = analyse([tmp_path])
    page = render_html(results)
    assert page.rstrip().endswith("</html>")
    assert "<script" not in page
    assert ">nan<" not in page
    for part in results["sections"]:
        for block in part["blocks"]:
            for row in block["rows"] if block["type"] == "table" else []:
                tested = "p" in row and "status" in row
                assert not (tested and row["p"] is None and row["status"] == "ok"), (block["id"], row)
                assert row.get("status", "ok") == "ok" or row["note"], (block["id"], row)


def test_separation_is_said_instead_of_a_large_number(tmp_path: Path) -> None:
    separated(tmp_path)
    text = render_html(analyse([tmp_path]))
    assert "separated" in text
