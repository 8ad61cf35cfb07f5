"""Camera paths: splines through their keys, closed loops without a jump, named paths, files, bad files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stimuli import SCENES
from stimuli.camera_path import (
    PATH_NAMES,
    KeyedCamera,
    camera_path,
    camera_path_sha256,
    read_camera_path,
    scene_radius,
    write_camera_path,
)
from stimuli.errors import InputError


def keyed(closed: bool = False, interpolation: str = "spline") -> KeyedCamera:
    rng = np.random.default_rng(4)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.4, (5, 3)), axis=0)).as_quat()
    # Signs that differ must not send the camera the long way round.
    turns[2] *= -1
    places = rng.normal(size=(5, 3))
    if closed:
        turns[-1], places[-1] = turns[0], places[0]
    return KeyedCamera(np.array([0.0, 1.0, 1.5, 3.0, 4.0]), places, turns, 0.8, "k", closed, interpolation)  # type: ignore[arg-type]


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("interpolation", ["spline", "linear"])
def test_the_path_goes_through_its_keys_and_is_rigid(closed: bool, interpolation: str) -> None:
    camera = keyed(closed, interpolation)
    pose = camera.pose(camera.times_s)
    assert np.allclose(pose[:, :3, 3], camera.positions, atol=1e-12)
    assert np.allclose(pose[:, :3, :3], Rotation.from_quat(camera.quaternions).as_matrix(), atol=1e-9)
    between = camera.pose(np.linspace(-2.0, 9.0, 300))[:, :3, :3]
    assert np.allclose(np.einsum("tji,tjk->tik", between, between), np.eye(3), atol=1e-9)


def test_a_spline_path_has_no_jumps_in_speed_or_acceleration_and_a_closed_one_not_even_at_its_seam() -> None:
    camera = keyed(closed=True)
    step = 1e-4
    times = np.arange(3.9, 4.1, step)
    for values in (camera.pose(times)[:, :3, 3], camera.pose(times)[:, :3, 0]):
        second = np.diff(values, 2, axis=0) / step**2
        assert np.abs(np.diff(second, axis=0)).max() < 0.05 * max(1.0, np.abs(second).max())
    assert np.allclose(camera.pose(np.array([0.7])), camera.pose(np.array([0.7 + 4.0 * 3])), atol=1e-9)


def test_a_closed_path_that_turns_once_round_comes_home_without_a_jump() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 9)
    turns = np.stack([np.zeros(9), np.sin(angle / 2), np.zeros(9), np.cos(angle / 2)], axis=1)
    camera = KeyedCamera(np.linspace(0.0, 8.0, 9), np.zeros((9, 3)), turns, 0.8, closed=True)
    times = np.linspace(0.0, 16.0, 3201)
    forward = -camera.pose(times)[:, :3, 2]
    turned = np.degrees(np.arccos(np.clip(np.sum(forward[1:] * forward[:-1], axis=1), -1, 1)))
    assert turned.max() < 0.3
    assert turned.min() > 0.15


def test_outside_an_open_path_the_end_values_hold_and_one_key_stands_still() -> None:
    camera = keyed()
    assert np.array_equal(camera.pose(np.array([-5.0])), camera.pose(np.array([0.0])))
    assert np.array_equal(camera.pose(np.array([50.0])), camera.pose(np.array([4.0])))
    single = KeyedCamera(np.array([1.0]), np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 0.0, 0.0, 2.0]]), 0.8)
    assert np.array_equal(single.pose(np.array([0.0, 9.0]))[1, :3, 3], (1.0, 2.0, 3.0))


def test_sway_is_a_horizontal_ellipse_of_two_percent_with_ten_degrees_and_four_seconds() -> None:
    scene = SCENES["toy_car"]()
    sway = camera_path(scene, "sway")
    start = scene.camera.pose(np.zeros(1))[0]
    pose = sway.pose(np.linspace(0.0, 4.0, 401))
    offset = pose[:, :3, 3] - start[:3, 3]
    assert np.allclose(offset[:, 1], 0.0)
    assert np.linalg.norm(offset, axis=1).max() == pytest.approx(0.02 * scene_radius(scene), rel=1e-3)
    assert np.allclose(pose[0], pose[-1])
    cosine = pose[:, :3, 2] @ start[:3, 2]
    horizontal = np.linalg.norm(start[[0, 2], 2])
    turned = np.arccos(np.clip((cosine - start[1, 2] ** 2) / horizontal**2, -1.0, 1.0))
    assert np.degrees(turned).max() == pytest.approx(10.0, abs=0.01)


@pytest.mark.parametrize("name", PATH_NAMES)
def test_every_named_path_is_rigid_repeatable_and_has_its_own_identity(name: str) -> None:
    scene = SCENES["toy_car"]()
    camera = camera_path(scene, name)
    times = np.linspace(0.0, 21.0, 100)
    pose = camera.pose(times)
    assert np.array_equal(pose, camera_path(SCENES["toy_car"](), name).pose(times))
    assert np.allclose(np.einsum("tji,tjk->tik", pose[:, :3, :3], pose[:, :3, :3]), np.eye(3), atol=1e-9)
    assert camera.yfov_rad == scene.camera.yfov_rad
    assert len({camera_path_sha256(each) for each in PATH_NAMES}) == len(PATH_NAMES)


def test_toycar_on_a_scene_where_nothing_moves_is_refused() -> None:
    with pytest.raises(InputError, match="a scene with a moving car"):
        camera_path(SCENES["tunnel_geom"](), "toycar")


def test_a_recorded_path_is_played_back_as_it_was(tmp_path: Path) -> None:
    camera = keyed()
    times = np.arange(0.0, 4.0, 1 / 120)
    file = tmp_path / "walk.json"
    write_camera_path(file, camera, times)
    replayed = read_camera_path(file, 0.1)
    assert replayed.yfov_rad == pytest.approx(0.8)
    assert np.allclose(replayed.pose(times), camera.pose(times), atol=1e-12)
    between = times + 1 / 240
    assert np.allclose(replayed.pose(between)[:-1], camera.pose(between)[:-1], atol=1e-3)


def test_a_yaml_path_with_look_at_and_a_closed_loop_is_read(tmp_path: Path) -> None:
    file = tmp_path / "fly.yaml"
    file.write_text(
        "closed: true\nperiod_s: 4\nyfov_deg: 60\nkeys:\n"
        "  - {time_s: 0, position: [0, 0, 5], look_at: [0, 0, 0]}\n"
        "  - {time_s: 1, position: [5, 0, 0], look_at: [0, 0, 0]}\n"
        "  - {time_s: 2, position: [0, 0, -5], look_at: [0, 0, 0]}\n"
        "  - {time_s: 3, position: [-5, 0, 0], rotation: [0, -0.7071067811865476, 0, 0.7071067811865476]}\n"
    )
    camera = camera_path(SCENES["tunnel_geom"](), file)
    assert np.degrees(camera.yfov_rad) == pytest.approx(60.0)
    assert np.allclose(camera.pose(np.array([4.0])), camera.pose(np.array([0.0])))
    pose = camera.pose(np.array([0.5, 3.5]))
    assert np.allclose(np.linalg.norm(pose[:, :3, 3], axis=1), 5.0, atol=0.35)
    before = camera_path_sha256(file)
    file.write_text(file.read_text().replace("60", "61"))
    assert camera_path_sha256(file) != before


@pytest.mark.parametrize(
    ("tree", "wanted"),
    [
        ({}, ["keys: got None"]),
        ({"keys": []}, ["keys: got []"]),
        ({"keys": [{"time_s": 0, "position": [0, 0, 0]}]}, ["key 0: rotation: got None"]),
        (
            {"speed": 3, "keys": [{"time_s": "x", "position": [0, 0], "rotation": [0, 0, 0, 0]}]},
            ["entry: got 'speed'", "time_s: got x", "position: got [0, 0]", "rotation: got [0, 0, 0, 0]"],
        ),
        (
            {
                "keys": [
                    {"time_s": 1, "position": [0, 0, 0], "rotation": [0, 0, 0, 1]},
                    {"time_s": 1, "position": [0, 0, 0], "rotation": [0, 0, 0, 1]},
                ]
            },
            ["key 1: time_s: got 1, wanted later than 1.0"],
        ),
        (
            {"yfov_deg": 0, "keys": [{"time_s": 1, "position": [0, 0, 0], "look_at": [0, 0, 0]}]},
            ["look_at", "yfov_deg"],
        ),
        (
            {"closed": True, "keys": [{"time_s": 1, "position": [0, 0, 0], "look_at": [0, 0, 1]}]},
            ["period_s: got None"],
        ),
    ],
)
def test_every_problem_of_a_path_file_is_said_at_once(tmp_path: Path, tree: object, wanted: list[str]) -> None:
    file = tmp_path / "path.json"
    file.write_text(json.dumps(tree))
    with pytest.raises(InputError) as caught:
        read_camera_path(file, 0.8)
    lines = caught.value.problems
    assert len(lines) == len(wanted)
    for line, part in zip(lines, wanted, strict=True):
        assert part in line


def test_a_path_that_is_neither_name_nor_file_is_refused_with_the_choices() -> None:
    with pytest.raises(InputError, match=r"file \| still \| sway \| toycar \| interactive"):
        camera_path(SCENES["tunnel_geom"](), "flyy")
