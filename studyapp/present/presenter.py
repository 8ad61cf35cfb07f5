"""The presenter: shows trials, questions and words on a display, and says what was really shown.

Every kind of trial is a chain of phases (`studyapp.present.frame_loop`): cross, panels, gap, panels, blank.
Times are nanoseconds of the display's clock, which is the session clock except on the virtual display.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Literal

import moderngl
import numpy as np

from protocols.conditions import Mirror
from protocols.records import FLIP_OFFSET, FLIP_ONSET, MAX_PANELS
from protocols.trial import Question, Trial
from renderers.technique import ViewGeometry
from stimuli.errors import InputError, problem
from studyapp.gaze.angles import ScreenGeometry
from studyapp.present.admission import admit, touch
from studyapp.present.frame_loop import MissPolicy, PanelPlay, Phase, PhaseShown, Stage, show_phase, undisturbed
from studyapp.present.layout import IN_SEQUENCE, PanelRect, place_panels
from studyapp.present.overlay import Style, Words, paint_cross, paint_question, paint_words, pixels_per_degree
from studyapp.present.playlist import check_rate, refresh_count
from studyapp.present.shown import Answer, KeptFlips, TrialShown, answer_of, key_meanings, trial_of
from studyapp.present.uploader import GazeMark, PanelTexture, Quads, Sprite
from studyapp.seams import Display, FlipSink, FrameSource, GazeSource, Responder

__all__ = ["DESK", "Answer", "KeptFlips", "OnOnset", "Presenter", "TrialShown"]

DESK = ViewGeometry(width_m=0.5313, height_m=0.2989, distance_m=0.6)
"""A 24-inch 16:9 screen at 60 cm: used where neither protocol nor lab file says."""
GAZE_MARK_DEG = 0.2
OnOnset = Callable[[int], None]


@dataclass
class Presenter:
    """See the module. ``geometry``: the display as seen by the observer (letters have their size in degrees);
    ``patch``: light patch for a photodiode, 'refresh' toggles at every refresh of a stimulus, 'onset' is lit while the
    stimulus is up; ``show_gaze``: a mark where the eye looks; ``abort_keys`` end anything at once. On the virtual
    display nothing is painted or uploaded."""

    display: Display
    sink: FlipSink
    geometry: ViewGeometry = DESK
    style: Style = field(default_factory=Style)
    gap_px: int = 0
    mirror: Mirror = "none"
    patch: Literal["off", "refresh", "onset"] = "off"
    abort_keys: frozenset[str] = frozenset()
    disk_bytes_s: float | None = None
    upload_limit_bytes_s: float | None = None
    show_gaze: bool = False

    def __post_init__(self) -> None:
        context = self.display.context()
        self._gl: moderngl.Context | None = context if isinstance(context, moderngl.Context) else None
        self._quads = None if self._gl is None else Quads(self._gl, self.display.size_px)
        self._cross: Sprite | None = None
        self._words: dict[object, Sprite] = {}
        lit = dark = None
        if self._gl is not None and self._quads is not None and self.patch != "off":
            rect = self._patch_rect()
            lit, dark = (self._still(rect, _flat(rect, code)) for code in (255, 0))
        mark = None
        if self._gl is not None and self.show_gaze:
            screen = ScreenGeometry(
                self.geometry.width_m, self.geometry.height_m, self.geometry.distance_m, self.display.size_px
            )
            mark = GazeMark(self._gl, screen, max(3, self._size_px(GAZE_MARK_DEG)), self.style.ink)
        self.stage = Stage(self.display, self.sink, self._gl, self.style.background / 255, lit, dark, mark)

    # -- what a session calls -------------------------------------------------------------------------------------

    def play(
        self,
        trial: Trial,
        sources: Mapping[str, FrameSource],
        responder: Responder | None = None,
        *,
        miss_policy: MissPolicy = "skip",
        answer_keys: frozenset[str] | None = frozenset(),
        min_view_s: float = 0.0,
        window_s: float | None = None,
        repeat: Literal["once", "until_answer"] = "once",
        cross_s: float = 0.0,
        gap_s: float = 0.5,
        caption: str = "",
        gaze: GazeSource | None = None,
        on_onset: OnOnset | None = None,
        modes_hz: Sequence[Fraction] = (),
    ) -> TrialShown:
        """Show the pictures of ``trial``; ``sources`` maps each panel's slot to its frames.

        ``answer_keys``: a press of one of these at or after ``min_view_s`` ends the showing (empty: presses are kept,
        and end nothing; None: any key does). ``repeat='until_answer'``: the sequence begins anew until an answer
        comes or ``window_s`` is over. ``cross_s``: fixation cross beforehand; ``gap_s``: between the two intervals.
        ``on_onset`` is called with the stamp right after the first refresh of each interval. Column p of the rows'
        ``source`` is ``trial.panels[p]``. Raises InputError before anything is shown where clips, rates or layout
        cannot be played (admission).
        """
        self._check(trial, sources, modes_hz)
        refreshes = refresh_count(trial.duration_s, self.display.nominal_hz)
        if refreshes < 1:
            raise InputError(
                problem(f"trial {trial.index}", "duration", f"{trial.duration_s:g} s", "a refresh or more")
            )
        slots = [panel.slot for panel in trial.panels]
        in_sequence = len(slots) == 2 and all(slot in IN_SEQUENCE for slot in slots)
        with self._panels(slots, sources) as plays:
            over = self._over(trial.fixation == "fixed", caption)
            shows = [[play] for play in plays] if in_sequence else [plays]
            base = Phase(refreshes, abort_keys=self.abort_keys, patch=self._patch_mode(), sprites=over)
            if repeat == "until_answer":
                limit = None if window_s is None else refresh_count(window_s, self.display.nominal_hz)
                base = replace(base, refreshes=limit, loop_refreshes=refreshes)
            base = replace(base, marks=FLIP_ONSET, on_onset=on_onset, min_view_ns=round(min_view_s * 1e9))
            done: list[PhaseShown] = []
            with self._undisturbed():
                if cross_s > 0:
                    self._blank(refresh_count(cross_s, self.display.nominal_hz), responder, gaze, cross=True)
                for place, panels in enumerate(shows):
                    if place:
                        gap = max(1, refresh_count(gap_s, self.display.nominal_hz))
                        self._blank(gap, responder, gaze, cross=True, marks=FLIP_OFFSET, continues=True)
                    last = place == len(shows) - 1
                    ends = answer_keys if last else frozenset()
                    phase = replace(base, panels=panels, end_keys=ends, continues=place > 0 or cross_s > 0)
                    done.append(show_phase(self.stage, phase, responder, gaze, miss_policy))
                    if done[-1].aborted or done[-1].device_lost:
                        break
                blank = self._blank(1, responder, gaze, cross=False, marks=FLIP_OFFSET, continues=True)
        return trial_of(done, blank, refreshes if repeat == "until_answer" else None)

    def ask(
        self,
        question: Question,
        responder: Responder,
        *,
        min_view_s: float | None = None,
        window_s: float | None = None,
        replay_key: str | None = None,
        replay: Callable[[], object] | None = None,
        max_replays: int = 1,
        gaze: GazeSource | None = None,
        on_onset: OnOnset | None = None,
    ) -> Answer:
        """Show a question until a key that means something is pressed, or its response window is over.

        ``question.keys`` maps key names to answers (empty: the key's own name is the answer, and 'confirm' takes any
        key). A press of ``replay_key`` calls ``replay`` (which plays the trial again) and asks anew, at most
        ``max_replays`` times; ``Answer.replays`` counts them.
        """
        keys = key_meanings(question)
        view_s = question.min_view_s if min_view_s is None else min_view_s
        window = question.window_s if window_s is None else window_s
        replays, presses = 0, []
        while True:
            again = replay_key is not None and replay is not None and replays < max_replays
            ends = (
                None if keys is None else frozenset(keys) | (frozenset([replay_key]) if again and replay_key else set())
            )
            words = self._sprite(question, lambda: paint_question(question, *self._where()))
            shown = self._screen(words, responder, ends, view_s, window, gaze, on_onset)
            presses += shown.presses
            if again and replay is not None and shown.press is not None and shown.press.key == replay_key:
                replays += 1
                replay()
                continue
            return answer_of(shown, keys, replays, presses)

    def show_words(
        self,
        text: str,
        responder: Responder | None = None,
        *,
        keys: frozenset[str] | None = None,
        min_view_s: float = 0.0,
        window_s: float | None = None,
        duration_s: float | None = None,
        gaze: GazeSource | None = None,
        on_onset: OnOnset | None = None,
    ) -> Answer:
        """Instructions, consent, breaks, feedback: words until a key of ``keys`` (None: any) is pressed.

        ``min_view_s``: earlier presses do not count; ``window_s``: the longest wait (then ``timed_out``);
        ``duration_s``: exactly so long, whatever is pressed (feedback).
        """
        words = self._sprite(text, lambda: paint_words(text, *self._where()))
        ends = frozenset() if duration_s is not None else keys
        limit = duration_s if duration_s is not None else window_s
        shown = self._screen(words, responder, ends, min_view_s, limit, gaze, on_onset)
        answer = answer_of(shown, None, 0, shown.presses)
        return replace(answer, timed_out=False) if duration_s is not None else answer

    def rest(self, duration_s: float, responder: Responder | None = None, cross: bool = False) -> int:
        """The background (with a cross) for so long; the stamp of its last refresh."""
        with self._undisturbed():
            count = max(1, refresh_count(duration_s, self.display.nominal_hz))
            return self._blank(count, responder, None, cross=cross).end_ns

    def close(self) -> None:
        """Give the pictures back; the display is its owner's to close."""
        for sprite in [*self._words.values(), self._cross, self.stage.patch_on, self.stage.patch_off]:
            if sprite is not None:
                sprite.release()
        self._words.clear()
        self._cross = None
        if self._quads is not None:
            self._quads.release()

    # -- how it is done -------------------------------------------------------------------------------------------

    def _check(self, trial: Trial, sources: Mapping[str, FrameSource], modes_hz: Sequence[Fraction]) -> None:
        where = f"trial {trial.index}"
        if not 1 <= len(trial.panels) <= MAX_PANELS:
            raise InputError(problem(where, "panels", len(trial.panels), f"1 to {MAX_PANELS}"))
        absent = [panel.slot for panel in trial.panels if panel.slot not in sources]
        if absent:
            raise InputError(problem(where, "frames for panels", f"none for {', '.join(absent)}", "one source a panel"))
        used = {panel.slot: sources[panel.slot] for panel in trial.panels}
        modes = modes_hz or getattr(self.display, "modes_hz", ())
        for slot, source in used.items():
            check_rate(f"{where}, panel {slot}", source.rate_hz, self.display.nominal_hz, modes)
            if source.frame_count < 1:
                raise InputError(problem(f"{where}, panel {slot}", "frames", source.frame_count, "1 or more"))
        if self._gl is not None:
            admission = admit(used, self.disk_bytes_s, self.upload_limit_bytes_s)
            if not admission.from_disk:
                for source in {id(s): s for s in used.values() if not getattr(s, "live", False)}.values():
                    touch(source)

    @contextmanager
    def _panels(self, slots: Sequence[str], sources: Mapping[str, FrameSource]) -> Iterator[list[PanelPlay]]:
        """Textures of a trial, given back after it."""
        rects = place_panels({s: sources[s].size_px for s in slots}, self.display.size_px, self.gap_px, self.mirror)
        by_slot = {rect.slot: rect for rect in rects}
        textures: list[PanelTexture] = []
        plays = []
        try:
            for column, slot in enumerate(slots):
                source, texture = sources[slot], None
                if self._gl is not None and self._quads is not None:
                    texture = PanelTexture(self._gl, self._quads, by_slot[slot], source)
                    textures.append(texture)
                rate = source.rate_hz / self.display.nominal_hz
                plays.append(PanelPlay(column, rate, source.frame_count, texture))
            yield plays
        finally:
            for texture in textures:
                texture.release()

    def _screen(
        self, words: Sequence[Sprite], responder: Responder | None, ends: frozenset[str] | None, view_s: float,
        window_s: float | None, gaze: GazeSource | None, on_onset: OnOnset | None,
    ) -> PhaseShown:  # fmt: skip
        limit = None if window_s is None else max(1, refresh_count(window_s, self.display.nominal_hz))
        if responder is None and limit is None:
            raise ValueError("show_words: responder: got None, wanted one where no duration or window is given")
        phase = Phase(
            limit, sprites=words, end_keys=ends, min_view_ns=round(view_s * 1e9), abort_keys=self.abort_keys,
            on_onset=on_onset,
        )  # fmt: skip
        with self._undisturbed():
            return show_phase(self.stage, phase, responder, gaze, "skip")

    def _blank(
        self,
        refreshes: int,
        responder: Responder | None,
        gaze: GazeSource | None,
        cross: bool,
        marks: int = 0,
        continues: bool = False,
    ) -> PhaseShown:
        sprites = self._over(cross, "")
        phase = Phase(
            refreshes, sprites=sprites, marks=marks, patch="off" if self.patch == "off" else "dark", continues=continues
        )
        return show_phase(self.stage, phase, responder, gaze, "skip")

    def _patch_mode(self) -> Literal["off", "refresh", "on", "dark"]:
        return {"off": "off", "refresh": "refresh", "onset": "on"}[self.patch]  # type: ignore[return-value]

    def _undisturbed(self):
        return nullcontext() if self._gl is None else undisturbed()

    def _where(self) -> tuple[tuple[int, int], ViewGeometry, Style]:
        return self.display.size_px, self.geometry, self.style

    def _over(self, cross: bool, caption: str) -> list[Sprite]:
        """What stands above the panels."""
        if self._gl is None:
            return []
        sprites: list[Sprite] = []
        if cross:
            if self._cross is None:
                picture = paint_cross(*self._where())
                size, (width, height) = picture.shape[0], self.display.size_px
                rect = PanelRect("cross", (width - size) // 2, (height - size) // 2, size, size)
                self._cross = self._still(rect, picture)
            sprites.append(self._cross)
        if caption:
            width, height = self.display.size_px
            box = (0, height - height // 8, width, height // 8)
            sprites += self._sprite(("caption", caption), lambda: paint_words(caption, *self._where(), box))
        return sprites

    def _sprite(self, key: object, paint: Callable[[], Words]) -> list[Sprite]:
        """A painted picture, kept for the next time (the last 32)."""
        if self._gl is None:
            return []
        name = repr(key)
        if name not in self._words:
            words = paint()
            height, width = words.picture.shape[:2]
            if len(self._words) >= 32:
                self._words.pop(next(iter(self._words))).release()
            self._words[name] = self._still(PanelRect("words", words.x_px, words.y_px, width, height), words.picture)
        return [self._words[name]]

    def _still(self, rect: PanelRect, picture: np.ndarray) -> Sprite:
        if self._gl is None or self._quads is None:
            raise RuntimeError("no pixels are drawn on a virtual display")
        return Sprite(self._gl, self._quads, rect, picture)

    def _size_px(self, degrees: float) -> int:
        return round(degrees * pixels_per_degree(self.display.size_px, self.geometry))

    def _patch_rect(self) -> PanelRect:
        width, height = self.display.size_px
        size = max(8, self._size_px(self.style.patch_deg))
        x = width - size if self.style.patch_corner.endswith("right") else 0
        y = height - size if self.style.patch_corner.startswith("lower") else 0
        return PanelRect("patch", x, y, size, size)


def _flat(rect: PanelRect, code: int) -> np.ndarray:
    picture = np.full((rect.height_px, rect.width_px, 4), code, np.uint8)
    picture[..., 3] = 255
    return picture
