"""Eye to light: how long after an eye has moved the display's light follows, as a gaze-contingent picture would.

An artificial eye before the tracker, and a photodiode on the light patch, both on one logger's clock (`light_sensor`):
told 'e', the logger moves the eye to the other side after 0 to 20 ms of its own choosing (so that steps fall anywhere
within a refresh) and says ``<microseconds>:EY``. The patch is white while the newest gaze is to the right of the
middle, black while it is to the left, decided at every refresh just before it is drawn. What a technique takes to
render comes on top: every live frame's record has it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import moderngl
import numpy as np

from stimuli.errors import InputError, problem
from studyapp.clock import wall_clock_utc
from studyapp.light_sensor import EYE, OFF, ON, Emulator, LogEvent, Logger, SeenDisplay
from studyapp.present.frame_loop import undisturbed
from studyapp.present.presenter import KeptFlips, Presenter
from studyapp.seams import Display, GazeSource

STEPS = 60
STEP_S, STEP_JITTER_S = 0.25, 0.05
EYE_DVA = 5.0
"""An emulated eye looks so far to the left or to the right."""
LEAST_SEEN = 0.9
"""Fewer of the eye's steps than this share followed by light, and it was not the eye that the light followed."""
MoveEye = Callable[[float, int], None]
"""An emulated eye is told where it looks (degrees to the right) from which session ns on."""


@dataclass(frozen=True)
class EyeToLight:
    """Milliseconds from the eye's step to the light. ``unseen``: steps that no light followed before the next one."""

    steps: int
    unseen: int
    mean_ms: float
    sd_ms: float
    median_ms: float
    p95_ms: float
    worst_ms: float


def follow(events: Sequence[LogEvent]) -> EyeToLight:
    """Each step of the eye against the first light edge between it and the next step, on the logger's own clock.

    Raises InputError where fewer than 10 steps or less than `LEAST_SEEN` of them were followed.
    """
    ordered = sorted(events, key=lambda event: event.device_us)
    steps_us = np.array([event.device_us for event in ordered if event.event == EYE], np.int64)
    edges_us = np.array([event.device_us for event in ordered if event.event in (ON, OFF)], np.int64)
    if len(steps_us) < 10:
        wanted = "10 or more (does the logger move the eye when it is told 'e'?)"
        raise InputError(problem("eye to light", "steps of the eye", len(steps_us), wanted))
    first = np.searchsorted(edges_us, steps_us, side="right")
    until_us = np.append(steps_us[1:], np.iinfo(np.int64).max)
    after = np.append(edges_us, np.iinfo(np.int64).max)[first]
    seen = after < until_us
    if seen.mean() < LEAST_SEEN:
        wanted = f"{LEAST_SEEN:.0%} or more (does the tracker see the eye, and the sensor the patch?)"
        raise InputError(problem("eye to light", "steps that light followed", f"{seen.mean():.0%}", wanted))
    late_ms = (after[seen] - steps_us[seen]) * 1e-3
    return EyeToLight(
        steps=len(steps_us),
        unseen=int((~seen).sum()),
        mean_ms=float(late_ms.mean()),
        sd_ms=float(late_ms.std(ddof=1)),
        median_ms=float(np.median(late_ms)),
        p95_ms=float(np.percentile(late_ms, 95)),
        worst_ms=float(late_ms.max()),
    )


def measure_eye_to_light(
    display: Display, gaze: GazeSource, port: str, move: MoveEye | None = None, steps: int = STEPS, seed: int = 0
) -> dict[str, Any]:
    """Have the eye step ``steps`` times and time the light; `EyeToLight` as a dictionary, with ``sensor``, ``tracker``,
    ``display`` and ``date``.

    ``port``: the logger's, or 'emulated': then ``move`` moves the emulated tracker's eye. Raises InputError where the
    logger does not answer, or light does not follow.
    """
    gl = display.context()
    if not isinstance(gl, moderngl.Context):
        raise InputError(problem("eye to light", "display", display.description, "one with light: glfw or offscreen"))
    emulator = None
    if port == "emulated":
        if move is None:
            raise InputError(problem("eye to light", "sensor", "emulated", "an emulated eye with it (KIND:emulated)"))
        emulator = Emulator(seed=seed)
        emulator.eye = _alternately(move)
    logger = Logger(port if emulator is None else emulator.port)
    loop = _Follower(display, gl, gaze, emulator)
    rng = np.random.default_rng(seed)
    try:
        with undisturbed():
            loop.refresh(0.2)
            logger.events()
            for _ in range(steps):
                logger.move_eye()
                loop.refresh(STEP_S + rng.uniform(0, STEP_JITTER_S))
                logger.events()
            events = logger.events()
    finally:
        loop.close()
        logger.close()
        if emulator is not None:
            emulator.close()
    found = asdict(follow(events))
    return {
        **found, "sensor": port, "tracker": gaze.name, "display": display.description, "date": wall_clock_utc(),
    }  # fmt: skip


def _alternately(move: MoveEye) -> Callable[[int], None]:
    side = [-1.0]

    def step(at_ns: int) -> None:
        side[0] = -side[0]
        move(side[0] * EYE_DVA, at_ns)

    return step


class _Follower:
    """The frame loop of the measurement: the patch follows gaze."""

    def __init__(self, display: Display, gl: moderngl.Context, gaze: GazeSource, emulator: Emulator | None) -> None:
        self._gl, self._gaze, self._emulator, self._lit = gl, gaze, emulator, False
        self._display: Any = display if emulator is None else SeenDisplay(display, emulator, lambda _: self._lit)
        self._presenter = Presenter(self._display, KeptFlips(), patch="refresh")
        self._stage = self._presenter.stage

    def refresh(self, duration_s: float) -> None:
        """Refreshes for so long, by the clock: an unlocked display may not wait for its vblanks."""
        level, on, off = self._stage.background, self._stage.patch_on, self._stage.patch_off
        assert on is not None
        assert off is not None
        until_ns = self._display.now_ns() + round(duration_s * 1e9)
        while self._display.now_ns() < until_ns:
            newest = self._gaze.newest()
            if newest is not None and newest[3]:
                self._lit = newest[0] > 0
            self._gl.clear(level, level, level, 1.0)
            (on if self._lit else off).draw()
            self._display.flip()
            if self._emulator is not None:
                self._emulator.answer()

    def close(self) -> None:
        """Give the pictures back."""
        self._presenter.close()
