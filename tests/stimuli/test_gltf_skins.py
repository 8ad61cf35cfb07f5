"""Meshes of glTF files that change their shape: skins and morph targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stimuli import load_scene
from stimuli.scene import Scene, scene_at
from tests.stimuli.tiny_glb import TRIANGLE, TinyGlb


def test_morph_targets_are_applied_at_their_resting_weights(tmp_path: Path) -> None:
    glb = TinyGlb()
    mesh = glb.mesh(TRIANGLE)
    glb.json["meshes"][mesh]["primitives"][0]["targets"] = [{"POSITION": glb.accessor([[0, 0, 2.0]] * 3)}]
    glb.json["meshes"][mesh]["weights"] = [0.5]
    glb.node(mesh=mesh)
    glb.node(mesh=mesh, weights=[2.0])
    first, second = load_scene(glb.write(tmp_path)).static
    assert (first.positions[:, 2] == 1.0).all()
    assert (second.positions[:, 2] == 4.0).all()


def skinned(tmp_path: Path) -> Scene:
    """A triangle bound half and half to two joints; the node's own matrix must not count."""
    glb = TinyGlb()
    joints = glb.accessor([[0, 1, 0, 0]] * 3, "u1")
    weights = glb.accessor([[1, 0, 0, 0], [0, 1, 0, 0], [0.5, 0.5, 0, 0]])
    mesh = glb.mesh(TRIANGLE, JOINTS_0=joints, WEIGHTS_0=weights, NORMAL=glb.accessor([[0, 0, 1.0]] * 3))
    one = glb.node(translation=[0, 0, 1])
    two = glb.node(translation=[0, 3, 0])
    glb.node(mesh=mesh, skin=0, translation=[100, 100, 100])
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, :3, 3] = (0, -1, 0)
    stored = glb.accessor(bind.transpose(0, 2, 1).reshape(2, 16))
    glb.json["skins"] = [{"joints": [one, two], "inverseBindMatrices": stored}]
    glb.animate(two, "translation", [0.0, 1.0], [[0, 3, 0], [0, 9, 0]])
    return load_scene(glb.write(tmp_path))


def test_skinned_meshes_are_posed_by_their_joints_and_said_to_be(tmp_path: Path) -> None:
    scene = skinned(tmp_path)
    assert any("skinned" in note for note in scene.notes)
    posed = scene.static[0].positions if scene.static else scene.movers[0].parts[0].positions
    assert np.allclose(posed, [[0, 0, 1], [1, 2, 0], [0, 2, 0.5]])


def test_skinned_vertices_follow_their_joints_over_time(tmp_path: Path) -> None:
    scene = skinned(tmp_path)
    assert scene_at(scene, 0.0).static[0].positions.tolist() == scene.static[0].positions.tolist()
    bent = scene_at(scene, 0.5).static[0]
    # The second joint has risen by 3 m: vertex 1 follows whole, vertex 2 by half.
    assert np.allclose(bent.positions, [[0, 0, 1], [1, 5, 0], [0, 3.5, 0.5]])
    assert np.allclose(bent.primitive.normals, [[0, 0, 1]] * 3)
    assert np.allclose(scene.static[0].positions, [[0, 0, 1], [1, 2, 0], [0, 2, 0.5]])


def test_a_skin_whose_joints_all_turn_alike_turns_its_normals_too(tmp_path: Path) -> None:
    glb = TinyGlb()
    mesh = glb.mesh(
        TRIANGLE,
        JOINTS_0=glb.accessor([[0, 0, 0, 0]] * 3, "u1"),
        WEIGHTS_0=glb.accessor([[0.25, 0.25, 0.25, 0.25]] * 3),
        NORMAL=glb.accessor([[0, 0.6, 0.8]] * 3),
    )
    joint = glb.node(scale=[1, 1, 4])
    glb.node(mesh=mesh, skin=0)
    glb.json["skins"] = [{"joints": [joint]}]
    half = np.sin(np.pi / 4)
    glb.animate(joint, "rotation", [0.0, 1.0], [[0, 0, 0, 1], [half, 0, 0, half]])
    part = scene_at(load_scene(glb.write(tmp_path)), 1.0).static[0]
    # Scaling z by 4 makes the normal (0, 0.6, 0.2); a quarter turn about x takes y to z and z to -y.
    wanted = np.array([0, -0.2, 0.6]) / np.linalg.norm([0.2, 0.6])
    assert np.allclose(part.primitive.normals, [wanted] * 3, atol=1e-6)
    assert np.allclose(part.positions[2], (0, 0, 1))
