"""A catch trial with ratings is right where the rating lies within its range."""

from __future__ import annotations

import pandas as pd

from analysis.exclusions import catch_results


def test_a_rating_within_the_range_is_right() -> None:
    rows = [("a", "-3..-1", "-2"), ("a", "-3..-1", "0"), ("a", "-3..-1", "-1"), ("b", "left", None), ("b", "left", "x")]
    table = pd.DataFrame(
        {
            "participant": [row[0] for row in rows],
            "correct": [row[1] for row in rows],
            "side": [None, None, None, "left", "right"],
            "response": [row[2] for row in rows],
            "catch": True,
            "practice": False,
            "status": "ok",
        }
    )
    found = catch_results(table).set_index("participant")
    assert found["right"].to_dict() == {"a": 2, "b": 1}
    assert found["catch_trials"].to_dict() == {"a": 3, "b": 2}
