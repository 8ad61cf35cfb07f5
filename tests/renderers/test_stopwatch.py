"""Seconds of a frame, by a clock that the test sets."""

from __future__ import annotations

from itertools import count

from renderers.stopwatch import Stopwatch


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
