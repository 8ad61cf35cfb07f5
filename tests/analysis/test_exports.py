"""CSV and BIDS exports: complete, described, accepted by the validator, and by our own check."""

from __future__ import annotations

import gzip
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from analysis import load_sessions
from analysis.bids import bids_labels, export_bids
from analysis.bids_check import check_bids
from analysis.csv_export import FILES, export_csv
from stimuli.errors import InputError
from tests.analysis.fabricate import demo_study

SCREEN = (
    "study: fabricated\ntitle: A fabricated study\ndisplay: {size_px: [1920, 1080], width_m: 0.53, distance_m: 0.6}\n"
)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    demo_study(folder, participants=2, gaze_hz=120, header={"protocol_text": SCREEN})
    return folder


@pytest.fixture(scope="module")
def bids(study: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_bids([study], tmp_path_factory.mktemp("export") / "bids")


def validate(folder: Path) -> subprocess.CompletedProcess[str]:
    program = shutil.which("bids-validator-deno", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("bids-validator-deno is not installed")
    return subprocess.run([program, str(folder), "--ignoreWarnings"], capture_output=True, text=True, check=False)


def test_the_validator_accepts_the_data_set(bids: Path) -> None:
    done = validate(bids)
    assert done.returncode == 0, done.stdout


def test_without_screen_geometry_gaze_is_custom_and_still_accepted(tmp_path: Path) -> None:
    demo_study(tmp_path / "data", participants=1, gaze_hz=60)
    folder = export_bids([tmp_path / "data"], tmp_path / "bids")
    sidecar = json.loads(next(folder.rglob("*_physio.json")).read_text())
    assert sidecar["SampleCoordinateSystem"] == "custom"
    assert sidecar["x_coordinate"]["Units"] == "deg"
    done = validate(folder)
    assert done.returncode == 0, done.stdout


def test_the_gaze_table_has_no_header_and_is_in_pixels(bids: Path) -> None:
    path = next(bids.rglob("*_physio.tsv.gz"))
    sidecar = json.loads(Path(str(path).removesuffix(".tsv.gz") + ".json").read_text())
    assert sidecar["SampleCoordinateSystem"] == "gaze-on-screen"
    with gzip.open(path, "rt") as file:
        rows = [line.rstrip("\n").split("\t") for line in file]
    table = pd.DataFrame(rows, columns=sidecar["Columns"]).replace("n/a", np.nan).astype(float)
    assert table["x_coordinate"].mean() == pytest.approx(960, abs=3)
    assert table["y_coordinate"].mean() == pytest.approx(540, abs=3)
    # 0.4 degrees at 0.6 m on 1920 px of 0.53 m
    assert table["x_coordinate"].std() == pytest.approx(np.tan(np.radians(0.4)) * 0.6 * 1920 / 0.53, rel=0.1)
    assert sidecar["SamplingFrequency"] == pytest.approx(120, rel=1e-3)
    assert table["x_coordinate"].isna().mean() == pytest.approx(0.03, abs=0.02)


def test_events_hold_every_trial_with_its_answer(bids: Path) -> None:
    events = pd.read_csv(next(bids.rglob("*_events.tsv")), sep="\t")
    assert len(events) == 15
    assert events.columns[:3].tolist() == ["onset", "duration", "trial_type"]
    assert events["onset"].is_monotonic_increasing
    assert events["response"].notna().all()


@pytest.mark.parametrize("field", ["ScreenSize", "ScreenDistance", "ScreenResolution", "ScreenOrigin"])
def test_our_check_notices_a_missing_screen_field(bids: Path, tmp_path: Path, field: str) -> None:
    copy = tmp_path / "bids"
    shutil.copytree(bids, copy)
    path = next(copy.rglob("*_events.json"))
    sidecar = json.loads(path.read_text())
    del sidecar["StimulusPresentation"][field]
    path.write_text(json.dumps(sidecar))
    assert any(field in line for line in check_bids(copy))


def test_our_check_notices_a_header_line_and_a_foreign_onset_source(bids: Path, tmp_path: Path) -> None:
    copy = tmp_path / "bids"
    shutil.copytree(bids, copy)
    path = next(copy.rglob("*_physio.tsv.gz"))
    with gzip.open(path, "wt") as file:
        file.write("timestamp\tx_coordinate\ty_coordinate\tpupil_size\n")
    events = next(copy.rglob("*_physioevents.json"))
    events.write_text(json.dumps({**json.loads(events.read_text()), "OnsetSource": "clock"}))
    found = "\n".join(check_bids(copy))
    assert "there is no header line" in found
    assert "OnsetSource" in found


def test_labels_that_collide_are_refused() -> None:
    assert bids_labels(["1", "12", "A-3"]) == {"1": "01", "12": "12", "A-3": "A3"}
    with pytest.raises(InputError, match="BIDS label"):
        bids_labels(["A-3", "A3"])


def test_foreign_files_are_not_written_over(study: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    for export in (export_bids, export_csv):
        with pytest.raises(InputError, match=r"other files.*thesis\.tex"):
            export([study], tmp_path)


def test_csv_holds_what_load_sessions_gives(study: Path, tmp_path: Path) -> None:
    folder = export_csv([study], tmp_path / "csv")
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    trials = pd.read_csv(folder / "trials.csv")
    table = load_sessions(study)
    assert trials.shape == table.shape
    assert np.allclose(trials["rt_s"], table["rt_s"].astype(float), equal_nan=True)
    flips = pd.read_csv(folder / "flips.csv")
    assert len(flips) == table["refreshes"].sum()
    gaze = pd.read_csv(folder / "gaze.csv")
    assert (gaze.groupby("participant").size() > 300).all()
    export_csv([study], folder)


def test_every_exported_column_is_in_the_codebook(study: Path, tmp_path: Path) -> None:
    folder = export_csv([study], tmp_path / "csv")
    described = json.loads((folder / "codebook.json").read_text())["files"]
    for name in FILES[:4]:
        columns = pd.read_csv(folder / name, nrows=1).columns
        assert list(described[name]) == list(columns)
        assert all(entry["description"] for entry in described[name].values())
    assert described["trials.csv"]["rating_smooth"]["levels"]["3"] == "strongly agree"


def test_the_r_script_runs_where_r_is(study: Path, tmp_path: Path) -> None:
    program = shutil.which("Rscript")
    if program is None:
        pytest.skip("R is not installed")
    folder = export_csv([study], tmp_path / "csv")
    done = subprocess.run([program, "analysis.R"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
