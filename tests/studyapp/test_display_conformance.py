"""One suite over every kind of display: virtual, off-screen, and GLFW windows (X11 without a vblank, Wayland with one).

A window lives in a child process: a GLX context must not share a process with other users of OpenGL.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from stimuli.errors import InputError
from studyapp.display.choose import open_display
from studyapp.display.glfw_display import _pick_mode
from studyapp.display.stamps import FenceStamp, OmlStamp, probe
from studyapp.seams import Display
from tests.studyapp.headless_compositor import CompositorMissing, headless_compositor

ROOT = Path(__file__).resolve().parents[2]
SIZE = (160, 90)


def check_conformance(display: Display) -> None:
    """What every display must do; run here for two kinds and in a child process for windows."""
    assert display.size_px == SIZE
    assert isinstance(display.nominal_hz, Fraction)
    assert display.stamp_class in ("hardware", "software", "timer", "virtual")
    assert display.description
    flips = [display.flip() for _ in range(40)]
    for earlier, later in pairwise(flips):
        # Indices never fall; a step of more than one is a miss of that size less one.
        assert later.index >= earlier.index
        assert later.missed == max(0, later.index - earlier.index - 1)
        assert later.shown_ns > earlier.shown_ns
    assert all(flip.submitted_ns <= flip.shown_ns for flip in flips)
    assert display.now_ns() >= flips[-1].shown_ns
    assert display.keys() == []
    gl = display.context()
    if gl is not None:
        # Two colours, one above the other: row 0 is the top.
        width, height = SIZE
        gl.scissor = None
        gl.clear(1.0, 0.0, 0.0, 1.0)
        gl.scissor = (0, 0, width, height // 2)
        gl.clear(0.0, 0.0, 1.0, 1.0)
        gl.scissor = None
        if display.stamp_class == "timer":
            display.flip()
        pixels = display.read_pixels()
        assert pixels.shape == (height, width, 3)
        assert pixels.dtype == np.uint8
        assert pixels[0, 0].tolist() == [255, 0, 0]
        assert pixels[-1, -1].tolist() == [0, 0, 255]
    else:
        assert display.read_pixels().shape == (SIZE[1], SIZE[0], 3)
    display.close()
    display.close()


@pytest.mark.parametrize("kind", ["virtual", "offscreen"])
def test_conformance_without_a_window(kind: str) -> None:
    check_conformance(open_display(kind, SIZE, 240))


CHILD = """
from studyapp.display.choose import open_display
from tests.studyapp.test_display_conformance import SIZE, check_conformance
check_conformance(open_display("glfw", SIZE, 240))
"""
Runner = Callable[[list[str]], "subprocess.CompletedProcess[str]"]


@pytest.fixture
def on_xvfb() -> Runner:
    if shutil.which("xvfb-run") is None:
        pytest.skip("xvfb-run is not installed")
    environment = {key: value for key, value in os.environ.items() if key != "WAYLAND_DISPLAY"}

    def run(arguments: list[str]) -> subprocess.CompletedProcess[str]:
        command = ["xvfb-run", "-a", "-s", "-screen 0 1280x720x24", sys.executable, *arguments]
        return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120)

    return run


def sway_runner(announced_hz: int) -> Iterator[Runner]:
    try:
        with headless_compositor(announced_hz) as environment:

            def run(arguments: list[str]) -> subprocess.CompletedProcess[str]:
                command = [sys.executable, *arguments]
                return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120)

            yield run
    except CompositorMissing as missing:
        pytest.skip(str(missing))


@pytest.fixture(scope="module")
def on_sway_240() -> Iterator[Runner]:
    yield from sway_runner(240)


@pytest.fixture(scope="module")
def on_sway_260() -> Iterator[Runner]:
    yield from sway_runner(260)


def test_conformance_of_an_x11_window(on_xvfb: Runner) -> None:
    done = on_xvfb(["-c", CHILD])
    assert done.returncode == 0, done.stderr


def test_conformance_of_a_wayland_window(on_sway_240: Runner) -> None:
    done = on_sway_240(["-c", CHILD])
    assert done.returncode == 0, done.stderr


def test_xvfb_is_refused_it_has_no_vblank(on_xvfb: Runner) -> None:
    done = on_xvfb(
        ["-m", "studyapp", "display", "--display", "glfw", "--size", "160x90", "--refreshes", "480", "--json"]
    )
    assert done.returncode == 1, done.stderr
    certificate = json.loads(done.stdout)
    assert certificate["locked"] is False
    assert certificate["reason"].startswith("no vblank")
    assert certificate["residual_sd_ms"] is None


@pytest.mark.parametrize("where", ["on_sway_240", "on_sway_260"])
def test_headless_compositor_is_refused_and_the_reasons_are_named(where: str, request: pytest.FixtureRequest) -> None:
    arguments = ["--display", "glfw", "--size", "160x90", "--refreshes", "480", "--json"]
    done = request.getfixturevalue(where)(["-m", "studyapp", "display", *arguments])
    assert done.returncode == 1, done.stderr
    certificate = json.loads(done.stdout)
    assert certificate["locked"] is False
    assert certificate["stamp_class"] == "software"
    assert any("compositor" in warning for warning in certificate["warnings"])
    # Its phase wanders on every machine; how far its rate lies depends on the machine (its timer counts in whole ms).
    assert "wandering phase: residual SD" in certificate["reason"]
    lies = abs(certificate["nominal_hz"] / certificate["measured_hz"] - 1) > 0.01
    assert ("rate: nominal" in certificate["reason"]) == lies


def test_off_screen_display_is_locked_at_240_hz() -> None:
    command = [
        sys.executable,
        "-m",
        "studyapp",
        "display",
        "--display",
        "offscreen",
        "--size",
        "160x90",
        "--refreshes",
        "480",
        "--realtime",
        "--json",
    ]
    # A busy machine may steal the processor for longer than a refresh in every one of the tries.
    for _ in range(2):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
        certificate = json.loads(done.stdout)
        assert done.returncode == (0 if certificate["locked"] else 1), done.stderr
        assert certificate["stamp_class"] == "timer"
        # Phase-true even when refreshes are lost: late work never moves the grid.
        assert abs(certificate["measured_hz"] - 240) < 0.5
        if certificate["locked"]:
            break
    else:
        assert certificate["reason"].startswith(("lost", "outliers", "wandering")), certificate["reason"]
        pytest.skip(f"this machine is too busy to hold 240 Hz: {certificate['reason']}")


def test_off_screen_counts_the_refreshes_that_slow_work_costs() -> None:
    display = open_display("offscreen", (16, 16), 240)
    first = display.flip()
    until = display.now_ns() + 30_000_000
    while display.now_ns() < until:
        pass
    late = display.flip()
    display.close()
    assert late.missed >= 7
    assert late.index == late.missed + 1
    assert late.due_ns == first.due_ns + round(late.index * 1e9 / 240)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("crt",), "wanted glfw | offscreen | virtual"),
        (("virtual", (0, 5)), "1 to 16384"),
        (("virtual", (9, 9), 10), "20 to 1000 Hz"),
    ],
)
def test_bad_displays_are_named(arguments: tuple, said: str) -> None:
    with pytest.raises(InputError, match=said.replace("|", r"\|")):
        open_display(*arguments)


class _Mode:
    def __init__(self, width: int, height: int, rate: int) -> None:
        self.size, self.refresh_rate = type("S", (), {"width": width, "height": height})(), rate
        self.bits = type("B", (), {"red": 8})()


def test_missing_video_mode_names_those_that_would_serve() -> None:
    modes = [_Mode(1920, 1080, 60), _Mode(1920, 1080, 240), _Mode(2560, 1440, 144)]
    assert _pick_mode(modes, (1920, 1080), Fraction(240)).refresh_rate == 240
    with pytest.raises(InputError, match=r"got 1920x1080 at 120 Hz, wanted 1920x1080 at 240 Hz$"):
        _pick_mode(modes, (1920, 1080), Fraction(120))


def test_hardware_stamps_are_used_where_they_are_sane() -> None:
    display = open_display("virtual", (16, 16), 240)
    msc = iter(range(1, 100))
    oml = OmlStamp(lambda: (_now_us(), next(msc), 1))
    chosen, refused = probe([oml], display.flip)
    assert (chosen.stamp_class, refused) == ("hardware", [])


@pytest.mark.parametrize(
    "answer",
    [lambda: None, lambda: (0, 5, 5), lambda: (5, 5, 5), lambda: (_now_us() + 10**9, 5, 5), lambda: (_now_us(), 0, 5)],
)
def test_insane_hardware_stamps_fall_to_the_next_rung_and_it_is_said(answer: Callable) -> None:
    oml = OmlStamp(answer)
    display = open_display("offscreen", (16, 16), 240)
    chosen, refused = probe([oml, FenceStamp(display.context())], lambda: None)
    display.close()
    assert chosen.stamp_class == "software"
    assert len(refused) == 1
    assert refused[0].startswith("GLX_OML_sync_control: ")


def _now_us() -> int:
    from studyapp.clock import now_ns

    return now_ns() // 1000


PLAY = """
import json, sys
from fractions import Fraction
from studyapp.display.glfw_display import GlfwDisplay
from studyapp.present.presenter import KeptFlips, Presenter
from protocols.trial import Panel, Trial
from tests.studyapp.clips import NumberedClip
display = GlfwDisplay((320, 90), 240, keep_pixels=True)
rate = display.nominal_hz
seen, flip = [], display.flip
def watched():
    done = flip()
    picture = display.read_pixels()
    seen.append([picture[45, x].tolist() for x in (110, 210)])
    return done
