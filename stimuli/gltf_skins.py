"""Meshes whose vertices move: linear blend skinning by the joints of a skin (glTF 2.0, 3.7.3), and morphing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stimuli.gltf_animation import Rig
from stimuli.gltf_meshes import ReadPrimitive, mend_normals
from stimuli.gltf_morphs import MorphTargets, WeightTrack


@dataclass(frozen=True)
class SkinTrack:
    """Vertices of a skinned primitive over time; the mesh node's own matrix does not count.

    ``rows`` (J,): the rig's row of each joint's nearest animated node, -1 where it never moves; ``below`` (J, 4, 4):
    from there to the joint; ``bind`` (J, 4, 4): inverse bind matrices. ``morph`` shapes it before the joints do.
    """

    primitive: ReadPrimitive
    rig: Rig
    rows: np.ndarray
    below: np.ndarray
    bind: np.ndarray
    morph: WeightTrack | None = None

    def vertices(self, time_s: float) -> tuple[np.ndarray, np.ndarray | None]:
        """World positions (N, 3) and unit normals (N, 3) (None where the file has none) at ``time_s``."""
        joints = self.below.copy()
        moving = self.rows >= 0
        if moving.any():
            world = self.rig.poses(np.array([time_s]))[:, 0]
            joints[moving] = world[self.rows[moving]] @ self.below[moving]
        primitive = self.primitive
        if self.morph is not None and primitive.targets is not None:
            positions, normals = primitive.targets.at(self.morph.weights(time_s))
            primitive = replace(primitive, positions=positions, normals=normals)
        return skinned_vertices(primitive, joints @ self.bind)


def skinned_vertices(primitive: ReadPrimitive, joint_matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """World positions (N, 3) and unit normals of a skinned primitive; ``joint_matrices`` (J, 4, 4) = joint world x
    inverse bind matrix (glTF 2.0, 3.7.3)."""
    assert primitive.joints is not None
    assert primitive.weights is not None
    blend = np.einsum("nj,njab->nab", primitive.weights, joint_matrices[primitive.joints])
    positions = np.einsum("nab,nb->na", blend[:, :3, :3], primitive.positions) + blend[:, :3, 3]
    if primitive.normals is None:
        return positions, None
    normals = np.einsum("nab,nb->na", cofactors(blend), primitive.normals)
    return positions, mend_normals(positions, normals, primitive.indices.astype(np.int64))[0]


def cofactors(matrices: np.ndarray) -> np.ndarray:
    """(..., 3, 3) of (..., 4, 4): turns normals as the inverse transpose does (mirrors included), and always exists."""
    a, b, c = matrices[..., :3, 0], matrices[..., :3, 1], matrices[..., :3, 2]
    across = np.cross(b, c)
    side = np.where(np.sum(a * across, axis=-1) < 0.0, -1.0, 1.0)
    return np.stack([across, np.cross(c, a), np.cross(a, b)], axis=-1) * side[..., None, None]


@dataclass(frozen=True)
class MorphTrack:
    """Vertices of a morphing primitive without joints: a `stimuli.scene.VertexTrack`.

    ``row``: the rig's row of the nearest animated node, -1 where none is; ``below``: (4, 4) from there to the mesh.
    """

    targets: MorphTargets
    track: WeightTrack
    faces: np.ndarray
    rig: Rig
    row: int
    below: np.ndarray

    def vertices(self, time_s: float) -> tuple[np.ndarray, np.ndarray | None]:
        """World positions (N, 3) and unit normals (N, 3) (None where the file has none) at ``time_s``."""
        matrix = self.below if self.row < 0 else self.rig.poses(np.array([time_s]))[self.row, 0] @ self.below
        positions, normals = self.targets.at(self.track.weights(time_s))
        positions = positions @ matrix[:3, :3].T + matrix[:3, 3]
        if normals is None:
            return positions, None
        return positions, mend_normals(positions, normals @ cofactors(matrix).T, self.faces)[0]
