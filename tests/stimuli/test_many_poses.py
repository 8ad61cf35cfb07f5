"""The poses of many tracks at once against each track's own."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from stimuli import load_scene
from stimuli.gltf_animation import NodeTrack, compose
from stimuli.many_poses import mover_poses
from stimuli.procedural.tracks import SwingTrack
from stimuli.scene import StillTrack
from tests.stimuli.test_gltf_animation import AT, chain, random_turns


@dataclass(frozen=True)
class CountedTrack:
    """A pose that counts how often it is asked for."""

    asked: list[int] = field(default_factory=list)

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        self.asked.append(1)
        return np.tile(np.eye(4), (len(time_s), 1, 1))


def test_poses_of_many_tracks_at_once_are_those_of_each() -> None:
    rig, _ = chain()
    below = compose(np.ones(3), random_turns(2, 1)[0], np.ones(3))
    arm = SwingTrack(StillTrack(below), (0.1, 0.2, 0.3), 0, 0.4, 1.3)
    hand = SwingTrack(arm, (0.0, 1.0, 0.0), 2, 0.2, 0.7, 0.3, 0.1)
    tracks = [NodeTrack(rig, 9), NodeTrack(rig, 4, below), StillTrack(below), hand, arm]
    for track, got in zip(tracks, mover_poses(tracks, AT), strict=True):
        np.testing.assert_array_equal(got, track.pose(AT))


@pytest.mark.parametrize("name", ["toy_car", "robot"])
def test_procedural_scenes_at_once_are_each_movers_own(name: str) -> None:
    tracks = [mover.track for mover in load_scene(name).movers]
    together = mover_poses(tracks, AT)
    for track, got in zip(tracks, together, strict=True):
        np.testing.assert_array_equal(got, track.pose(AT))
        np.testing.assert_allclose(
            got[:, :3, :3] @ got[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (41, 1, 1)), atol=1e-12
        )
        np.testing.assert_allclose(np.linalg.det(got), 1, atol=1e-12)


def test_what_others_are_mounted_on_is_asked_once() -> None:
    body = CountedTrack()
    limbs = [SwingTrack(body, (0.0, k, 0.0), 1, 0.1, 1.0) for k in range(5)]
    mover_poses([*limbs, SwingTrack(limbs[0], (1.0, 0.0, 0.0), 0, 0.1, 1.0), body], AT)
    assert len(body.asked) == 1
