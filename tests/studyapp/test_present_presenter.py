"""Trials and questions on the displays that need no window: what is recorded is what is on the screen."""

from __future__ import annotations

import gc
import sys
import time
from fractions import Fraction

import numpy as np
import pytest

from protocols.records import FLIP_OFFSET, FLIP_ONSET
from protocols.trial import Question
from stimuli.errors import InputError
from studyapp.display.choose import open_display
from studyapp.display.virtual_display import Fault, VirtualDisplay, random_faults
from studyapp.present.frame_loop import undisturbed
from studyapp.present.presenter import KeptFlips, Presenter
from tests.studyapp.clips import NumberedClip, ScriptedResponder, Watched, trial

CHOICE = Question("q", "Which?", "choice", ("left", "right"), keys={"a": "left", "b": "right"})


def stimulus(rows: np.ndarray) -> np.ndarray:
    """Rows from onset to before the offset."""
    onset, offset = np.flatnonzero(rows["flags"] & FLIP_ONSET)[0], np.flatnonzero(rows["flags"] & FLIP_OFFSET)[-1]
    return rows[onset:offset]


@pytest.mark.parametrize("policy", ["skip", "hold"])
def test_pixels_on_the_screen_are_the_frames_in_the_record(policy: str) -> None:
    display = Watched([(60, 30), (160, 30), (260, 30)])
    sink = KeptFlips()
    presenter = Presenter(display, sink, gap_px=60)
    clips = {
        "left": NumberedClip(120, 30, panel=1),
        "centre": NumberedClip(30, 8, panel=2),
        "right": NumberedClip(60, 15, panel=3),
    }
    shown = presenter.play(trial("left", "centre", "right"), clips, miss_policy=policy)
    rows = sink.rows()
    assert rows["flags"][0] & FLIP_ONSET
    assert rows["flags"][-1] & FLIP_OFFSET
    for row, pixels in zip(rows[:-1], display.seen, strict=False):
        for panel in range(3):
            frame = int(row["source"][panel])
            assert pixels[panel] == [frame, panel + 1, 255 - frame]
    assert display.seen[-1] == [[119] * 3] * 3
    assert rows["source"][-1].tolist() == [-1] * 4
    assert shown.onset_ns == rows["shown_ns"][0]
    assert shown.offset_ns == rows["shown_ns"][-1]
    assert shown.missed == rows["missed"][1:-1].sum()
    presenter.close()
    display.close()


