"""Morph targets: resting and animated weights, under nodes that move, with joints, and files that say it wrongly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stimuli import load_scene
from stimuli.errors import InputError
from stimuli.preview import frame_times
from stimuli.scene import scene_at
from tests.stimuli.tiny_glb import TRIANGLE, TinyGlb

UP = [[0.0, 0.0, 2.0]] * 3
ASIDE = [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]


def morphing(glb: TinyGlb, targets: tuple[Any, ...] = (UP, ASIDE), **attributes: int) -> int:
    """A mesh of one triangle with these displacements."""
    mesh = glb.mesh(TRIANGLE, **attributes)
    glb.json["meshes"][mesh]["primitives"][0]["targets"] = [{"POSITION": glb.accessor(step)} for step in targets]
    return mesh


def points_at(scene, time_s: float, part: int = 0) -> np.ndarray:
    return scene_at(scene, time_s).static[part].positions


def test_weights_move_the_vertices_between_their_keys(tmp_path: Path) -> None:
    glb = TinyGlb()
    node = glb.node(mesh=morphing(glb))
    glb.animate(node, "weights", [0.0, 1.0, 3.0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.5])
    scene = load_scene(glb.write(tmp_path))
    assert scene.duration_s == 3.0
    for time_s, (one, two) in ((-1, (0, 0)), (0.25, (0.25, 0)), (1, (1, 0)), (2, (0.5, 0.25)), (9, (0, 0.5))):
        wanted = np.array(TRIANGLE) + one * np.array(UP) + two * np.array(ASIDE)
        np.testing.assert_allclose(points_at(scene, time_s), wanted, atol=1e-7)
    assert frame_times(scene, scene.camera, 3).tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(("kind", "at_half"), [("STEP", 0.0), ("CUBICSPLINE", 0.5)])
def test_every_interpolation_is_played(kind: str, at_half: float, tmp_path: Path) -> None:
    glb = TinyGlb()
    node = glb.node(mesh=morphing(glb, (UP,)))
    values = [0.0, 1.0] if kind == "STEP" else [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    glb.animate(node, "weights", [0.0, 1.0], values, kind)
    scene = load_scene(glb.write(tmp_path))
    assert points_at(scene, 0.5)[0, 2] == pytest.approx(2 * at_half)
    assert points_at(scene, 1.0)[0, 2] == pytest.approx(2.0)


def test_an_animated_weight_replaces_the_resting_one_and_follows_its_moving_node(tmp_path: Path) -> None:
    glb = TinyGlb()
    node = glb.node(mesh=morphing(glb), weights=[5.0, 5.0])
    glb.animate(node, "weights", [0.0, 1.0], [0.0, 0.0, 1.0, 0.0])
    glb.animate(node, "translation", [0.0, 1.0], [[0, 0, 0], [10, 0, 0]])
    scene = load_scene(glb.write(tmp_path))
    np.testing.assert_allclose(points_at(scene, 1.0), np.add(TRIANGLE, [10, 0, 2]))
    # Nothing of it stands among the rigid movers as well.
    assert sum(len(mover.parts) for mover in scene.movers) == 0
    assert len(scene.static) == 1


def test_normals_follow_the_shape_and_a_squeezed_mirrored_node(tmp_path: Path) -> None:
    glb = TinyGlb()
    normals = glb.accessor([[0, 0, 1.0]] * 3)
    mesh = morphing(glb, ([[0, 0, 0], [0, 0, 1.0], [0, 0, 0]],), NORMAL=normals)
    # The triangle tilts about y: its normal turns from +z towards -x.
    tilted = glb.accessor([[-1.0, 0, 0]] * 3)
    glb.json["meshes"][mesh]["primitives"][0]["targets"][0]["NORMAL"] = tilted
    node = glb.node(mesh=mesh, scale=[-1, 2, 4])
    glb.animate(node, "weights", [0.0, 1.0], [0.0, 1.0])
    part = scene_at(load_scene(glb.write(tmp_path)), 1.0).static[0]
    corner = part.positions[part.primitive.indices[0]]
    face = np.cross(corner[1] - corner[0], corner[2] - corner[0])
    # Wound so that the front is counter-clockwise, mirroring included; the normals agree with the face.
    np.testing.assert_allclose(part.primitive.normals, np.tile(face / np.linalg.norm(face), (3, 1)), atol=1e-6)


def test_joints_move_what_the_weights_have_shaped(tmp_path: Path) -> None:
    glb = TinyGlb()
    joints, weights = glb.accessor([[0, 0, 0, 0]] * 3, "u1"), glb.accessor([[1.0, 0, 0, 0]] * 3)
    mesh = morphing(glb, (UP,), JOINTS_0=joints, WEIGHTS_0=weights)
    joint = glb.node()
    node = glb.node(mesh=mesh, skin=0)
    glb.json["skins"] = [{"joints": [joint]}]
    glb.animate(joint, "translation", [0.0, 1.0], [[0, 0, 0], [0, 7, 0]])
    glb.animate(node, "weights", [0.0, 1.0], [0.0, 1.0])
    scene = load_scene(glb.write(tmp_path))
    np.testing.assert_allclose(points_at(scene, 1.0), np.add(TRIANGLE, [0, 7, 2]))
    np.testing.assert_allclose(points_at(scene, 0.0), TRIANGLE)


@pytest.mark.parametrize(
    ("values", "words"),
    [([0.0, 0.0, 1.0], "weights keys"), ([0.0] * 6, "weights keys"), ([0, 0, np.nan, 0], "finite")],
)
def test_weights_that_do_not_fit_are_named(values: list[float], words: str, tmp_path: Path) -> None:
    glb = TinyGlb()
    node = glb.node(mesh=morphing(glb))
    glb.animate(node, "weights", [0.0, 1.0], values)
    with pytest.raises(InputError, match=words):
        load_scene(glb.write(tmp_path))


def test_weights_of_what_has_no_targets_are_said_not_to_be_played(tmp_path: Path) -> None:
    glb = TinyGlb()
    node = glb.node(mesh=glb.mesh(TRIANGLE))
    glb.animate(node, "weights", [0.0, 1.0], [0.0, 1.0])
    scene = load_scene(glb.write(tmp_path))
    assert any("no morph targets" in note for note in scene.notes)
    assert scene.duration_s == 0.0


@pytest.mark.parametrize("bad", [[[0.0, 0.0, np.nan]] * 3, [[0.0, 0.0, 1.0]] * 2])
def test_bad_displacements_are_refused(bad: list[list[float]], tmp_path: Path) -> None:
    glb = TinyGlb()
    glb.node(mesh=morphing(glb, (bad,)))
    with pytest.raises(InputError, match="target 0 POSITION"):
        load_scene(glb.write(tmp_path))
