"""Light files: what each entry becomes, carried lights, and what is said to wrong ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from stimuli import load_scene
from stimuli.errors import InputError
from stimuli.light_files import look_at
from stimuli.scene import Scene
from tests.stimuli.tiny_glb import TRIANGLE, TinyGlb


def scene_with(folder: Path, ending: str, tree: object) -> Scene:
    glb = TinyGlb()
    glb.node(mesh=glb.mesh(TRIANGLE))
    arm = glb.node(name="arm", translation=[0, 1, 0])
    glb.node(name="post", translation=[5, 0, 0])
    glb.animate(arm, "translation", [0.0, 1.0], [[0, 1, 0], [4, 1, 0]])
    path = glb.write(folder)
    (folder / f"tiny{ending}.json").write_text(tree if isinstance(tree, str) else json.dumps(tree))
    return load_scene(path)


def test_a_light_carried_by_a_moving_node_keeps_its_track_and_one_on_a_still_node_its_place(tmp_path: Path) -> None:
    lights = [
        {"pos": [0, 0.5, 0], "color": [1, 1, 1], "anim": "arm"},
        {"pos": [0, 0.5, 0], "color": [1, 1, 1], "anim": "post"},
    ]
    carried, standing = scene_with(tmp_path, "_scene", {"lights": lights}).lights
    assert carried.track is not None
    assert np.allclose(carried.track.pose(np.array([0.5]))[0] @ [*carried.position, 1.0], [2, 1.5, 0, 1])
    assert standing.track is None
    assert standing.position == (5.0, 0.5, 0.0)


def test_a_light_on_a_node_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="anim: got 'leg', wanted the name of a node"):
        scene_with(tmp_path, "_scene", {"lights": [{"pos": [0, 0, 0], "color": [1, 1, 1], "anim": "leg"}]})


def test_sunsky_is_a_sun_and_a_constant_sky_and_envmap_without_picture_is_one(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, "_lights", {"lights": [{"type": "sunsky", "sun_direction": [0, 2, 0]}]})
    assert scene.lights[0].kind == "directional"
    assert np.allclose(scene.lights[0].direction, (0, -1, 0))
    assert scene.background == scene.ambient != (0.0, 0.0, 0.0)
    scene = scene_with(tmp_path, "_lights", {"lights": [{"type": "envmap", "file": "sky.exr"}]})
    assert scene.background == scene.ambient == (1.0, 1.0, 1.0)
    assert any("envmap" in note for note in scene.notes)


def test_unknown_light_types_are_named_in_one_line(tmp_path: Path) -> None:
    area = {"type": "sphere", "center": [0, 0, 0], "radius": 1, "radiance": [1, 1, 1]}
    scene = scene_with(tmp_path, "_lights", {"lights": [area, {"type": "laser"}, {"type": "glow"}, {"type": "glow"}]})
    assert [note for note in scene.notes if "not known" in note] == [
        "tiny_lights.json: light types not known and left out: glow, laser"
    ]


@pytest.mark.parametrize(
    ("ending", "tree", "wanted"),
    [
        ("_scene", "{", "light file: got .* wanted JSON"),
        ("_scene", [], "wanted a JSON object"),
        ("_scene", {"lights": 3}, "wanted a list of objects"),
        ("_scene", {"lights": [{"pos": [0, 0], "color": [1, 1, 1]}]}, r"light 0: pos: got \[0, 0\]"),
        ("_scene", {"lights": [{"pos": [0, 0, float("nan")], "color": [1, 1, 1]}]}, "three finite numbers"),
        ("_scene", {"view": {"from": [0, 0, 0], "at": [0, 0, 1], "up": [0, 1, 0], "angle": 190}}, "angle: got 190"),
        (
            "_lights",
            {"lights": [{"type": "sphere", "center": [0, 0, 0], "radius": 0, "radiance": [1, 1, 1]}]},
            "radius",
        ),
        ("_lights", {"lights": [{"type": "area", "vertices": [[0, 0, 0]] * 4, "radiance": [1, 1, 1]}]}, "without area"),
        ("_lights", {"lights": [{"type": "area", "vertices": [[0, 0, 0]], "radiance": [1, 1, 1]}]}, "four corners"),
    ],
)
def test_wrong_light_files_are_one_line_of_input_error(tmp_path: Path, ending: str, tree: object, wanted: str) -> None:
    with pytest.raises(InputError, match=wanted) as caught:
        scene_with(tmp_path, ending, tree)
    assert len(str(caught.value).splitlines()) == 1


def test_look_at_is_rigid_points_its_minus_z_there_and_survives_looking_straight_up() -> None:
    eye, up = np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.0])
    for target in ([4.0, 2.0, 3.0], [1.0, 9.0, 3.0], [1.0, -5.0, 3.0], [1.0, 2.0, 3.0]):
        matrix = look_at(eye, np.array(target), up)
        assert np.allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)
        there = np.array(target) - eye
        if np.linalg.norm(there) > 0:
            assert np.allclose(-matrix[:3, 2], there / np.linalg.norm(there))
