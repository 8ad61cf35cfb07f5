"""Every row of the table of extremes of the lab's commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from studyapp.cli import main
from tests.studyapp.extremes import TABLE, Extreme


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
def test_extreme(row: Extreme, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(row.arguments(tmp_path))
    told = capsys.readouterr()
    assert code == row.code, told.err
    assert row.said in (told.out if row.code == 0 else told.err)
    if row.code == 2:
        assert all(": got " in line for line in told.err.strip().splitlines())
    row.holds(tmp_path)


def test_each_row_has_a_name_of_its_own() -> None:
    assert len({row.name for row in TABLE}) == len(TABLE)
