"""The contact sheet: pictures of the right things, by a child process, and clear words where it cannot be made."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from stimuli.errors import InputError
from stimuli.preview import COLUMNS, TILE_PX, write_contact_sheet
from studyapp.cli import main
from tests.stimuli.tiny_glb import TinyGlb

SQUARE = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]


def flag(folder: Path) -> Path:
    """A square whose picture is red above and blue below; it moves right by 2 m in 3 s before a still camera."""
    glb = TinyGlb()
    pixels = Image.new("RGB", (2, 2), (255, 0, 0))
    pixels.putpixel((0, 1), (0, 0, 255))
    pixels.putpixel((1, 1), (0, 0, 255))
    pixels.save(folder / "flag.png")
    glb.json["images"] = [{"uri": "flag.png"}]
    glb.json["samplers"] = [{"magFilter": 9728, "minFilter": 9728}]
    glb.json["textures"] = [{"source": 0, "sampler": 0}]
    glb.json["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0}}]
    # glTF: v = 0 is the picture's upper edge.
    uv = glb.accessor([[0, 1], [1, 1], [1, 0], [0, 0]])
    node = glb.node(mesh=glb.mesh(SQUARE, [0, 1, 2, 0, 2, 3], material=0, TEXCOORD_0=uv), name="flag")
    glb.animate(node, "translation", [0.0, 3.0], [[0, 0, 0], [2, 0, 0]])
    glb.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": float(np.pi / 2)}}]
    glb.node(camera=0, translation=[0, 0, 4])
    return glb.write(folder, "flag.glb")


def test_the_sheet_shows_the_picture_upright_and_the_body_where_it_is(tmp_path: Path) -> None:
    out = tmp_path / "sheet.png"
    notes = write_contact_sheet(str(flag(tmp_path)), out)
    assert any("no light" in note for note in notes)
    with Image.open(out) as picture:
        sheet = np.asarray(picture).astype(int)
    width, height = TILE_PX
    assert sheet.shape[1] == COLUMNS * width
    first = sheet[18 : 18 + height, :width]
    red, blue = first[..., 0] - first[..., 2] > 80, first[..., 2] - first[..., 0] > 80
    assert red.any()
    assert blue.any()
    rows, columns = np.nonzero(red | blue)
    # 2 m at a distance of 4 m with a field of 90 degrees: a quarter of the height, in the middle.
    assert np.ptp(rows) + 1 == pytest.approx(height / 4, abs=3)
    assert rows.mean() == pytest.approx(height / 2, abs=2)
    assert columns.mean() == pytest.approx(width / 2, abs=2)
    assert np.nonzero(red)[0].max() <= np.nonzero(blue)[0].min()
    # The ninth picture, after 2 s: the body has moved by 4/3 m to the right, a sixth of the height.
    ninth = sheet[18 + 2 * (height + 18) : 18 + 2 * (height + 18) + height, :width]
    moved = np.nonzero(np.abs(ninth[..., 0] - ninth[..., 2]) > 80)[1].mean() - width / 2
    assert moved == pytest.approx(height / 6, abs=2)


def test_the_command_prints_what_is_in_a_scene_and_writes_the_sheet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "car.png"
    assert main(["scene", "toy_car", "--preview", str(out), "--path", "toycar"]) == 0
    said = capsys.readouterr().out
    assert "5 movers" in said
    assert "camera path 'toycar'" in said
    with Image.open(out) as sheet:
        assert sheet.size[0] == COLUMNS * TILE_PX[0]


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["nowhere.glb"], "no such file or name"),
        (["toy_car", "--path", "moon"], "camera path: got no such file or name"),
        (["toy_car", "--animation", "walk"], "a procedural scene has only its own"),
        (["toy_car", "--preview", "out.gif"], "out.gif: picture: got .gif, wanted .png or .jpg"),
        (["toy_car", "--preview", "no/such/folder/out.png"], "folder: got none there"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_two(
    arguments: list[str],
    wanted: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["scene", *arguments]) == 2
    said = capsys.readouterr().err
    assert wanted in said
    assert len(said.strip().splitlines()) == 1


def test_the_child_reports_bad_scenes_as_input_errors(tmp_path: Path) -> None:
    bad = tmp_path / "bad.glb"
    bad.write_bytes(b"glTF\2\0\0\0")
    with pytest.raises(InputError, match="broken GLB"):
        write_contact_sheet(str(bad), tmp_path / "out.png")


def test_names_of_scenes_can_be_asked_for_without_loading_pyrender_or_numpy() -> None:
    code = "import sys; from stimuli.procedural import SCENES; assert 'bar' in SCENES; "
    code += "print('pyrender' in sys.modules, 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
