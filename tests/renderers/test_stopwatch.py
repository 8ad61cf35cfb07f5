"""Seconds of a frame, by a clock that the test sets."""

from __future__ import annotations

from itertools import count

from renderers.stopwatch import Stopwatch, by_stages


def test_stages_are_timed_only_when_asked_and_synchronised_then() -> None:
    for measure, expected, calls in (
        ("total", {"total": 1.0}, 1),
        ("stages", {"trace": 2.0, "write": 1.0, "total": 7.0}, 4),
    ):
        ticks, synced = count(), []
        watch = Stopwatch(measure, lambda synced=synced: synced.append(1), lambda ticks=ticks: float(next(ticks)))
        for _ in range(2):
            synced.clear()
            with watch.frame():
                for stage in ("trace", "write", "trace"):
                    with watch.stage(stage):
                        pass
        assert watch.seconds == expected
        assert len(synced) == calls


def test_stages_can_be_asked_of_a_technique_that_was_built_without_them() -> None:
    watch = Stopwatch("total", lambda: None, iter([0.0, 1.0, 2.0, 4.0, 8.0, 16.0]).__next__)
    with by_stages(), watch.frame(), watch.stage("trace"):
        pass
    assert watch.seconds == {"trace": 1.0, "total": 4.0}
    with watch.frame(), watch.stage("trace"):
        pass
    assert watch.seconds == {"total": 8.0}
