"""Every row of the table of extremes of protocols."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocols.load import load_study
from stimuli.errors import InputError
from tests.protocols.extremes import TABLE, Extreme


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
def test_extreme(row: Extreme, tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(row.text)
    if row.holds is not None:
        row.holds(load_study(file))
        return
    with pytest.raises(InputError) as caught:
        load_study(file)
    found = [line for line in caught.value.problems if row.refused in line]
    assert found, caught.value.problems
    assert f"s.yaml:{row.line}:" in found[0]


def test_each_row_has_a_name_of_its_own() -> None:
    assert len({row.name for row in TABLE}) == len(TABLE)
