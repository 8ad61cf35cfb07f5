"""A blind report gives nothing away, and locks the exclusions before names are shown."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from analysis.report import analyse, render_html
from analysis.write_report import LOCK_NAME, write_report
from stimuli.errors import InputError
from tests.analysis.fabricate import DEMO_CONDITIONS, demo_study


def test_no_condition_name_rate_or_answer_is_in_a_blind_page(tmp_path: Path) -> None:
    demo_study(tmp_path, participants=4, missed={5: 2}, gaze_hz=60)
    results = analyse([tmp_path], blind=True)
    text = json.dumps(results) + render_html(results)
    for name in (*DEMO_CONDITIONS, "tdrt", "vanilla", "taa"):
        assert name not in text
    assert [part["id"] for part in results["sections"]] == ["participants", "manipulation", "timing", "gaze", "methods"]
    manipulation = results["sections"][1]["blocks"][0]
    assert sorted(row["condition"] for row in manipulation["rows"]) == ["C1", "C2", "C3", "C4"]
    assert not {"cost_ms", "achieved_hz", "luminance", "rays"} & set(manipulation["rows"][0])


def test_the_open_report_says_that_the_locked_exclusions_were_kept(tmp_path: Path) -> None:
    data = tmp_path / "data"
    demo_study(data, participants=3)
    write_report([data], tmp_path / "blind.html", blind=True)
    assert (tmp_path / LOCK_NAME).is_file()
    write_report([data], tmp_path / "report.html")
    assert "exclusions are those that were locked" in (tmp_path / "report.html").read_text()


def test_the_open_report_says_where_exclusions_changed(tmp_path: Path) -> None:
    data = tmp_path / "data"
    demo_study(data, participants=3, missed={5: 2})
    write_report([data], tmp_path / "blind.html", blind=True)
    for path in data.iterdir():
        path.unlink()
    demo_study(data, participants=3, missed={5: 2}, analysis_plan={"exclusions": [{"rule": "missed_refreshes"}]})
    write_report([data], tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "Rules differ from those locked" in page
    assert "Trials left out differ from those locked" in page


def test_a_lock_is_never_replaced(tmp_path: Path) -> None:
    data = tmp_path / "data"
    demo_study(data, participants=2)
    write_report([data], tmp_path / "blind.html", blind=True)
    write_report([data], tmp_path / "blind.html", blind=True)
    before = (tmp_path / "blind.html").read_bytes()
    demo_study(tmp_path / "other", participants=3, seed=9)
    with pytest.raises(InputError, match="locked exclusions"):
        write_report([tmp_path / "other"], tmp_path / "blind.html", blind=True)
    assert (tmp_path / "blind.html").read_bytes() == before
