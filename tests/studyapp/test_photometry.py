"""Luminance: the curve is found, the table passes through what was measured, bad readings are named."""

from __future__ import annotations

import json
import os
import threading
import tty
from datetime import date

import numpy as np
import pytest

from stimuli.errors import InputError
from studyapp.display.choose import open_display
from studyapp.lab_file import find_lab, load_lab, photometry_age_warning
from studyapp.photometry import (
    GREYS,
    draw_patch,
    fit_curve,
    measure_photometry,
    measured_table,
    open_meter,
    parse_spotread,
    patches,
    record_of,
    typed_meter,
)


def light(rgb: tuple[int, int, int]) -> float:
    """A display with a gamma of 2.3, 300 cd/m2 and 0.3 cd/m2 of black."""
    weights = np.array([0.2126, 0.7152, 0.0722])
    return float(0.3 + 299.7 * (weights * (np.array(rgb) / 255) ** 2.3).sum())


def test_patches_are_those_of_the_protocol() -> None:
    names = [patch.name for patch in patches()]
    assert len(names) == len(set(names)) == 2 + 17 + 3 + 9
    assert GREYS[0] == 0
    assert GREYS[-1] == 255
    assert len({patch.at for patch in patches()}) == 9


def test_curve_and_table_are_found() -> None:
    codes = np.arange(256)
    true = 0.3 + 299.7 * (codes / 255) ** 2.3
    curve = fit_curve(GREYS, true[list(GREYS)].tolist())
    assert (curve.black_cd_m2, curve.white_cd_m2, curve.gamma) == pytest.approx((0.3, 300.0, 2.3), rel=1e-4)
    table = measured_table(GREYS, true[list(GREYS)].tolist())
    assert table[list(GREYS)] == pytest.approx(true[list(GREYS)], rel=1e-5)
    assert np.abs(table - true).max() < 0.005 * 300
    assert (np.diff(table) >= 0).all()


@pytest.mark.parametrize(
    "values", [[1.0, 2.0, float("nan"), 4.0], [1.0, 2.0, -1.0, 4.0], [5.0, 4.0, 3.0, 2.0], [1.0, 2.0]]
)
def test_values_that_are_no_displays_are_refused(values: list[float]) -> None:
    with pytest.raises(InputError, match="photometry: luminances"):
        fit_curve(np.linspace(0, 255, len(values)).astype(int).tolist(), values)


def test_greys_that_fall_are_refused() -> None:
    with pytest.raises(InputError, match="rises with code"):
        measured_table([0, 100, 200, 255], [0, 50, 40, 100])


def test_whole_measurement_on_the_off_screen_display_with_a_meter_that_reads_its_pixels() -> None:
    display = open_display("offscreen", (90, 60), 1000)
    named = {patch.name: patch for patch in patches()}

    def meter(name: str) -> float:
        patch, picture = named[name], display.read_pixels()
        x, y = int(patch.at[0] * 90), int(patch.at[1] * 60)
        assert picture.reshape(-1, 3).any(axis=1).sum() in (0, 144)
        return light(tuple(picture[y, x].tolist()))

    record = measure_photometry(display, "a meter", meter)
    display.close()
    assert record["curve"]["gamma"] == pytest.approx(2.3, abs=0.01)
    assert record["uniformity"] == 1.0
    assert record["additivity"] == pytest.approx(1.0, abs=0.01)
    assert len(record["luminance_cd_m2"]) == 256
    json.dumps(record, allow_nan=False)


def test_patches_stay_on_the_display_at_its_corners() -> None:
    display = open_display("offscreen", (30, 90), 1000)
    for patch in patches():
        draw_patch(display.context(), display.size_px, patch)
        lit = display.read_pixels().any(axis=2).sum()
        assert lit == (0 if patch.rgb == (0, 0, 0) else 18 * 18)
    display.close()


def test_meters() -> None:
    assert parse_spotread(" Result is XYZ: 10.5 11.25 9.0, D50 Lab: 1 2 3", "white") == 11.25
    with pytest.raises(InputError, match="spotread at white: got 'no instrument'"):
        parse_spotread("x\nno instrument\n", "white")
    said = iter(["", "abc", "-3", "1,5"])
    assert typed_meter(lambda _: next(said))("white") == 1.5
    with pytest.raises(InputError, match=r"spotread \| serial:PORT \| typed"):
        open_meter("eye")