def expected_sources(rows: np.ndarray, policy: str, held: int, count: int) -> list[int]:
    """The rule, one row after the other."""
    frames = []
    for place in range(len(rows)):
        step = place
        if policy == "skip":
            step = 0 if place == 0 else int(rows["refresh"][place - 1] - rows["refresh"][0]) + 1
        frames.append(min(step // held, count - 1))
    return frames


@pytest.mark.parametrize("policy", ["skip", "hold"])
@pytest.mark.parametrize("block", [True, False])
def test_ten_thousand_refreshes_with_faults_every_source_frame_is_right(policy: str, block: bool) -> None:
    rng = np.random.default_rng(5)
    display = VirtualDisplay(faults=random_faults(12_000, rng, miss=0.01, early=0.01, slip=0.003))
    sink = KeptFlips()
    clips = {"left": NumberedClip(240, 10_000), "right": NumberedClip(60, 2_500)}
    # A responder without `next_press_ns` that could end the trial makes the display go refresh by refresh.
    responder = None if block else Mute()
    keys = frozenset() if block else frozenset("x")
    shown = Presenter(display, sink).play(
        trial("left", "right", duration_s=10_000 / 240), clips, responder, miss_policy=policy, answer_keys=keys
    )
    rows = stimulus(sink.rows())
    assert rows["source"][:, 0].tolist() == expected_sources(rows, policy, 1, 10_000)
    assert rows["source"][:, 1].tolist() == expected_sources(rows, policy, 4, 2_500)
    if policy == "hold":
        assert len(rows) == 10_000
    else:
        assert shown.refreshes >= 10_000
        assert rows["refresh"][-2] - rows["refresh"][0] + 1 < 10_000
    assert shown.missed == rows["missed"][1:].sum() > 0


class Mute:
    name = "mute"

    def poll(self):
        return []

    def alive(self):
        return True


def test_blocks_and_single_refreshes_write_the_same_rows() -> None:
    kept = []
    for responder in (None, Mute()):
        display = VirtualDisplay(faults=random_faults(600, np.random.default_rng(1), miss=0.02, early=0.02))
        sink = KeptFlips()
        keys = frozenset() if responder is None else frozenset("x")
        Presenter(display, sink, patch="refresh").play(
            trial("left"), {"left": NumberedClip(240, 60)}, responder, answer_keys=keys, cross_s=0.05
        )
        kept.append(sink.rows())
    assert np.abs(kept[0]["due_ns"] - kept[1]["due_ns"]).max() <= 1  # the grid rounds on its way
    for name in ("refresh", "shown_ns", "missed", "flags", "source", "gaze_age_ns"):
        assert np.array_equal(kept[0][name], kept[1][name]), name


def test_answer_during_the_sequence_ends_it_only_after_the_minimum_viewing_time() -> None:
    display = VirtualDisplay()
    responder = ScriptedResponder(display)

    def on_onset(onset_ns: int) -> None:
        responder.after(0.1, "a")(onset_ns)
        responder.after(0.599, "b")(onset_ns)

    shown = Presenter(display, KeptFlips()).play(
        trial("left", duration_s=2.0), {"left": NumberedClip(240, 480)}, responder,
        answer_keys=frozenset("ab"), min_view_s=0.5, on_onset=on_onset,
    )  # fmt: skip
    assert [press.key for press in shown.presses] == ["a", "b"]
    assert shown.press is not None
    assert shown.press.key == "b"
    assert shown.refreshes == 145
    assert shown.offset_ns - shown.onset_ns == pytest.approx(0.6e9, abs=2e9 / 240)


def test_repeats_until_the_answer_and_counts_replays() -> None:
    display, sink = VirtualDisplay(), KeptFlips()
    responder = ScriptedResponder(display)
    shown = Presenter(display, sink).play(
        trial("left", duration_s=0.5), {"left": NumberedClip(240, 120)}, responder, answer_keys=None,
        repeat="until_answer", on_onset=responder.after(1.6, "a"),
    )  # fmt: skip
    assert shown.replays == 3
    frames = stimulus(sink.rows())["source"][:, 0]
    assert frames.tolist() == [k % 120 for k in range(len(frames))]


def test_two_intervals_have_two_onsets_and_a_gap_between_them() -> None:
    display, sink = VirtualDisplay(), KeptFlips()
    clips = {"first": NumberedClip(240, 24), "second": NumberedClip(240, 24)}
    shown = Presenter(display, sink).play(trial("first", "second", duration_s=0.1), clips, gap_s=0.5)
    first, second = shown.onsets_ns
    assert second - first == pytest.approx(0.6e9, abs=10)
    sources = sink.rows()["source"][:, :2].tolist()
    assert sources[:24] == [[k, -1] for k in range(24)]
    assert sources[24:144] == [[-1, -1]] * 120
    assert sources[144:168] == [[-1, k] for k in range(24)]
    assert shown.refreshes == 48


def test_question_takes_keys_that_mean_something() -> None:
    display = VirtualDisplay()
    responder = ScriptedResponder(display)

    def on_onset(onset_ns: int) -> None:
        responder.after(0.1, "z")(onset_ns)
        responder.after(0.3, "b")(onset_ns)

    answer = Presenter(display, KeptFlips()).ask(CHOICE, responder, on_onset=on_onset)
    assert answer.answer == "right"
    assert answer.press is not None
    assert answer.press.mapped_ns - answer.onset_ns == 300_000_000
    assert [press.key for press in answer.presses] == ["z", "b"]


def test_question_times_out_after_its_window() -> None:
    display = VirtualDisplay()
    answer = Presenter(display, KeptFlips()).ask(CHOICE, ScriptedResponder(display), window_s=2.0)
    assert (answer.answer, answer.timed_out) == (None, True)
    assert answer.end_ns - answer.onset_ns == pytest.approx(2e9, abs=1e9 / 240 + 10)


def test_replay_key_plays_again_and_is_counted_up_to_its_limit() -> None:
    display = VirtualDisplay()
    responder = ScriptedResponder(display)
    played = []

    def on_onset(onset_ns: int) -> None:
        responder.after(0.2, "r")(onset_ns)
        if len(played) == 2:
            responder.after(0.4, "a")(onset_ns)

    answer = Presenter(display, KeptFlips()).ask(
        CHOICE, responder, replay_key="r", replay=lambda: played.append(1), max_replays=2, on_onset=on_onset
    )
    assert (answer.answer, answer.replays, len(played)) == ("left", 2, 2)


def test_likert_without_keys_takes_the_numbers_themselves() -> None:
    display = VirtualDisplay()
    responder = ScriptedResponder(display)
    question = Question("free", "Free of artifacts", "likert", low=-3, high=3)
    answer = Presenter(display, KeptFlips()).ask(question, responder, on_onset=responder.after(0.2, "-2"))
    assert answer.answer == "-2"


def test_words_wait_for_a_key_and_feedback_for_none() -> None:
    display = VirtualDisplay()
    responder = ScriptedResponder(display)
    presenter = Presenter(display, KeptFlips())
    answer = presenter.show_words(
        "Welcome", responder, keys=frozenset(["space"]), on_onset=responder.after(1.0, "space")
    )
    assert answer.answer == "space"
    feedback = presenter.show_words("Right", responder, duration_s=0.5, on_onset=responder.after(0.1, "space"))
    assert feedback.end_ns - feedback.onset_ns == pytest.approx(0.5e9, abs=1e9 / 240 + 10)
    assert not feedback.timed_out
    with pytest.raises(ValueError, match="responder"):
        presenter.show_words("For ever")


def test_abort_key_ends_anything() -> None:
    display = VirtualDisplay()
    responder = ScriptedResponder(display)
    presenter = Presenter(display, KeptFlips(), abort_keys=frozenset(["escape"]))
    shown = presenter.play(
        trial("left"), {"left": NumberedClip(240, 60)}, responder, on_onset=responder.after(0.1, "escape")
    )
    assert shown.aborted
    assert shown.refreshes < 60
    answer = presenter.ask(CHOICE, responder, on_onset=responder.after(0.1, "escape"))
    assert answer.aborted
    assert answer.answer is None
    assert not answer.timed_out


@pytest.mark.parametrize("kind", ["virtual", "offscreen"])
def test_vanished_device_ends_the_trial(kind: str) -> None:
    display = open_display(kind, (64, 48), 240)
    responder = ScriptedResponder(display)
    responder.there = False
    shown = Presenter(display, KeptFlips()).play(
        trial("left", duration_s=1.0), {"left": NumberedClip(240, 240)}, responder, answer_keys=frozenset("a")
    )
    display.close()
    assert shown.device_lost
    assert shown.refreshes < 200


def test_open_screen_that_nobody_will_answer_is_an_error_on_the_virtual_display() -> None:
    display = VirtualDisplay()
    with pytest.raises(RuntimeError, match="no press is ever to come"):
        Presenter(display, KeptFlips()).ask(CHOICE, ScriptedResponder(display))


def test_failed_timing_is_told() -> None:
    display = VirtualDisplay(faults={20: Fault("miss", 2)})
    shown = Presenter(display, KeptFlips()).play(trial("left"), {"left": NumberedClip(240, 60)})
    assert shown.missed == 2
    assert not shown.timing_ok()
    assert shown.timing_ok(max_missed=2)


def test_bad_trials_are_refused_before_anything_is_shown() -> None:
    display, sink = VirtualDisplay(), KeptFlips()
    presenter = Presenter(display, sink)
    with pytest.raises(InputError, match="rate does not divide"):
        presenter.play(trial("left"), {"left": NumberedClip(90, 10)})
    with pytest.raises(InputError, match="none for right"):
        presenter.play(trial("left", "right"), {"left": NumberedClip(240, 10)})
    with pytest.raises(InputError, match="a refresh or more"):
        presenter.play(trial("left", duration_s=0.0), {"left": NumberedClip(240, 10)})
    with pytest.raises(InputError, match="do not fit"):
        presenter.play(trial("left"), {"left": NumberedClip(240, 10, size_px=(4000, 10))})
    with pytest.raises(InputError, match="1 to 4"):
        presenter.play(trial("a", "b", "c", "d", "e"), {slot: NumberedClip(240, 10) for slot in "abcde"})
    assert len(sink.rows()) == 0


def test_garbage_collection_is_off_while_frames_are_shown_and_back_on_after() -> None:
    interval = sys.getswitchinterval()
    with undisturbed():
        assert not gc.isenabled()
        assert sys.getswitchinterval() == pytest.approx(1e-4)
    assert gc.isenabled()
    assert sys.getswitchinterval() == pytest.approx(interval)


def test_fifteen_participants_of_96_trials_of_8_s_take_seconds_on_the_virtual_display() -> None:
    display = VirtualDisplay()

    class Count:
        rows = 0

        def put(self, row: np.ndarray) -> None:
            self.rows += len(row)

    sink, responder = Count(), ScriptedResponder(display)
    presenter = Presenter(display, sink)
    clips = {slot: NumberedClip(Fraction(240), 1920) for slot in ("left", "centre", "right")}
    planned = trial("left", "centre", "right", duration_s=8.0)
    started = time.process_time()
    for _ in range(1440):
        presenter.play(planned, clips, responder, cross_s=0.5)
        presenter.ask(CHOICE, responder, on_onset=responder.after(0.398, "a"))
    assert time.process_time() - started < 12  # 1 s on a quiet machine; the whole of `simulate` has 20 s
    assert sink.rows == 1440 * (120 + 1920 + 1 + 97)


def test_refreshes_that_go_by_between_trials_are_not_lost() -> None:
    display, sink = open_display("offscreen", (64, 48), 240), KeptFlips()
    presenter = Presenter(display, sink)
    presenter.play(trial("left", duration_s=0.05), {"left": NumberedClip(240, 12)})
    until = display.now_ns() + 50_000_000
    while display.now_ns() < until:
        pass
    begun = len(sink.rows())
    presenter.play(trial("left", duration_s=0.05), {"left": NumberedClip(240, 12)})
    presenter.close()
    display.close()
    rows = sink.rows()
    assert rows["missed"][begun] == 0
    assert rows["refresh"][begun] - rows["refresh"][begun - 1] >= 12
