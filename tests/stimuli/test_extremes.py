"""Every row of the table of extremes of scenes, paths and clips."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.stimuli.extremes import TABLE, Extreme


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
def test_extreme(row: Extreme, tmp_path: Path) -> None:
    row.holds(tmp_path)


def test_each_row_has_a_name_of_its_own() -> None:
    assert len({row.name for row in TABLE}) == len(TABLE)
