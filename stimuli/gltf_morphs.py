"""Morph targets: a mesh whose vertices are its base plus weighted displacements, at rest or animated (glTF 2.0, 3.7.2.2
and 3.11: an animated node's ``weights`` replace those of the node and of its mesh)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stimuli.gltf_animation import Interpolation, sample_keys


@dataclass(frozen=True)
class MorphTargets:
    """A primitive's base arrays (N, 3) and the displacements (T, N, 3) of its targets; normals None where it has
    none."""

    positions: np.ndarray
    normals: np.ndarray | None
    position_steps: np.ndarray
    normal_steps: np.ndarray

    def at(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Positions and normals (not of unit length) under ``weights`` (T,)."""
        moved = self.positions + np.tensordot(weights, self.position_steps, axes=1)
        if self.normals is None:
            return moved, None
        return moved, self.normals + np.tensordot(weights, self.normal_steps, axes=1)


@dataclass(frozen=True)
class WeightTrack:
    """The weights of a node's targets over time. ``values`` (K, T), or (K, 3, T) for CUBICSPLINE."""

    times_s: np.ndarray
    values: np.ndarray
    interpolation: Interpolation

    def narrowed(self, count: int) -> WeightTrack:
        """The weights of the first ``count`` targets (a primitive may have fewer than its mesh's others)."""
        return WeightTrack(self.times_s, self.values[..., :count], self.interpolation)

    def weights(self, time_s: float) -> np.ndarray:
        """(T,) weights; outside the keys the end value holds."""
        return sample_keys(self.times_s, self.values[None], self.interpolation, np.array([time_s]), False)[0, 0]
