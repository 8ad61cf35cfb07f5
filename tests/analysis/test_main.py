"""The command line: files written, wrong input in one line with exit code 2, `studyapp` hands over."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from analysis.__main__ import main
from studyapp.cli import main as studyapp
from tests.analysis.fabricate import demo_study


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    demo_study(folder, participants=3)
    return folder


def test_report_json_and_tables_are_written(study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, numbers, tables = tmp_path / "r.html", tmp_path / "r.json", tmp_path / "tables"
    arguments = [str(study), "--report", str(page), "--json", str(numbers), "--tables", str(tables), "--quiet"]
    assert main(arguments) == 0
    assert capsys.readouterr().out.splitlines()[:2] == [str(page), str(numbers)]
    results = json.loads(numbers.read_text())
    assert results["simulated"] is True
    listed = [b["id"] for part in results["sections"] for b in part["blocks"] if b["type"] == "table"]
    assert sorted(path.stem for path in tables.glob("*.tex")) == sorted(listed)
    assert "SIMULATED" in (tables / "pairs.tex").read_text()
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("wrong", ["nowhere", "empty", "broken"])
def test_wrong_input_is_one_line_and_exit_code_2(
    tmp_path: Path, wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").write_text("no session")
    assert main([str(tmp_path / wrong), "--report", str(tmp_path / "r.html"), "--quiet"]) == 2
    said = capsys.readouterr().err.strip()
    assert said.count("\n") == 0
    assert "got" in said
    assert "wanted" in said
    assert not (tmp_path / "r.html").exists()


def test_a_report_in_a_missing_folder_is_refused_before_work(study: Path, tmp_path: Path) -> None:
    assert main([str(study), "--report", str(tmp_path / "no" / "r.html"), "--quiet"]) == 2


def test_studyapp_hands_over_to_another_process(study: Path, tmp_path: Path) -> None:
    page = tmp_path / "r.html"
    assert studyapp(["analyze", str(study), "--report", str(page), "--quiet"]) == 0
    assert "SIMULATED" in page.read_text()
    assert studyapp(["export", str(study), "--csv", str(tmp_path / "csv")]) == 0
    assert (tmp_path / "csv" / "trials.csv").is_file()
    assert studyapp(["export", str(study)]) == 2


def test_analysis_loads_no_gpu_code(study: Path, tmp_path: Path) -> None:
    program = (
        "import sys; from analysis.__main__ import main; "
        f"main([{str(study)!r}, '--report', {str(tmp_path / 'r.html')!r}, '--quiet']); "
        "print(sorted({'drjit', 'mitsuba', 'moderngl', 'glfw', 'studyapp', 'pyrender'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
