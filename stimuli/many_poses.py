"""The poses of many tracks at once: what several of them stand on is worked out once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stimuli.gltf_animation import NodeTrack
from stimuli.scene import MountedTrack, PoseTrack


def mover_poses(tracks: Sequence[PoseTrack], time_s: np.ndarray) -> np.ndarray:
    """(M, T, 4, 4) local-to-world matrices of M tracks at (T,) times, each as its own ``pose`` has it.

    Nodes of one `Rig` are evaluated together, and what other tracks are mounted on (a car under its wheels, the limbs
    of a robot) once.
    """
    time_s = np.atleast_1d(np.asarray(time_s, np.float64))
    found: dict[int, np.ndarray] = {}  # by identity: of rigs all nodes, of others their pose

    def pose(track: PoseTrack) -> np.ndarray:
        if isinstance(track, NodeTrack):
            if id(track.rig) not in found:
                found[id(track.rig)] = track.rig.poses(time_s)
            world = found[id(track.rig)][track.rig.row[track.node]]
            return world if track.below is None else world @ track.below
        if id(track) not in found:
            if isinstance(track, MountedTrack):
                found[id(track)] = track.pose_on(pose(track.carrier), time_s)
            else:
                found[id(track)] = track.pose(time_s)
        return found[id(track)]

    result = np.empty((len(tracks), time_s.size, 4, 4))
    for i, track in enumerate(tracks):
        result[i] = pose(track)
    return result
