"""Rows of a table as named tuples, typed loosely: the columns are known to the caller, not to the type checker."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pandas as pd


def rows_of_table(table: pd.DataFrame) -> Iterator[Any]:
    """One named tuple a row, without the index."""
    yield from table.itertuples(index=False)