display.flip = watched
sink = KeptFlips()
clips = {"left": NumberedClip(rate, 60, panel=1), "right": NumberedClip(rate / 4, 15, panel=2)}
trial = Trial(0, "b", "side_by_side", panels=(Panel("left", "c", "t"), Panel("right", "c", "t")), duration_s=60 / rate)
presenter = Presenter(display, sink, gap_px=60)
presenter.play(trial, clips, miss_policy=sys.argv[1])
presenter.close()
display.close()
print(json.dumps({"seen": seen, "sources": sink.rows()["source"].tolist()}))
"""


@pytest.mark.parametrize("policy", ["hold", "skip"])
@pytest.mark.parametrize("where", ["on_xvfb", "on_sway_240"])
def test_pixels_of_a_window_are_the_frames_in_the_record(
    where: str, policy: str, request: pytest.FixtureRequest
) -> None:
    done = request.getfixturevalue(where)(["-c", PLAY, policy])
    assert done.returncode == 0, done.stderr
    shown = json.loads(done.stdout)
    assert len(shown["seen"]) == len(shown["sources"]) > 10
    for pixels, sources in zip(shown["seen"][:-1], shown["sources"][:-1], strict=True):
        assert pixels == [[source, panel + 1, 255 - source] for panel, source in enumerate(sources[:2])]
    assert shown["seen"][-1] == [[119] * 3] * 2
    if policy == "hold":
        assert shown["sources"][:-1] == [[k, k // 4, -1, -1] for k in range(60)]
