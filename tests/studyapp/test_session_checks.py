"""Before a session: a disk that takes it, measurements that are recent, a display that takes its pictures."""

from __future__ import annotations

import json
import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from protocols.design import plan
from protocols.load import load_study
from stimuli.errors import InputError
from studyapp import session_room
from studyapp.display.certificate import certify
from studyapp.display.virtual_display import VirtualDisplay
from studyapp.lab_file import find_lab
from studyapp.present.admission import UploadBudget
from studyapp.session_checks import require_space, require_writable
from studyapp.session_room import room_warnings, upload_budget
from tests.studyapp.tiny_study import TINY


def test_a_folder_that_is_there_and_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"/proc: data folder: got .*wanted a folder that can be written"):
        require_writable(Path("/proc"))
    require_writable(tmp_path / "new" / "folder")
    assert list((tmp_path / "new" / "folder").iterdir()) == []


def test_a_disk_too_small_for_the_session_is_refused_beforehand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tiny.yaml").write_text(TINY)
    study = load_study(tmp_path / "tiny.yaml")
    trials = plan(study, 1)
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage(10**9, 0, 10**9))
    require_space(tmp_path, study, trials)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage(10**9, 0, 10**7))
    with pytest.raises(InputError, match=r"free space: got 10 MB, wanted \d\d MB for this session"):
        require_space(tmp_path, study, trials)
    # Twice as many trials ask for more.
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage(10**9, 0, 17_000_000))
    with pytest.raises(InputError):
        require_space(tmp_path, study, trials * 40)


def test_the_shorter_age_limit_counts_and_displays_warn_too(tmp_path: Path) -> None:
    (tmp_path / "tiny.yaml").write_text(TINY + "timing: {photometry_max_age_days: 30}\n")
    study = load_study(tmp_path / "tiny.yaml")
    certificate = certify(VirtualDisplay(), 480)
    record = {"date": "2020-01-01", "codes": [0, 255], "luminance_cd_m2": [0.0, 100.0]}
    (tmp_path / "light.json").write_text(json.dumps(record))
    (tmp_path / "lab.yaml").write_text("photometry: {file: light.json, max_age_days: 100000}\n")
    (line,) = room_warnings(study, find_lab(None, tmp_path), certificate)
    assert line.endswith("days ago, the limit is 30")
    (tmp_path / "lab.yaml").write_text("photometry: {file: light.json, max_age_days: 7}\n")
    (line,) = room_warnings(study, find_lab(None, tmp_path), certificate)
    assert line.endswith("the limit is 7")
    (line,) = room_warnings(study, find_lab(None, tmp_path / "elsewhere"), certificate)
    assert "never measured" in line


def test_pictures_beyond_the_upload_budget_are_refused_unless_allowed_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    tight = UploadBudget(10e6, 6e6, (256, 128), 2, 20)
    monkeypatch.setattr(session_room, "measure_upload", lambda display, trials: tight)
    with pytest.raises(InputError, match=r"upload: got 6 MB/s, wanted at most 5 MB/s .*--override upload=REASON"):
        upload_budget(VirtualDisplay(), [], {})
    assert upload_budget(VirtualDisplay(), [], {"upload": "a pilot"})[1] == [{"check": "upload", "reason": "a pilot"}]
