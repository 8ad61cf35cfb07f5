"""Three seconds of 2,000 Hz gaze, 1,000 Hz box and 240 flips a second: nothing is lost (times: tests/prove/streams)."""

from __future__ import annotations

from pathlib import Path

from tests.prove.streams import stream


def test_no_sample_edge_or_flip_is_lost(tmp_path: Path) -> None:
    found = stream(3.0, tmp_path)
    assert found.flips_received == found.flips_sent > 0
    assert found.edges_received == found.edges_sent == 3000
    assert found.ring_lost == 0
    if found.vanished == 0:  # on an overloaded machine the stream may be taken for lost, which is logged
        assert found.gaze_gaps == 0
        assert found.gaze_received == found.gaze_expected > 5000