def test_spotread_is_run_for_each_patch(tmp_path, monkeypatch) -> None:
    said = "Place instrument on spot\\n Result is XYZ: 95.0 101.5 110.0, D50 Lab: 100 0 0\\n"
    program = tmp_path / "spotread"
    program.write_text(f'#!/bin/sh\necho "$@" >> {tmp_path}/asked\nprintf "{said}"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    meter, name = open_meter("spotread")
    assert (meter("white"), meter("grey"), name) == (101.5, 101.5, "ArgyllCMS spotread")
    assert (tmp_path / "asked").read_text().splitlines() == ["-e -O -x"] * 2
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    with pytest.raises(InputError, match="spotread: got not installed"):
        open_meter("spotread")


def test_a_serial_meter_is_asked_on_its_line() -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    asked: list[bytes] = []

    def answer() -> None:
        for said in (b"  101.5 cd/m2\r\n", b"--\r\n"):
            asked.append(os.read(ours, 64))
            os.write(ours, said)

    other_side = threading.Thread(target=answer)
    other_side.start()
    meter, name = open_meter(f"serial:{os.ttyname(theirs)}")
    assert meter("white") == 101.5
    with pytest.raises(InputError, match="meter at grey: got '--"):
        meter("grey")
    other_side.join()
    assert asked == [b"M\r\n"] * 2
    assert name.startswith("serial meter on ")
    os.close(ours)
    os.close(theirs)
    with pytest.raises(InputError, match="photometry: port: got /dev/nowhere"):
        open_meter("serial:/dev/nowhere")


def test_lab_file_gives_display_table_and_age(tmp_path) -> None:
    values = [light(patch.rgb) for patch in patches()]
    record = record_of(patches(), values, "typed values", "2026-01-01T10:00:00+00:00")
    (tmp_path / "light.json").write_text(json.dumps(record))
    (tmp_path / "lab.yaml").write_text(
        "name: room_3\ndisplay:\n  kind: glfw\n  monitor: 1\n  size_px: [1920, 1080]\n  rate_hz: 240\n"
        "  settings: {vrr: 'off', overdrive: fast}\nphotometry: {file: light.json, max_age_days: 30}\n"
        "devices:\n  - {name: box, kind: cedrus_xid, port: /dev/ttyUSB0, keys: {'1': a}}\n"
    )
    lab = find_lab(None, tmp_path)
    assert lab.display.monitor == 1
    assert lab.display.declared == {"vrr": "off", "overdrive": "fast"}
    assert lab.encoding_name().startswith("measured table")
    assert len(lab.sha256) == 64
    assert photometry_age_warning(lab.photometry_record(), 30, date(2026, 1, 31)) is None
    assert "31 days ago" in str(photometry_age_warning(lab.photometry_record(), 30, date(2026, 2, 1)))
    assert "never measured" in str(photometry_age_warning(None, 30, date(2026, 2, 1)))


def test_mistakes_in_a_lab_file_are_named_at_their_lines(tmp_path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text("name: x\ndisplay:\n  kind: crt\n  rate_hz: -1\nlight: 3\n")
    with pytest.raises(InputError) as caught:
        load_lab(path)
    lines = "\n".join(sorted(caught.value.problems))
    assert "lab.yaml:3:3: display.kind: got 'crt'" in lines
    assert "lab.yaml:4:3: display.rate_hz" in lines
    assert "lab.yaml:5:1: light: got unknown key 'light'" in lines
    with pytest.raises(InputError, match="nothing there"):
        load_lab(tmp_path / "none.yaml")


def test_no_lab_file_is_an_undeclared_room(tmp_path, monkeypatch) -> None:
    monkeypatch.delenv("STUDYAPP_LAB", raising=False)
    lab = find_lab(None, tmp_path)
    assert lab.path is None
    assert lab.encoding_name() == "sRGB (assumed)"
