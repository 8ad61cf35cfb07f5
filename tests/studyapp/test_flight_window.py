"""Flying through a scene in a window: a real one under Xvfb, its raster off-screen, and no window at all."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from renderers.gl.context import standalone_context
from stimuli import load_scene
from stimuli.camera_path import read_camera_path
from stimuli.scene import Scene
from studyapp.flight_preview import FlightPreview
from tests.stimuli.test_gltf_skins import skinned
from tests.stimuli.test_preview import flag

ROOT = Path(__file__).parents[2]
# A hand that holds W and moves the mouse: GLFW's own reading of keys and pointer is replaced, the window is real.
CHILD = """
import sys
import glfw
from studyapp.cli import main
asked = [0]
real = glfw.get_key
def held(window, key):
    asked[0] += key == glfw.KEY_ESCAPE
    down = {glfw.KEY_SPACE: 3 <= asked[0] < 6, glfw.KEY_W: asked[0] >= 3, glfw.KEY_ESCAPE: asked[0] >= LAST}
    return glfw.PRESS if down.get(key) else glfw.RELEASE
glfw.get_key = held
glfw.get_cursor_pos = lambda window: (10.0 * asked[0], 0.0)
sys.exit(main(sys.argv[1:]))
"""


def drawn(scene: Scene, time_s: float, size_px: tuple[int, int] = (64, 48)) -> np.ndarray:
    """(H, W, 3) codes of the preview's raster, row 0 at the top."""
    gl = standalone_context()
    with gl:
        target = gl.framebuffer([gl.texture(size_px, 4)], gl.depth_renderbuffer(size_px))
        target.use()
        preview = FlightPreview(gl, scene, scene.camera.yfov_rad)
        preview.draw(scene.camera.pose(np.array([time_s]))[0], time_s, size_px)
        raw = np.frombuffer(target.read(components=3, alignment=1), np.uint8)
        preview.close()
    gl.release()
    return raw.reshape(size_px[1], size_px[0], 3)[::-1].astype(int)


def test_the_raster_shows_the_picture_upright_and_the_body_where_it_is(tmp_path: Path) -> None:
    scene = load_scene(flag(tmp_path))
    first, later = drawn(scene, 0.0), drawn(scene, 3.0)
    red, blue = first[..., 0] - first[..., 2] > 60, first[..., 2] - first[..., 0] > 60
    assert red.any()
    assert np.nonzero(red)[0].max() <= np.nonzero(blue)[0].min()
    rows, columns = np.nonzero(red | blue)
    assert np.ptp(rows) + 1 == pytest.approx(48 / 4, abs=2)
    assert columns.mean() == pytest.approx(31.5, abs=1)
    # After 3 s the body is 2 m further right: a quarter of the height.
    moved = np.nonzero((later[..., 0] - later[..., 2] > 60) | (later[..., 2] - later[..., 0] > 60))[1]
    assert moved.mean() - columns.mean() == pytest.approx(12, abs=1.5)


def test_skinned_meshes_are_where_they_are_then(tmp_path: Path) -> None:
    scene = skinned(tmp_path)
    first, later = drawn(scene, 0.0), drawn(scene, 1.0)
    assert np.ptp(first) > 0
    assert (first != later).any()


@pytest.mark.parametrize("name", ["bar", "toy_car"])
def test_procedural_scenes_are_drawn(name: str) -> None:
    assert drawn(load_scene(name), 1.0).std() > 10


def recorded(
    folder: Path, environment: dict[str, str], last: int, under: list[str]
) -> subprocess.CompletedProcess[str]:
    arguments = ["scene", "tunnel_geom", "--record-path", str(folder / "flown.yaml"), "--keys-a-second", "30"]
    command = [*under, sys.executable, "-c", CHILD.replace("LAST", str(last)), *arguments]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120)


def test_a_path_is_flown_in_a_window_and_replayed(tmp_path: Path) -> None:
    if shutil.which("xvfb-run") is None:
        pytest.skip("xvfb-run is not installed")
    environment = {key: value for key, value in os.environ.items() if key != "WAYLAND_DISPLAY"}
    done = recorded(tmp_path, environment, 40, ["xvfb-run", "-a", "-s", "-screen 0 1280x720x24"])
    assert done.returncode == 0, done.stderr
    assert "W A S D" in done.stdout
    path = read_camera_path(tmp_path / "flown.yaml", 1.0)
    start = load_scene("tunnel_geom").camera.pose(np.zeros(1))[0]
    flown = path.pose(path.times_s)
    assert len(flown) > 2
    assert np.linalg.norm(flown[-1, :3, 3] - flown[0, :3, 3]) > 0
    # The mouse went right: so did the look, from where the scene's own path begins.
    assert np.cross(-start[:3, 2], -flown[-1, :3, 2])[1] < 0


def test_nothing_recorded_is_said(tmp_path: Path) -> None:
    if shutil.which("xvfb-run") is None:
        pytest.skip("xvfb-run is not installed")
    environment = {key: value for key, value in os.environ.items() if key != "WAYLAND_DISPLAY"}
    done = recorded(tmp_path, environment, 2, ["xvfb-run", "-a", "-s", "-screen 0 1280x720x24"])
    assert done.returncode == 2
    assert done.stderr.strip().splitlines()[-1].endswith("wanted at least one key (Space begins)")
    assert not (tmp_path / "flown.yaml").exists()


def test_without_a_display_it_is_refused_in_one_line(tmp_path: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if key not in ("WAYLAND_DISPLAY", "DISPLAY")}
    done = recorded(tmp_path, environment, 2, [])
    assert done.returncode == 2
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("--record-path")]
    assert "wanted a running X11 or Wayland display" in line
    assert "Traceback" not in done.stderr
