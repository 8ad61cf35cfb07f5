from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest

from protocols.latin import balanced_rows


@pytest.mark.parametrize("n", range(1, 13))
def test_places_and_neighbours_are_balanced(n: int) -> None:
    rows = balanced_rows(n)
    assert all(sorted(row) == list(range(n)) for row in rows)
    assert len(rows) == (n if n % 2 == 0 or n == 1 else 2 * n)
    places = Counter((place, item) for row in rows for place, item in enumerate(row))
    assert set(places.values()) == {len(rows) // n}
    follows = Counter(pair for row in rows for pair in pairwise(row))
    if n > 1:
        assert len(follows) == n * (n - 1)
        assert len(set(follows.values())) == 1


def test_nothing_has_no_rows() -> None:
    assert balanced_rows(0) == ()
