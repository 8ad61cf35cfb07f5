"""Skinned meshes: linear blend skinning of a primitive by the animated joints of its skin (glTF 2.0, 3.7.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stimuli.gltf_animation import Rig
from stimuli.gltf_meshes import ReadPrimitive, mend_normals


@dataclass(frozen=True)
class SkinTrack:
    """Vertices of a skinned primitive over time; the mesh node's own matrix does not count.

    ``rows`` (J,): the rig's row of each joint's nearest animated node, -1 where it never moves; ``below`` (J, 4, 4):
    from there to the joint; ``bind`` (J, 4, 4): inverse bind matrices.
    """

    primitive: ReadPrimitive
    rig: Rig
    rows: np.ndarray
    below: np.ndarray
    bind: np.ndarray

    def vertices(self, time_s: float) -> tuple[np.ndarray, np.ndarray | None]:
        """World positions (N, 3) and unit normals (N, 3) (None where the file has none) at ``time_s``."""
        joints = self.below.copy()
        moving = self.rows >= 0
        if moving.any():
            world = self.rig.poses(np.array([time_s]))[:, 0]
            joints[moving] = world[self.rows[moving]] @ self.below[moving]
        return skinned_vertices(self.primitive, joints @ self.bind)


def skinned_vertices(primitive: ReadPrimitive, joint_matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """World positions (N, 3) and unit normals of a skinned primitive; ``joint_matrices`` (J, 4, 4) = joint world x
    inverse bind matrix (glTF 2.0, 3.7.3)."""
    assert primitive.joints is not None
    assert primitive.weights is not None
    blend = np.einsum("nj,njab->nab", primitive.weights, joint_matrices[primitive.joints])
    positions = np.einsum("nab,nb->na", blend[:, :3, :3], primitive.positions) + blend[:, :3, 3]
    if primitive.normals is None:
        return positions, None
    # The cofactor matrix turns normals as the inverse transpose does, and exists where the inverse does not.
    a, b, c = blend[:, :3, 0], blend[:, :3, 1], blend[:, :3, 2]
    cofactor = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    normals = np.einsum("nab,nb->na", cofactor, primitive.normals)
    return positions, mend_normals(positions, normals, primitive.indices.astype(np.int64))[0]
