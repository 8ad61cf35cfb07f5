"""Pictures of a view by name: a monitor's, and all viewports of a headset on one labelled sheet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from renderers.catalogue import CATALOGUE
from renderers.stereo import OCULUS_DK2, headset_viewports
from renderers.view_pictures import Sheet, view_sheet
from stimuli import load_scene
from stimuli.errors import InputError
from studyapp.cli import main


def test_the_papers_headsets() -> None:
    left, right = headset_viewports("foveated")
    assert left.size_px == right.size_px == OCULUS_DK2.size_px == (1182, 1464)
    assert np.degrees(left.yfov_rad) == pytest.approx(106)
    assert right.eye_offset_m - left.eye_offset_m == pytest.approx(0.064)
    panels = {v.name: v for v in headset_viewports("polar")}
    assert list(panels) == ["left inset", "left surround", "right inset", "right surround"]
    for name, ppd, field in (("left inset", 60, 40), ("right surround", 22, 90)):
        v = panels[name]
        assert np.degrees(v.yfov_rad) == pytest.approx(field)
        middle = 2 * np.tan(v.yfov_rad / 2) / v.size_px[1]  # tangent a pixel, which is the angle at the centre
        assert np.degrees(middle) == pytest.approx(1 / ppd, rel=1e-3)
    quarter = [v.size_px[0] for v in headset_viewports("polar", 0.25)]
    np.testing.assert_allclose(quarter, [v.size_px[0] / 4 for v in panels.values()], atol=0.5)


def test_the_catalogue_says_who_has_a_headset_view() -> None:
    for name, entry in CATALOGUE.items():
        if entry.headset:
            assert len(headset_viewports(name, 0.05)) in (2, 4)
        else:
            with pytest.raises(InputError, match=r"headset of foveated \| polar"):
                headset_viewports(name)
    for scale in (0.0, -1.0, 1.5, float("nan")):
        with pytest.raises(InputError, match="scale"):
            headset_viewports("polar", scale)


@pytest.mark.parametrize(
    ("technique", "rows"),
    [
        ("foveated", (("left", "right"),)),
        ("polar", (("left inset", "right inset"), ("left surround", "right surround"))),
    ],
)
def test_every_viewport_of_a_headset_is_on_the_sheet(technique: str, rows: tuple[tuple[str, ...], ...]) -> None:
    scene = load_scene("tunnel_geom")
    sheet = view_sheet(scene, technique, "headset", scene.camera, scale=1 / 20, frames=2)
    assert sheet.rows == rows
    viewports = {v.name: v for v in headset_viewports(technique, 1 / 20)}
    for name, codes in sheet.codes.items():
        width, height = viewports[name].size_px
        assert codes.shape == (height, width, 3)
        assert codes.std() > 1
        assert sheet.words[name].startswith(f"{width}x{height}, ")
    eyes = [sheet.codes[name].astype(int) for name in rows[-1]]
    assert 0 < np.abs(eyes[0] - eyes[1]).mean() < 60  # parallax, of the same scene
    image = np.asarray(sheet.image())
    for row in rows:  # the picture is on the sheet as it is, and the bar above it is written on
        for name in row:
            codes = sheet.codes[name]
            places = np.argwhere((image[: image.shape[0] - codes.shape[0] + 1] == codes[0, 0]).all(axis=2))
            fits = [
                (y, x) for y, x in places if np.array_equal(image[y : y + len(codes), x : x + codes.shape[1]], codes)
            ]
            assert fits, name
            y, x = fits[0]
            assert image[y - 18 : y, x : x + 40].max() > 200


def test_a_sheet_leaves_room_for_pictures_of_different_sizes() -> None:
    codes = {"a": np.full((10, 30, 3), 9, np.uint8), "b": np.full((20, 10, 3), 8, np.uint8),
             "c": np.full((5, 50, 3), 7, np.uint8)}  # fmt: skip
    image = np.asarray(Sheet((("a", "b"), ("c",)), codes, dict.fromkeys(codes, "")).image())
    assert image.shape == (18 + 20 + 4 + 18 + 5, 50, 3)
    assert [(image == value).all(axis=2).sum() for value in (9, 8, 7)] == [300, 200, 250]


def written(tmp_path: Path, *arguments: str) -> tuple[int, Path]:
    out = tmp_path / "view.png"
    return main(["scene", "tunnel_geom", "--frames", "2", "--out", str(out), *arguments]), out


def test_the_command_writes_a_headset_and_a_monitor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out = written(tmp_path, "--technique", "polar", "--view", "headset", "--scale", "1/20", "--gaze", "5,-6")
    assert code == 0
    assert "left inset 125x125, 40 x 40 degrees" in capsys.readouterr().out
    with Image.open(out) as image:
        assert image.size == (2 * 126 + 4, 2 * (126 + 18) - 1 + 4)
    assert written(tmp_path, "--technique", "vanilla", "--view", "monitor", "--size", "40x30")[0] == 0
    with Image.open(out) as image:
        assert image.size == (40, 48)


def test_debug_maps_of_a_headset_share_one_scale(tmp_path: Path) -> None:
    scene = load_scene("tunnel_geom")
    found = view_sheet(scene, "polar", "headset", scene.camera, scale=1 / 20, frames=1, show="main.eccentricity")
    inset, surround = found.codes["left inset"], found.codes["left surround"]
    # The inset's corner (27 degrees off the axis) has the colour of that eccentricity in the surround.
    corner = np.tan(np.radians(20)) / np.tan(np.radians(45)) / 2
    y, x = (round((0.5 - corner) * n) for n in surround.shape[:2])
    assert np.abs(inset[0, 0].astype(int) - surround[y, x]).max() <= 8
    assert (
        written(tmp_path, "--technique", "foveated", "--view", "headset", "--scale", "1/20", "--show", "marks")[0] == 0
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--view", "headset", "--technique", "vanilla"], "headset of foveated | polar"),
        (["--view", "headset", "--technique", "polar", "--scale", "2"], "above 0, at most 1"),
        (["--view", "headset", "--technique", "polar", "--scale", "big"], "--scale"),
        (["--view", "monitor", "--technique", "polar", "--scale", "1/4"], "--size"),
        (["--view", "headset", "--technique", "polar", "--gaze", "5"], "--gaze: direction: got '5'"),
        (["--view", "headset", "--technique", "polar", "--gaze", "nan,0", "--scale", "1/40"], "gaze"),
        (["--view", "headset", "--technique", "polar", "--scale", "1/40", "--show", "x"], "main | main.eccentricity"),
        (["--view", "monitor", "--technique", "vanilla", "--show", "marks"], "without debug pictures"),
    ],
)
def test_what_cannot_be_viewed_is_one_line(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out = written(tmp_path, *arguments)
    assert code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert words in line
    assert not out.exists()
