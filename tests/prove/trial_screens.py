"""A screenshot of every screen of every trial type at 1280x720 and 3840x2160, and the size of its smallest letters.

Shown through the session's own trial runner on the off-screen display; ``evidence/screens`` is for looking at. What can
be checked by itself is: every screen has its letters at 0.3 degrees or more at the protocol's distance, and no ink at
the display's edge.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from protocols.trial import Panel, Question, Trial
from studyapp.display.choose import open_display
from studyapp.present import overlay, presenter
from studyapp.present.overlay import SMALLEST_X_HEIGHT_DEG, Style, Words, size_deg, style_on
from studyapp.present.presenter import DESK, KeptFlips, Presenter
from studyapp.seams import Display, Flip, Press
from studyapp.trial import Person, Rules, TrialRunner
from tests.evidence import evidence_folder, write_evidence

SIZES = ((1280, 720), (3840, 2160))
PANEL = {1280: (400, 400), 3840: (1200, 1200)}
CHOICE = Question(
    "closer", "Which side is closer to the picture in the middle?", "choice", ("left", "right"),
    keys={"left": "left", "right": "right"},
)  # fmt: skip
WHICH = Question("which", "Which one was better?", "choice", ("first", "second"), keys={"1": "first", "2": "second"})
FOUR = Question(
    "best", "Which of the four is best?", "choice", ("a", "b", "c", "d"),
    keys={str(n + 1): slot for n, slot in enumerate("abcd")},
)  # fmt: skip
LIKERT = Question(
    "free", "The sequence was free of artifacts (flicker, noise, blur, jagged edges).", "likert",
    labels={"-3": "strongly disagree", "0": "neither agree nor disagree", "3": "strongly agree"},
    keys={str(place + 1): str(value) for place, value in enumerate(range(-3, 4))},
)  # fmt: skip
CONSENT = (
    "You take part in a study of how moving pictures look. It takes about 40 minutes, with breaks. Nothing is stored "
    "that tells who you are; you may stop at any time by pressing escape, without giving reasons.\n\n"
    "Press any key if you agree."
)
INSTRUCTIONS = (
    "In each trial you will see three moving pictures. The one in the middle is the reference.\n\n"
    "Say which of the others is closer to it. There is no hurry.\n\nPress the space bar to begin."
)


class Picture:
    """A clip of two frames with edges and a ramp: what is flipped or cut can be seen."""

    rate_hz = Fraction(60)
    frame_count = 2

    def __init__(self, size_px: tuple[int, int], hue: int) -> None:
        self.size_px = size_px
        across, down = np.meshgrid(np.linspace(0, 255, size_px[0]), np.linspace(0, 255, size_px[1]))
        frame = np.full((size_px[1], size_px[0], 4), 255, np.uint8)
        frame[..., hue], frame[..., (hue + 1) % 3], frame[..., (hue + 2) % 3] = across, down, 40
        side = size_px[0] // 8
        frame[:side, :side, :3] = 255  # a white square in the upper left corner
        self._frame = frame

    def frame(self, index: int) -> np.ndarray:
        return self._frame


class Screens:
    """A display that keeps one picture of each thing it shows."""

    def __init__(self, display: Display) -> None:
        self._display = display
        self.pictures: dict[str, np.ndarray] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._display, name)

    def flip(self) -> Flip:
        picture = self._display.read_pixels()
        self.pictures.setdefault(hashlib.sha256(picture.tobytes()).hexdigest(), picture)
        return self._display.flip()


class FirstKey:
    """Answers whatever is asked with its first key, at once."""

    name = "first key"

    def __init__(self, display: Screens) -> None:
        self._display, self._key = display, "space"

    def expect(self, question: Question | None) -> None:
        self._key = "space" if question is None else next(iter(question.keys))

    def poll(self) -> list[Press]:
        at = self._display.now_ns()
        return [Press(self._key, at, at, self.name)]

    def alive(self) -> bool:
        return True


def trials(panel_px: tuple[int, int]) -> dict[str, Trial]:
    """One trial of each type."""

    def shown(kind: str, slots: str, *questions: Question, fixation: str = "free", **settings: object) -> Trial:
        width, height = panel_px
        small = (width * 3 // 4, height * 3 // 4) if len(slots.split()) == 4 else panel_px
        known = {"size_px": list(small), "gap_px": width // 50, "iti_s": 0.02, "interval_gap_s": 0.02, **settings}
        panels = tuple(Panel(slot, "c", "t", rate_hz="60") for slot in slots.split())
        return Trial(0, "b", kind, panels=panels, questions=questions, duration_s=0.05, fixation=fixation,
                     settings=known, correct="left" if "feedback" in settings else None)  # type: ignore[arg-type]  # fmt: skip

    return {
        "side_by_side": shown("side_by_side", "left centre right", CHOICE),
        "side_by_side_mirrored": shown("side_by_side", "left centre right", CHOICE, mirror="pictures"),
        "forced_choice_fixated_feedback": shown("forced_choice", "left right", CHOICE, fixation="fixed", feedback=True),
        "forced_choice_of_four": shown("forced_choice", "a b c d", FOUR),
        "two_interval": shown("two_interval", "first second", WHICH, fixation="fixed"),
        "likert": shown("likert", "centre", LIKERT),
        "instructions": Trial(0, "b", "instructions", text=INSTRUCTIONS),
        "consent": Trial(0, "b", "consent", text=CONSENT),
        "break": Trial(0, "b", "break", text="Take a break.\n\nPress any key to go on."),
    }


def screens(size_px: tuple[int, int], folder: Path, style: Style) -> dict[str, Any]:
    """Show one of each and keep the pictures; trial type -> screens, smallest letters (degrees), edges without ink."""
    told: list[Words] = []

    def noted(paint: Any) -> Any:
        def painted(*arguments: Any) -> Words:
            words: Words = paint(*arguments)
            told.append(words)
            return words

        return painted

    presenter.paint_words, presenter.paint_question = noted(overlay.paint_words), noted(overlay.paint_question)
    found = {}
    for name, trial in trials(PANEL[size_px[0]]).items():
        display = Screens(open_display("offscreen", size_px, 60))
        told.clear()
        one = Presenter(display, KeptFlips(), geometry=DESK, style=style)
        runner = TrialRunner(one, FirstKey(display), Person("nobody"), Rules(max_missed=10**6))
        sources: Mapping[str, Picture] = {
            panel.slot: Picture(tuple(trial.settings["size_px"]), n % 3) for n, panel in enumerate(trial.panels)
        }
        runner.run(trial, sources, 0, 0)
        edges_clear = True
        for number, picture in enumerate(display.pictures.values()):
            Image.fromarray(picture).save(folder / f"{size_px[0]}x{size_px[1]}_{name}_{number}.png")
            border = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
            edges_clear &= bool((border == style.background).all())
        letters = [size_deg(words.x_height_px, size_px, DESK) for words in told]
        found[name] = {"screens": len(display.pictures), "letters_deg": min(letters), "edges_clear": edges_clear}
        one.close()
        display.close()
    return found


if __name__ == "__main__":
    into = evidence_folder() / "screens"
    into.mkdir(exist_ok=True)
    summary = {f"{w}x{h}": screens((w, h), into, style_on(119)) for w, h in SIZES}
    write_evidence("trial_screens", summary)
    every = [one for by_type in summary.values() for one in by_type.values()]
    smallest = min(one["letters_deg"] for one in every)
    print(f"{sum(one['screens'] for one in every)} screens, smallest letters {smallest:.3f} degrees")
    sys.exit(smallest < SMALLEST_X_HEIGHT_DEG or not all(one["edges_clear"] for one in every))
