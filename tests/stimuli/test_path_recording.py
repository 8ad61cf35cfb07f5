"""Camera paths flown by hand: what was steered is what the file replays, however unevenly the window asked."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from stimuli import load_scene
from stimuli.camera_path import read_camera_path
from stimuli.errors import InputError
from stimuli.path_recording import FAST, FlyCamera, Steering, fly, write_path_keys
from stimuli.scene import StillCamera

AHEAD = Steering(move=(0.0, 0.0, 1.0))
BEGIN = Steering(record=True)


@dataclass
class Script:
    """A `FlightWindow` without a window: (seconds until it is asked, steering) one after another, then the end."""

    hand: list[tuple[float, Steering]]
    clock_s: float = 100.0
    shown: list[tuple[np.ndarray, float, float | None]] = field(default_factory=list)

    def now_s(self) -> float:
        return self.clock_s

    def steering(self) -> Steering | None:
        if not self.hand:
            return None
        wait_s, given = self.hand.pop(0)
        self.clock_s += wait_s
        return given

    def show(self, pose: np.ndarray, time_s: float, recorded_s: float | None) -> None:
        self.shown.append((pose, time_s, recorded_s))


@pytest.fixture(scope="module")
def tunnel():
    return load_scene("tunnel_geom")


def test_keys_stand_at_a_fixed_rate_whatever_the_window_does(tunnel) -> None:
    rng = np.random.default_rng(0)
    uneven = [(float(wait), AHEAD) for wait in rng.uniform(0.001, 0.3, 40)]
    script = Script([(0.0, BEGIN), *uneven])
    keys = fly(tunnel, tunnel.camera, script, rate_hz=20, start_s=1.0)
    assert [key.time_s for key in keys] == [1 + k / 20 for k in range(len(keys))]
    assert len(keys) == int(sum(wait for wait, _ in uneven) * 20 + 1e-9) + 1
    even = fly(tunnel, tunnel.camera, Script([(0.0, BEGIN), *[(0.05, AHEAD)] * len(keys)]), 20, 1.0)
    for one, other in zip(keys, even, strict=False):
        np.testing.assert_allclose(one.position, other.position, atol=1e-9)
    assert script.shown[-1][1] == pytest.approx(keys[-1].time_s, abs=1 / 20)


def test_nothing_is_recorded_before_the_hand_says_so(tunnel) -> None:
    script = Script([(0.1, AHEAD)] * 30 + [(0.1, BEGIN)] + [(0.1, Steering())] * 20)
    keys = fly(tunnel, tunnel.camera, script)
    assert keys[0].time_s == 0
    assert len(keys) in (40, 41)  # the last one stands at the very end
    # It had flown before, and the scene's clock stood still meanwhile.
    assert np.linalg.norm(keys[0].position - tunnel.camera.pose(np.zeros(1))[0, :3, 3]) > 0.1
    assert [time_s for _, time_s, recorded in script.shown if recorded is None] == [0.0] * 30
    assert fly(tunnel, tunnel.camera, Script([(0.1, AHEAD)] * 5)) == []


def test_what_was_flown_is_what_the_file_replays(tunnel, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    hand = [(0.0, BEGIN)]
    for _ in range(12):
        move = tuple(rng.integers(-1, 2, 3).astype(float))
        turn = tuple(rng.uniform(-0.06, 0.06, 2))
        hand += [(1 / 60, Steering(move, turn, fast=bool(rng.integers(2))))] * 25
    script = Script(hand)
    keys = fly(tunnel, tunnel.camera, script)
    file = tmp_path / "flown.yaml"
    write_path_keys(file, keys, tunnel.camera.yfov_rad, "by a test")
    replayed = read_camera_path(file, 1.0)
    assert replayed.yfov_rad == pytest.approx(tunnel.camera.yfov_rad)
    shown = [(pose, time_s) for pose, time_s, recorded in script.shown if recorded and time_s <= keys[-1].time_s]
    flown = np.array([pose for pose, _ in shown])
    again = replayed.pose(np.array([time_s for _, time_s in shown]))
    assert len(shown) > 250
    distance = np.linalg.norm(flown[1:, :3, 3] - flown[:-1, :3, 3], axis=1).sum()
    assert np.abs(again[:, :3, 3] - flown[:, :3, 3]).max() < 1e-3 * distance
    cosine = np.einsum("nk,nk->n", again[:, :3, 2], flown[:, :3, 2])
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.5
    # No roll: the camera's right stays level.
    assert np.abs(again[:, 1, 0]).max() < 1e-3


def test_the_camera_reaches_the_speed_that_is_held_and_comes_to_rest() -> None:
    camera = FlyCamera.beginning_at(np.eye(4), speed=2.0)
    for _ in range(1000):
        camera.step(0.005, AHEAD)
    assert camera.velocity == pytest.approx([0, 0, -2.0], abs=1e-6)
    for _ in range(1000):
        camera.step(0.005, Steering(move=(0.0, 0.0, 1.0), fast=True))
    assert camera.velocity == pytest.approx([0, 0, -2.0 * FAST], abs=1e-6)
    for _ in range(1000):
        camera.step(0.005, Steering())
    assert camera.velocity == pytest.approx([0, 0, 0], abs=1e-6)
    # Two keys at once are no faster than one.
    for _ in range(1000):
        camera.step(0.005, Steering(move=(1.0, 0.0, 1.0)))
    assert np.linalg.norm(camera.velocity) == pytest.approx(2.0)


def test_turning_right_looks_right_and_up_ends_before_the_zenith() -> None:
    camera = FlyCamera.beginning_at(np.eye(4), speed=1.0)
    camera.turn(np.pi / 2, 0.0)
    for _ in range(400):
        camera.step(0.01, Steering())
    np.testing.assert_allclose(camera.forward, [1, 0, 0], atol=1e-6)
    camera.turn(0.0, 10.0)
    for _ in range(400):
        camera.step(0.01, Steering())
    assert np.degrees(camera.pitch_rad) == pytest.approx(85.0)
    pose = camera.pose()
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("down", [False, True])
def test_it_begins_where_the_path_is_even_looking_straight_up_or_down(down: bool) -> None:
    matrix = np.eye(4)
    matrix[:3, 3] = (1, 2, 3)
    # Looking along +-y, the picture's upper edge towards -z or +z.
    matrix[:3, 1] = (0, 0, -1) if down else (0, 0, 1)
    matrix[:3, 2] = (0, 1, 0) if down else (0, -1, 0)
    camera = FlyCamera.beginning_at(StillCamera(matrix, 1.0).pose(np.zeros(1))[0], 1.0)
    assert camera.position.tolist() == [1, 2, 3]
    assert np.degrees(camera.pitch_rad) == pytest.approx(-85 if down else 85)
    assert camera.forward[2] == pytest.approx(-np.cos(np.radians(85)))


def test_a_recording_ends_by_itself_before_no_protocol_takes_it(tunnel) -> None:
    script = Script([(0.0, BEGIN)] + [(1.0, AHEAD)] * 100)
    keys = fly(tunnel, tunnel.camera, script, most_keys=50)
    assert len(keys) == 50
    assert script.hand


def test_wrong_recordings_are_one_line(tunnel, tmp_path: Path) -> None:
    for rate in (0.0, -1.0, float("nan"), 1000.0):
        with pytest.raises(InputError, match="keys a second"):
            fly(tunnel, tunnel.camera, Script([]), rate)
    with pytest.raises(InputError, match="Space begins"):
        write_path_keys(tmp_path / "none.yaml", [], 1.0, "nothing")
