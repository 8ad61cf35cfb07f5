"""The synthetic visitor keeps clear of every surface; distances against brute force."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from stimuli import SCENES, load_scene
from stimuli.camera_path import camera_path, scene_radius
from stimuli.clearance import Clearance
from stimuli.scene import Mover, Part, Primitive, Scene, StillCamera
from tests.renderers.scenes import scene_of, unlit
from tests.renderers.scenes_by_hand import Drift

Triple = tuple[float, float, float]


def quad(corner: Triple, u: Triple, v: Triple, name: str = "quad") -> Part:
    a, du, dv = np.array(corner, float), np.array(u, float), np.array(v, float)
    points = np.array([a, a + du, a + du + dv, a + dv], np.float32)
    return Part(name, Primitive(points, indices=np.array([[0, 1, 2], [0, 2, 3]], np.uint32), mode=4), unlit())


TIMES_S = np.arange(0.0, 21.0, 1 / 120)


def corridor(half_m: float, *movers: Mover) -> Scene:
    """Two long walls ``half_m`` to the left and right of the camera; the radius is 50 m, a step sideways up to 2 m."""
    walls = [quad((x, -30, -40), (0, 60, 0), (0, 0, 80)) for x in (-half_m, half_m)]
    return scene_of(*walls, camera=StillCamera(np.eye(4), 1.0), movers=movers)


def places(scene: Scene) -> np.ndarray:
    found: np.ndarray = camera_path(scene, "interactive").pose(TIMES_S)[:, :3, 3]
    return found


def test_the_visitor_stays_between_walls_and_uses_the_room_there_is() -> None:
    wide, narrow = places(corridor(25.0)), places(corridor(0.8))
    assert np.abs(wide[:, 0]).max() > 1.0  # so the walls of the narrow one are in the way
    assert np.abs(narrow[:, 0]).max() <= 0.8 - 0.4 * 0.9
    assert np.abs(narrow[:, 0]).max() > 0.2
    assert np.abs(narrow[:, 2]).max() > 1.0


def test_steps_through_a_wall_into_the_free_room_behind_it_are_drawn_anew() -> None:
    wall = quad((0.5, -30, -40), (0, 60, 0), (0, 0, 80))
    scene = scene_of(wall, quad((-30, -30, -30), (60, 0, 0), (0, 60, 0)), camera=StillCamera(np.eye(4), 1.0))
    assert places(scene)[:, 0].max() < 0.5 - 0.2


def test_a_mover_is_kept_clear_of_where_it_is_at_that_time() -> None:
    panel = quad((-20, -20, 0), (40, 0, 0), (0, 40, 0), name="panel")
    track = Drift((0, 0, -6.0), (0, 0, 0.25))  # comes from ahead, a metre from the start in the end
    scene = corridor(25.0, Mover("panel", (panel,), track))
    at = places(scene)
    panel_z = track.pose(TIMES_S)[:, 2, 3]
    assert (at[:, 2] - panel_z).min() > 0.25
    assert at[:, 2].min() < -1.0


def test_a_start_that_touches_a_surface_only_turns() -> None:
    scene = scene_of(quad((-30, 0, -30), (60, 0, 0), (0, 0, 60)), camera=StillCamera(np.eye(4), 1.0))
    path = camera_path(scene, "interactive")
    np.testing.assert_array_equal(path.pose(TIMES_S)[:, :3, 3], 0.0)
    assert np.ptp(path.pose(TIMES_S)[:, 0, 2]) > 0.5


def test_the_path_is_the_same_each_time() -> None:
    first, second = places(SCENES["living_room"]()), places(SCENES["living_room"]())
    np.testing.assert_array_equal(first, second)


def test_distances_are_those_of_brute_force() -> None:
    rng = np.random.default_rng(2)
    parts = tuple(quad(*rng.uniform(-2, 2, (3, 3))) for _ in range(12))
    turned = rng.normal(size=3)
    pose = np.eye(4)
    pose[:3, :3] = 0.4 * trimesh.transformations.rotation_matrix(1.0, turned)[:3, :3]
    pose[:3, 3] = 0.3, -0.2, 0.5
    scene = scene_of(*parts[:6], movers=(Mover("m", parts[6:], Still(pose)),))
    clearance = Clearance(scene, np.zeros(3), 20.0)
    share = np.stack(np.meshgrid(np.linspace(0, 1, 201), np.linspace(0, 1, 201)), axis=-1).reshape(-1, 2)
    for place in rng.uniform(-2.5, 2.5, (12, 3)):
        nearest = np.inf
        for k, part in enumerate(parts):
            corner = part.positions[0]
            right, up = part.positions[1] - corner, part.positions[3] - corner
            cloud = corner + share[:, :1] * right + share[:, 1:] * up
            cloud = cloud @ pose[:3, :3].T + pose[:3, 3] if k >= 6 else cloud
            nearest = min(nearest, float(np.linalg.norm(cloud - place, axis=1).min()))
        found = clearance.at(place, np.zeros(1), 10.0)
        assert nearest - 0.02 <= found <= nearest + 1e-6
        assert clearance.at(place, np.zeros(1), 0.5 * found) == pytest.approx(0.5 * found)


class Still:
    """A pose for all times."""

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix = matrix

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        return np.repeat(self.matrix[None], np.size(time_s), axis=0)


def test_the_visitor_of_the_bart_kitchen_never_enters_furniture(assets: Path) -> None:
    scene = load_scene(assets / "bart_kitchen/bart_kitchen.glb")
    path = camera_path(scene, "interactive")
    times_s = np.arange(0.0, 20.0, 1 / 10)
    at = path.pose(times_s)[:, :3, 3]
    clearance = Clearance(scene, at[0], 2.0)
    least = [clearance.at(place, times_s[k : k + 1], 0.05) for k, place in enumerate(at)]
    assert min(least) >= 0.009  # the start itself has 0.02 m under the ceiling
    assert np.ptp(at, axis=0).max() > 0.1 * scene_radius(scene) * 0.2
