"""``studyapp scene``: what a scene requires, and debug pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from renderers.debug_pictures import Shown, colored, decision_map, value_range
from studyapp.cli import main


def test_requires_says_what_and_why(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", "tunnel_maps", "--requires"]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line.startswith("  ")}
    assert " yes " in lines["base_texture"]
    assert "material tiles" in lines["base_texture"]
    assert " no " in lines["mirrors"]
    assert "point light" in lines["lights"]


@pytest.mark.parametrize("what", ["segmentation", "class", "motion.X"])
def test_a_debug_picture_is_written(what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "map.png"
    assert main(["scene", "toy_car", "--show", what, "--size", "40x26", "--frames", "6", "--out", str(out)]) == 0
    assert f"wrote {out}" in capsys.readouterr().out
    with Image.open(out) as image:
        picture = np.asarray(image)
    assert picture.shape == (26, 40, 3)
    assert picture.std() > 0


def test_the_order_map_is_written(tmp_path: Path) -> None:
    out = tmp_path / "decision.png"
    assert main(["scene", "toy_car", "--show", "decision", "--out", str(out)]) == 0
    with Image.open(out) as picture:
        assert picture.width > 800


def test_the_order_maps_are_those_of_the_paper() -> None:
    """Fig. 10: along the rows (alpha 0) hourglass where l_f is in [0.25, 0.75]; along the columns the other way."""
    for decision in ("up", "down", "dominant", "combined"):
        chosen = decision_map(decision, 100)
        assert chosen[0, 50]
        assert not chosen[0, 5]
        assert not chosen[-1, 50]
        assert chosen[-1, 5]
    coins = decision_map("combined", 100)[50]
    assert 20 < coins.sum() < 80
    assert decision_map("up", 100)[50].sum() == pytest.approx(50, abs=2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--show", "nothing"], "segmentation | class"),
        (["--show", "class", "--technique", "vanilla"], "temporally_dense"),
        (["--show", "class", "--technique", "vanila"], "vanilla"),
        (["--show", "class", "--out", "map.jpg"], ".png"),
        (["--show", "class", "--size", "40"], "WxH"),
        (["--show", "class", "--frames", "0"], "--frames"),
    ],
)
def test_wrong_requests_are_one_line(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", "tunnel_geom", *arguments]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert words in error


def test_values_that_change_sign_have_zero_in_the_middle_of_the_scale() -> None:
    shown = Shown(np.zeros((1, 3, 3), np.uint8), np.array([[-1.0, 0.0, 3.0]]), "motion.X")
    assert value_range(shown) == (-3, 3)
    middle = colored(shown)[0, 1].astype(int)
    assert np.ptp(middle) < 5  # grey
    assert value_range(Shown(shown.codes, np.full((1, 1), np.nan), "x")) == (0, 1)
