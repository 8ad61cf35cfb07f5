"""Live mode: rendered with the newest gaze at every refresh, logged, and renderable again."""

from __future__ import annotations

from fractions import Fraction
from typing import ClassVar

import numpy as np
import pytest

from protocols.trial import Panel, Trial
from renderers.technique import Frame, View, ViewGeometry
from stimuli.encode import encode
from studyapp.display.choose import open_display
from studyapp.gaze.angles import ScreenGeometry
from studyapp.live_sources import place_of
from studyapp.present.live import LiveSource, LiveView, PanelPlace
from studyapp.present.presenter import KeptFlips, Presenter


class GazePicture:
    """A technique whose picture is its gaze and its index (the seam's double)."""

    name: ClassVar[str] = "gaze_picture"

    def __init__(self) -> None:
        self.views: list[View] = []
        self.resets: list[int] = []

    def reset(self, seed: int) -> None:
        self.resets.append(seed)

    def render(self, view: View) -> Frame:
        self.views.append(view)
        x = 0.0 if view.gaze is None else view.gaze[0]
        color = np.full((view.size_px[1], view.size_px[0], 3), x, np.float32)
        return Frame(color, {}, {}, float(view.index / view.rate_hz))


class MovingGaze:
    """A sample at every look, 5 ms old, one hundredth of a degree further; invalid when told."""

    name = "moving"

    def __init__(self, clock_ns) -> None:
        self._clock_ns, self.looks, self.blind = clock_ns, 0, frozenset()

    def newest(self):
        self.looks += 1
        return 0.01 * self.looks, -1.0, self._clock_ns() - 5_000_000, self.looks not in self.blind

    def alive(self) -> bool:
        return True


def view(**changes) -> LiveView:
    known = {
        "camera": None,
        "size_px": (32, 24),
        "rate_hz": Fraction(120),
        "frame_count": 30,
        "warm_up_s": Fraction(1, 30),
    }
    return LiveView(**{**known, **changes})


def test_warm_up_ends_where_the_clip_begins() -> None:
    technique = GazePicture()
    source = LiveSource(technique, view(start_s=Fraction(2), seed=9))  # type: ignore[arg-type]
    source.begin()
    assert technique.resets == [9]
    assert [v.index for v in technique.views] == [0, 1, 2, 3]
    assert [v.cut for v in technique.views] == [True, False, False, False]
    source.frame(0)
    last = technique.views[-1]
    assert (last.t1, last.rate_hz, last.cut) == (Fraction(2), Fraction(120), False)
    assert len(source.log()) == 1


def test_frame_asked_for_twice_is_rendered_once() -> None:
    technique = GazePicture()
    source = LiveSource(technique, view())  # type: ignore[arg-type]
    assert source.frame(3) is source.frame(3)
    assert len(technique.views) == 1


def test_every_refresh_has_the_newest_gaze_on_the_screen_and_in_the_log() -> None:
    display = open_display("offscreen", (64, 48), 120)
    gaze, technique = MovingGaze(display.now_ns), GazePicture()
    source = LiveSource(technique, view(), gaze)  # type: ignore[arg-type]
    source.begin()
    seen, flip = [], display.flip

    def watched():
        seen.append(int(display.read_pixels()[24, 32, 0]))
        return flip()

    display.flip = watched  # type: ignore[method-assign]
    sink = KeptFlips()
    presenter = Presenter(display, sink)
    trial = Trial(0, "b", "likert", panels=(Panel("centre", "c", "gaze_picture", live=True),), duration_s=0.25)
    shown = presenter.play(trial, {"centre": source}, miss_policy="hold", gaze=gaze)
    presenter.close()
    display.close()
    log = source.log()
    assert log["frame"].tolist() == list(range(30))
    assert (np.diff(log["x_deg"]) > 0).all()
    assert log["age_ns"].min() >= 5_000_000
    expected = [int(encode(np.full((1, 1, 3), x, np.float32))[0, 0, 0]) for x in log["x_deg"]]
    assert seen[:30] == expected
    ages = sink.rows()["gaze_age_ns"]
    assert (ages >= 5_000_000).all()
    assert shown.oldest_gaze_ns == ages[:30].max()


def test_through_a_blink_the_last_gaze_holds() -> None:
    gaze = MovingGaze(lambda: 10**9)
    gaze.blind = frozenset([2, 3])
    source = LiveSource(GazePicture(), view(), gaze, lambda: 10**9)  # type: ignore[arg-type]
    for index in range(4):
        source.frame(index)
    assert source.log()["x_deg"].tolist() == [0.01, 0.01, 0.01, 0.04]


def test_no_gaze_yet_is_none() -> None:
    gaze = MovingGaze(lambda: 10**9)
    gaze.blind = frozenset([1])
    technique = GazePicture()
    source = LiveSource(technique, view(), gaze)  # type: ignore[arg-type]
    source.frame(0)
    assert technique.views[0].gaze is None
    assert source.log()["gaze_ns"].tolist() == [-1]


class Camera:
    yfov_rad = 2 * np.arctan(0.5)


def test_gaze_is_seen_from_the_panels_centre() -> None:
    geometry = ViewGeometry(0.2, 0.1, 0.6)
    gaze = MovingGaze(lambda: 10**9)
    place = PanelPlace(0.1, 0.0, 0.1, 0.6)
    seen = view(camera=Camera(), geometry=geometry, place=place)
    source = LiveSource(GazePicture(), seen, gaze)  # type: ignore[arg-type]
    source.frame(0)
    row = source.log()[0]
    # The eye looks almost straight ahead; the panel's centre is atan(0.1 / 0.6) to the right.
    assert row["x_deg"] == pytest.approx(-np.degrees(np.arctan((0.1 - 0.6 * np.tan(np.radians(0.01))) / 0.6)))
    up_m = -0.6 * np.tan(np.radians(1)) / np.cos(np.radians(0.01))
    assert row["y_deg"] == pytest.approx(np.degrees(np.arctan2(up_m, np.hypot(0.6, 0.1))), rel=1e-3)


def test_the_pixel_that_is_looked_at_is_the_one_in_the_picture() -> None:
    trial = Trial(
        0, "b", "forced_choice", panels=tuple(Panel(slot, "c", "t") for slot in ("left", "right")),
        settings={"size_px": [100, 60], "gap_px": 20, "mirror": "pictures"},
    )  # fmt: skip
    screen = ScreenGeometry(0.5, 0.25, 0.6, (400, 200))
    looked = screen.to_dva((90 + 70) / 400, (70 + 45) / 200)  # pixel 70, 45 of the left panel, as it stands
    left = place_of(trial, "left", screen)
    assert left.flipped
    x, y = left.seen(float(looked[0]), float(looked[1]), ViewGeometry(0.125, 0.075, 0.6), 0.0)
    # Flipped, the eye meets the picture's own pixel 30: 20 px left of its centre; 15 px below it.
    assert x == pytest.approx(np.degrees(np.arctan2(-20 * 0.00125, 0.6)))
    assert y == pytest.approx(np.degrees(np.arctan2(-15 * 0.00125, np.hypot(0.6, 20 * 0.00125))))
    # Without a geometry the picture's 60 px are the camera's own field: half of it is atan(0.5).
    x, y = left.seen(float(looked[0]), float(looked[1]), None, Camera.yfov_rad)
    assert x == pytest.approx(np.degrees(np.arctan(-20 / 30 * 0.5)))
    right = place_of(trial, "right", screen)
    assert right.right_m == -left.right_m == pytest.approx(60 * 0.00125)
