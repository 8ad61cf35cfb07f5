"""What a picture-driven observer is told: the metric of the frames that were shown, missed refreshes included."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from protocols.design import plan
from protocols.records import FLIP_DTYPE
from protocols.requests import clip_requests
from protocols.study import Study
from stimuli.errors import InputError
from studyapp.devices.simulated import DirectPresses
from studyapp.display.virtual_display import Fault, VirtualDisplay
from studyapp.picture_errors import PictureErrors, ShownFrames, held_frames, judged
from studyapp.present.presenter import KeptFlips, Presenter
from studyapp.simulated_respondent import SimulatedRespondent
from studyapp.trial import Rules, TrialRunner
from tests.protocols.tiny import tiny

RATE = Fraction(240)


class Ramp:
    """A clip whose frame i has the code 2 i + ``offset`` everywhere."""

    size_px = (8, 6)

    def __init__(self, rate_hz: str, offset: int) -> None:
        self.rate_hz, self.frame_count, self._offset = Fraction(rate_hz), round(Fraction(rate_hz) / 10), offset

    def frame(self, index: int) -> np.ndarray:
        return np.full((6, 8, 4), 2 * index + self._offset, np.uint8)


def study() -> Study:
    return tiny(
        defaults={"duration_s": 0.1, "iti_s": 0},
        observer={"pictures": {"metric": "rmse", "logits_per_unit": 50}, "sd": {"condition": 0}, "side_bias_sd": 0},
    )


def table(offsets: dict[str, int], metric: str = "rmse") -> PictureErrors:
    made = study()
    requests = clip_requests(made, {"a": "0" * 64, "b": "1" * 64}, {"a": 1.0, "b": 1.0})
    by_identity = {
        request.identity: Ramp(spec.rate_hz, offsets.get(spec.technique, 0)) for spec, request in requests.items()
    }
    return PictureErrors(made, requests, by_identity.__getitem__, metric)  # type: ignore[arg-type]


def first_pair(condition: str):
    return next(t for t in plan(study(), 1) if t.panels and any(p.condition == condition for p in t.panels[::2]))


def test_a_lost_refresh_holds_the_frame_before() -> None:
    assert held_frames(np.array([5, 6, 9, 10]), np.array([0, 1, 2, 3])).tolist() == [0, 1, 1, 1, 2, 3]
    assert held_frames(np.array([7]), np.array([4])).tolist() == [4]


def test_the_error_is_that_of_the_frames_shown() -> None:
    trial = first_pair("dense")
    errors = table({"temporally_dense": 10})
    planned = errors.planned(trial)
    slot = next(p.slot for p in trial.panels if p.condition == "dense")
    assert errors.errors(trial, planned)[slot] == pytest.approx(10 / 255)
    # One refresh late from the first on: each frame is two codes behind, and ten codes off.
    late = {**planned, slot: np.maximum(planned[slot] - 1, 0)}
    wanted = np.sqrt(np.mean(np.r_[10.0, np.full(23, 8.0)] ** 2)) / 255
    assert errors.errors(trial, late)[slot] == pytest.approx(wanted)
    assert "centre" not in errors.errors(trial, planned)


def test_half_the_rate_is_an_error_of_its_own() -> None:
    trial = first_pair("half")
    errors = table({})
    slot = next(p.slot for p in trial.panels if p.condition == "half")
    shown = errors.planned(trial)
    assert shown[slot].tolist() == [k // 2 for k in range(24)]
    # Frame i of the ramp at 120 Hz has the code 2 i; the reference has 2 k at refresh k.
    wanted = np.sqrt(np.mean([(2 * (k // 2) - 2 * k) ** 2 for k in range(24)])) / 255
    assert errors.errors(trial, shown)[slot] == pytest.approx(wanted)


@pytest.mark.parametrize("metric", ["rmse", "flip", "flicker"])
def test_the_reference_itself_has_no_error(metric: str) -> None:
    trial = first_pair("full")
    slot = next(p.slot for p in trial.panels if p.condition == "full")
    errors = table({}, metric)
    assert errors.errors(trial, errors.planned(trial))[slot] == pytest.approx(0.0, abs=1e-6)


def test_the_presenters_own_rows_say_what_was_shown() -> None:
    trial, errors = first_pair("dense"), table({"temporally_dense": 10})
    told: list[dict[str, float]] = []

    def shown_with(faults: dict[int, Fault]) -> dict[str, np.ndarray]:
        display = VirtualDisplay((1920, 1080), RATE, faults)
        seen = ShownFrames(KeptFlips())
        presses = DirectPresses(display.now_ns)

        def judge(asked) -> dict[str, float]:
            told.append(errors.errors(asked, seen.shown(asked)))
            return told[-1]

        person = SimulatedRespondent(study(), 1, 0, presses.press, errors=judge)
        sources = {panel.slot: Ramp(panel.rate_hz, 0) for panel in trial.panels}
        runner = TrialRunner(Presenter(display, seen), presses, person, Rules("hold", 100))
        seen.begin()
        done = runner.run(trial, sources, 0, 0)
        assert len(done.responses) == 1
        return seen.shown(trial)

    whole = shown_with({})
    assert {slot: frames.tolist() for slot, frames in whole.items()} == {
        slot: frames.tolist() for slot, frames in errors.planned(trial).items()
    }
    faulty = shown_with({place: Fault("miss", 3) for place in (5, 10, 15)})
    slot = next(p.slot for p in trial.panels if p.condition == "dense")
    assert len(faulty[slot]) == 24 + 9
    assert told[1][slot] != told[0][slot]


def test_nothing_shown_is_nothing_remembered() -> None:
    kept = KeptFlips()
    seen = ShownFrames(kept)
    rows = np.zeros(3, FLIP_DTYPE)
    rows["source"] = -1
    seen.put(rows)
    assert seen.shown(first_pair("full")) == {}
    assert len(kept.rows()) == 3


def test_what_cannot_be_judged_is_said() -> None:
    with pytest.raises(InputError, match="observer: pictures: got nothing"):
        judged(tiny(), ())
    made = study()
    live = tiny(**{**{"observer": made.observer.model_dump(mode="json")}, "defaults": {"live": True}})
    with pytest.raises(InputError, match="a live panel"):
        judged(live, plan(live, 1))
    during = tiny(observer=made.observer.model_dump(mode="json"), defaults={"response": "during"})
    with pytest.raises(InputError, match="response: got during"):
        judged(during, plan(during, 1))
