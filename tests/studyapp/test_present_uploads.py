"""What goes up to the display: ahead of its refresh, as the layout says, and no more than it takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from protocols.records import FLIP_LIGHT_PATCH
from protocols.trial import Trial
from renderers.technique import ViewGeometry
from stimuli.errors import InputError
from studyapp.display.choose import open_display
from studyapp.display.virtual_display import VirtualDisplay
from studyapp.gaze.angles import ScreenGeometry
from studyapp.present import uploader
from studyapp.present.admission import UploadBudget, admit, measure_upload
from studyapp.present.presenter import KeptFlips, Presenter
from studyapp.trial import Person, Rules, TrialRunner
from tests.studyapp.clips import NumberedClip, Watched, trial


def test_upload_goes_ahead_each_frame_is_asked_for_once() -> None:
    display = open_display("offscreen", (64, 48), 60)
    clip = NumberedClip(30, 15)
    asked: list[int] = []
    presenter = Presenter(display, KeptFlips())
    clip.asked = asked
    presenter.play(trial("left", duration_s=0.5), {"left": clip}, miss_policy="hold")
    presenter.close()
    display.close()
    touched, played = asked[:15], asked[15:]
    assert touched == list(range(15))
    # After the last frame the first one goes up, in case the sequence begins anew.
    assert played == [*range(15), 0]


def test_mirrored_picture_is_flipped_on_the_screen() -> None:
    class Halves(NumberedClip):
        def frame(self, index: int) -> np.ndarray:
            picture = np.full((24, 32, 4), 255, np.uint8)
            picture[:, :16, :3] = 0
            return picture

    display = Watched([(162 - 32, 30), (158, 30), (162, 30), (188, 30)])
    presenter = Presenter(display, KeptFlips(), mirror="pictures")
    presenter.play(trial("left", "right"), {"left": Halves(120, 30), "right": Halves(120, 30)})
    presenter.close()
    display.close()
    assert [pixel[0] for pixel in display.seen[0]] == [255, 0, 0, 255]


def test_admission_by_memory_disk_and_upload() -> None:
    clip = NumberedClip(240, 1000, size_px=(100, 100))  # 40 MB, 9.6 MB/s
    admitted = admit({"left": clip, "right": clip}, available_bytes=60_000_000)
    assert (admitted.resident_bytes, admitted.from_disk) == (40_000_000, False)
    assert admitted.upload_bytes_s == 2 * 9.6e6
    with pytest.raises(InputError, match="playback memory"):
        admit({"left": clip}, available_bytes=49_000_000)
    with pytest.raises(InputError, match="disk of 19 MB/s"):
        admit({"left": clip}, disk_bytes_s=19.1e6, available_bytes=49_000_000)
    assert admit({"left": clip}, disk_bytes_s=19.3e6, available_bytes=49_000_000).from_disk
    with pytest.raises(InputError, match=r"upload: got 10 MB/s, wanted at most 9 MB/s"):
        admit({"left": clip}, upload_limit_bytes_s=9e6, available_bytes=10**9)


def test_intervals_that_follow_one_another_are_not_uploaded_together() -> None:
    clip = NumberedClip(240, 10, size_px=(100, 100))
    assert admit({"first": clip, "second": clip}, available_bytes=10**9).upload_bytes_s == 9.6e6


def planned(*slots: str, size_px: tuple[int, int], **settings: object) -> Trial:
    return replace(trial(*slots), settings={"size_px": list(size_px), **settings})


def test_upload_budget_is_measured_on_the_display_for_the_heaviest_trial() -> None:
    display = open_display("offscreen", (640, 200), 240)
    trials = [planned("left", "right", size_px=(64, 48)), planned("left", "right", size_px=(256, 128)), trial("left")]
    budget = measure_upload(display, [replace(trials[2], panels=()), *trials[:2]], rounds=20)
    display.close()
    assert budget is not None
    assert (budget.size_px, budget.panels) == ((256, 128), 2)
    assert budget.needed_bytes_s == 2 * 256 * 128 * 4 * 240
    assert budget.limit_bytes_s == budget.measured_bytes_s / 2
    assert budget.measured_bytes_s > 0
    assert measure_upload(VirtualDisplay(), trials[:2]) is None
    tight = UploadBudget(10e6, 6e6, (256, 128), 2, 20)
    assert tight.problems() == [
        "admission: upload: got 6 MB/s, wanted at most 5 MB/s (measured here, 50% of each refresh)"
    ]
    assert UploadBudget(12e6, 6e6, (256, 128), 2, 20).problems() == []


def test_a_trial_is_laid_out_as_its_settings_say() -> None:
    class Halves(NumberedClip):
        def frame(self, index: int) -> np.ndarray:
            picture = np.full((24, 32, 4), 255, np.uint8)
            picture[:, :16, :3] = 0
            return picture

    class Nobody:
        name = "nobody"

        def expect(self, question: object) -> None: ...

        def poll(self) -> list:
            return []

        def alive(self) -> bool:
            return True

    seen = {}
    for mirror in ("none", "pictures"):
        display = Watched([(162 - 32, 30), (158, 30), (162, 30), (188, 30)])
        runner = TrialRunner(Presenter(display, KeptFlips()), Nobody(), Person("nobody"), Rules())
        shown = planned("left", "right", size_px=(32, 24), gap_px=0, mirror=mirror)
        runner.run(shown, {"left": Halves(120, 30), "right": Halves(120, 30)}, 0, 0)
        runner.presenter.close()
        display.close()
        seen[mirror] = [pixel[0] for pixel in display.seen[0]]
    assert seen == {"none": [0, 255, 0, 255], "pictures": [255, 0, 0, 255]}


def test_pixel_buffers_of_a_gpu_bring_the_same_pixels(monkeypatch) -> None:
    monkeypatch.setattr(uploader, "is_software", lambda gl: False)
    display, sink = Watched([(160, 30)]), KeptFlips()
    presenter = Presenter(display, sink)
    presenter.play(trial("left", duration_s=0.2), {"left": NumberedClip(120, 24, panel=7)}, miss_policy="hold")
    presenter.close()
    display.close()
    assert [pixel[0] for pixel in display.seen[:24]] == [[k, 7, 255 - k] for k in range(24)]
    assert sink.rows()["source"][:24, 0].tolist() == list(range(24))


class StillGaze:
    name = "still"

    def __init__(self, at: tuple[float, float], valid: bool = True) -> None:
        self._at, self._valid = at, valid

    def newest(self) -> tuple[float, float, int, bool]:
        return *self._at, 0, self._valid

    def alive(self) -> bool:
        return True


@pytest.mark.parametrize(("show", "valid", "marked"), [(True, True, True), (True, False, False), (False, True, False)])
def test_gaze_is_marked_for_the_participant_only_where_the_protocol_says_so(
    show: bool, valid: bool, marked: bool
) -> None:
    display = Watched([(240, 15), (160, 30), (239, 15)])
    geometry = ViewGeometry(0.32, 0.06, 0.6)
    screen = ScreenGeometry(0.32, 0.06, 0.6, (320, 60))
    at = tuple(float(angle) for angle in screen.to_dva(240.5 / 320, 15.5 / 60))
    presenter = Presenter(display, KeptFlips(), geometry=geometry, show_gaze=show)
    presenter.play(trial("left"), {"left": NumberedClip(120, 30)}, gaze=StillGaze(at, valid))
    presenter.close()
    display.close()
    ink, ground = presenter.style.ink, presenter.style.background
    assert display.seen[3][0] == ([ink] * 3 if marked else [ground] * 3)
    assert display.seen[3][1] == [3, 0, 252]


def test_light_patch_toggles_in_the_record_and_on_the_screen() -> None:
    display = Watched([(2, 57)])
    sink = KeptFlips()
    presenter = Presenter(display, sink, patch="refresh")
    presenter.play(trial("left"), {"left": NumberedClip(120, 30)})
    rows = sink.rows()
    lit = (rows["flags"] & FLIP_LIGHT_PATCH) > 0
    assert lit[:4].tolist() == [True, False, True, False]
    assert not lit[-1]
    assert [pixels[0][0] == 255 for pixels in display.seen] == lit.tolist()
    presenter.close()
    display.close()
