"""Planted faults lower a technique's win share: `tests.prove.picture_driven_observer`, smaller."""

from __future__ import annotations

from pathlib import Path

from studyapp.cli import main
from studyapp.session_file import verify
from tests.prove.picture_driven_observer import prove


def test_observers_who_judge_by_pictures_see_planted_faults_and_no_others(tmp_path: Path) -> None:
    found = prove(tmp_path, ("rmse",), participants=8, size="[32, 24]")["rmse"]
    assert found["shuffled pixels"]["points"] >= 10
    assert found["shuffled pixels"]["p"] < 0.05
    assert found["5 % missed refreshes"]["points"] > 0
    assert abs(found["null"]["points"]) < 10
    # The same observers in whole sessions on the virtual display.
    command = ["simulate", str(tmp_path / "pictures.yaml"), "--participants", "1", "--observer", "pictures"]
    assert main([*command, "--data", str(tmp_path / "data"), "--jobs", "1"]) == 0
    assert verify(tmp_path / "data" / "pictures_p1_1.sqlite") == []
    assert main(["simulate", "demo", "--participants", "1", "--observer", "pictures", "--data", str(tmp_path)]) == 2
