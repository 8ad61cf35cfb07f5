"""``studyapp tradeoff --table``: weier2016 and herr2021 from the command line (dayal2005: tests/renderers)."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from studyapp.cli import main


def test_the_foveated_table_is_written_beside_the_papers_and_nothing_is_measured_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["tradeoff", "--table", "weier2016", "--scene", "tunnel_geom", "--size", "59x73", "--frames", "1",
                 "--out", str(tmp_path)]  # fmt: skip
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "59x73, 94 x 106 degrees, gaze at the centre, medium, 1 frames a cell" in out
    for words in ("point light", "area light", "ambient occlusion", "the paper: 79 %", "4.18", "rmse 0-10"):
        assert words in out
    found = json.loads((tmp_path / "weier2016.json").read_text())
    assert [cell["setting"] for cell in found["cells"]] == ["point", "area", "ambient_occlusion"]
    assert all(cell["rmse_by_ring"][0] < 1e-6 for cell in found["cells"])  # the fovea is full ray tracing
    assert (tmp_path / "weier2016.png").stat().st_size > 1000
    rows = (tmp_path / "weier2016.jsonl").read_text()
    assert main([*arguments, "--json"]) == 0
    assert (tmp_path / "weier2016.jsonl").read_text() == rows
    assert json.loads(capsys.readouterr().out) == found


def test_a_foveated_table_that_was_killed_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["tradeoff", "--table", "weier2016", "--scene", "tunnel_geom", "--size", "20x24", "--frames", "1",
                 "--out", str(tmp_path)]  # fmt: skip
    assert main(arguments) == 0
    file = tmp_path / "weier2016.jsonl"
    rows = file.read_text().splitlines(keepends=True)
    file.write_text("".join(rows[:2]) + rows[2][:40])  # in the middle of the last line
    assert main(arguments) == 0
    again = file.read_text().splitlines(keepends=True)
    assert again[:2] == rows[:2]
    assert json.loads(again[2])["setting"] == "ambient_occlusion"


def test_the_polar_table_is_written_beside_the_papers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["tradeoff", "--table", "herr2021", "--scene", "toy_car", "--scale", "1/40", "--frames", "1",
                 "--size", "64x36", "--out", str(tmp_path)]  # fmt: skip
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "scaled by 1/40 along each side (left inset 63x63" in out
    found = json.loads((tmp_path / "herr2021.json").read_text())
    assert [row["light_samples"] for row in found["times"]] == [1, 64, 256]
    for row in found["times"]:
        pixels = sum(w * h for w, h in row["viewports"].values())
        assert row["cartesian_rays"] == pixels
        assert row["fewer_rays"] == pytest.approx(pixels / row["polar_rays"])
        assert row["faster"] == pytest.approx(row["cartesian_ms"] / row["polar_ms"])
    assert found["ratio_to_1_light_sample"]["1"] == 1
    assert found["paper_ratio_to_1_light_sample"]["1576x768"]["64"] == pytest.approx(35.4 / 10.2)
    assert found["paper_ratio_to_1_light_sample"]["1576x768"]["256"] == pytest.approx(114.8 / 10.2)
    for row in found["errors"]:
        assert row["uniform"]["rays"] == pytest.approx(row["polar"]["rays"], rel=0.15)
    assert (tmp_path / "herr2021.png").stat().st_size > 1000
    assert len((tmp_path / "herr2021.jsonl").read_text().splitlines()) == 5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--table", "weier2016", "--scale", "1/4"], "--scale: option: got with --table weier2016"),
        (["--scale", "1/4"], "--scale: option: got with no --table"),
        (["--table", "herr2021", "--configuration", "small"], "--configuration"),
        (["--table", "weier2016", "--configuration", "full"], "small | medium | large"),
        (["--table", "weier2016", "--frames", "0"], "frames, warm-up, size"),
        (["--table", "weier2016", "--size", "99999x99999"], "picture size"),
        (["--table", "weier2016", "--technique", "polar"], "--technique"),
        (["--table", "weier2016", "--scene", "nowhere"], "nowhere"),
        (["--table", "herr2021", "--scale", "0"], "scale of the headset's pixels"),
        (["--table", "herr2021", "--scale", "3/2"], "scale of the headset's pixels"),
        (["--table", "herr2021", "--scale", "x"], "--scale"),
        (["--table", "herr2021", "--frames", "0"], "frames, size"),
        (["--table", "herr2021", "--spp", "8", "--lighting", "probes"], "--lighting, --spp"),
        (["--table", "herr2021", "--scene", "bar", "--scene", "toy_car"], "one"),
    ],
)
def test_what_a_table_does_not_take_is_one_line(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tradeoff", *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert words in error[0]
    assert not (tmp_path / "out").exists()
