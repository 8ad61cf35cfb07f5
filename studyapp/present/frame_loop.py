"""The loop that shows one phase of a trial: draw, upload ahead, flip, record, poll. Nothing else runs in it.

No disk, no logging, no Python thread, garbage collection off; the per-refresh row is one buffer that is written over.
On the virtual display a phase without a possible early end is one block of numpy rows.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

import moderngl
import numpy as np

from protocols.records import (
    FLIP_DTYPE,
    FLIP_EARLY,
    FLIP_LATE,
    FLIP_LIGHT_PATCH,
    FLIP_PHASE_SLIP,
    MAX_PANELS,
)
from studyapp.display.virtual_display import VirtualDisplay
from studyapp.present.playlist import source_frames
from studyapp.present.uploader import GazeMark, PanelTexture, Sprite
from studyapp.seams import Display, FlipSink, GazeSource, Press, Responder

MissPolicy = Literal["hold", "skip"]
ALIVE_EVERY = 24
"""Refreshes between two looks whether the answering device is still there (0.1 s at 240 Hz)."""
CAPACITY = 1 << 20


@dataclass
class PanelPlay:
    """One panel within a phase: column of the record, content rate and length, and its texture (None: no pixels)."""

    column: int
    rate_hz: Fraction
    frame_count: int
    texture: PanelTexture | None


@dataclass
class Phase:
    """One stretch of refreshes. ``refreshes`` None: until a press. ``loop_refreshes``: the content begins anew after
    so many. A press of ``end_keys`` (None: of any key) at or after ``min_view_ns`` from onset ends the phase;
    frozenset(): presses end nothing. ``marks``: FLIP_* bits of its first row.
    ``continues``: it follows another phase at once; else refreshes that went by before it were idle, and not lost."""

    refreshes: int | None
    panels: Sequence[PanelPlay] = ()
    sprites: Sequence[Sprite] = ()
    loop_refreshes: int | None = None
    end_keys: frozenset[str] | None = frozenset()
    min_view_ns: int = 0
    abort_keys: frozenset[str] = frozenset()
    marks: int = 0
    patch: Literal["off", "refresh", "on", "dark"] = "off"
    continues: bool = False
    on_onset: Callable[[int], None] | None = None


@dataclass
class PhaseShown:
    """What came of it. ``swaps``: pictures shown; ``span``: refreshes they took; ``press``: the one that ended it."""

    onset_ns: int = 0
    end_ns: int = 0
    first_refresh: int = 0
    swaps: int = 0
    span: int = 0
    missed: int = 0
    early: int = 0
    late: int = 0
    slips: int = 0
    press: Press | None = None
    presses: list[Press] = field(default_factory=list)
    aborted: bool = False
    device_lost: bool = False
    oldest_gaze_ns: int = -1


@dataclass(frozen=True)
class Stage:
    """What every phase of a presenter shares."""

    display: Display
    sink: FlipSink
    gl: moderngl.Context | None
    background: float
    patch_on: Sprite | None
    patch_off: Sprite | None
    gaze_mark: GazeMark | None = None


@contextmanager
def undisturbed() -> Iterator[None]:
    """Garbage collected beforehand, then off; the switch interval short, should a library run a thread."""
    was_on, interval = gc.isenabled(), sys.getswitchinterval()
    gc.collect()
    gc.disable()
    sys.setswitchinterval(1e-4)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        if was_on:
            gc.enable()


@contextmanager
def set_aside() -> Iterator[None]:
    """What is there now is left out of later collections (a session has 100,000 objects that stay: 0.1 s each time)."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def ask_realtime(priority: int = 10) -> str:
    """Ask the system for real-time priority; 'fifo N' where it was granted, else why not (for the session's header)."""
    if not hasattr(os, "sched_setscheduler"):
        return "not on this system"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return "refused: needs CAP_SYS_NICE or an rtprio limit"
    return f"fifo {priority}"


def children_stay_normal() -> None:
    """Processes and threads started from here on have ordinary priority; nothing where ours is ordinary."""
    if hasattr(os, "SCHED_RESET_ON_FORK") and os.sched_getscheduler(0) == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_getparam(0))


def leave_realtime() -> None:
    """Ordinary priority again; nothing where it is ordinary."""
    reset = getattr(os, "SCHED_RESET_ON_FORK", 0)
    if hasattr(os, "sched_getscheduler") and os.sched_getscheduler(0) & ~reset == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def show_phase(
    stage: Stage, phase: Phase, responder: Responder | None, gaze: GazeSource | None, policy: MissPolicy
) -> PhaseShown:
    """Show one phase to its end; on the virtual display in blocks where nothing has to be looked at in between."""
    display = stage.display
    if isinstance(display, VirtualDisplay) and gaze is None:
        waits = phase.end_keys != frozenset() or bool(phase.abort_keys)
        if responder is None or not waits or hasattr(responder, "next_press_ns"):
            return _leap(stage, display, phase, responder, policy)
    return _loop(stage, phase, responder, gaze, policy)


def _accept(phase: Phase, shown: PhaseShown, pressed: Sequence[Press]) -> bool:
    """Keep the presses; True where one of them ends the phase."""
    for press in pressed:
        shown.presses.append(press)
        if press.key in phase.abort_keys:
            shown.press, shown.aborted = press, True
            return True
        wanted = phase.end_keys is None or press.key in phase.end_keys
        if wanted and press.mapped_ns - shown.onset_ns >= phase.min_view_ns:
            shown.press = press
            return True
    return False


def _loop(
    stage: Stage, phase: Phase, responder: Responder | None, gaze: GazeSource | None, policy: MissPolicy
) -> PhaseShown:
    display, sink, gl, level, mark = stage.display, stage.sink, stage.gl, stage.background, stage.gaze_mark
    flip, now_ns, put = display.flip, display.now_ns, sink.put
    poll = responder.poll if responder is not None else None
    shown = PhaseShown()
    row = np.zeros(1, FLIP_DTYPE)
    sources = [-1] * MAX_PANELS
    # The whole table beforehand: content of refresh k since onset, per panel.
    length = phase.loop_refreshes or phase.refreshes or 1
    tables = [_table(panel, length).tolist() for panel in phase.panels]
    textures = [panel.texture for panel in phase.panels]
    columns = [panel.column for panel in phase.panels]
    if gl is not None:
        for texture, table in zip(textures, tables, strict=True):
            if texture is not None and not texture.live:
                texture.fetch(table[0])
    step = 0
    while True:
        started = now_ns()
        marks = phase.marks if shown.swaps == 0 else 0
        place = step % length
        for column, table in zip(columns, tables, strict=True):
            sources[column] = table[place]
        lit = phase.patch == "on" or (phase.patch == "refresh" and shown.swaps % 2 == 0)
        if gl is not None:
            gl.clear(level, level, level, 1.0)
            for texture, table in zip(textures, tables, strict=True):
                if texture is not None:
                    texture.draw(table[place])
            for sprite in phase.sprites:
                sprite.draw()
            patch = stage.patch_on if lit else stage.patch_off
            if patch is not None and phase.patch != "off":
                patch.draw()
        drawn = now_ns()
        if gl is not None:
            # The next refresh's frame goes up while this one waits for its vblank.
            following = (step + 1) % length
            for texture, table in zip(textures, tables, strict=True):
                if texture is not None and not texture.live:
                    texture.fetch(table[following])
        uploaded = now_ns()
        newest = gaze.newest() if gaze is not None else None
        if newest is not None and newest[3] and mark is not None:
            mark.draw(newest[0], newest[1])
        done = flip()
        lost = done.missed if shown.swaps or phase.continues else 0
        age = -1
        if newest is not None:
            # How old the gaze was when the swap was requested.
            age = max(0, done.submitted_ns - newest[2])
            shown.oldest_gaze_ns = max(shown.oldest_gaze_ns, age)
        flags = done.flags | marks | (FLIP_LIGHT_PATCH if lit else 0)
        row[0] = (
            done.index, done.due_ns, done.submitted_ns, done.shown_ns, lost, flags, tuple(sources),
            uploaded - drawn, drawn - started, age,
        )  # fmt: skip
        put(row)
        if shown.swaps == 0:
            shown.onset_ns, shown.first_refresh = done.shown_ns, done.index
            if phase.on_onset is not None:
                phase.on_onset(done.shown_ns)
        else:
            shown.missed += lost
        shown.swaps += 1
        if done.flags:
            shown.early += bool(done.flags & FLIP_EARLY)
            shown.late += bool(done.flags & FLIP_LATE)
            shown.slips += bool(done.flags & FLIP_PHASE_SLIP)
        shown.end_ns = done.shown_ns
        shown.span = done.index - shown.first_refresh + 1
        # Frame-true: the next picture follows the last; time-true: it belongs to the next refresh of the raster.
        step = shown.swaps if policy == "hold" else shown.span
        if poll is not None:
            pressed = poll()
            if pressed and _accept(phase, shown, pressed):
                return shown
            if responder is not None and shown.swaps % ALIVE_EVERY == 0 and not responder.alive():
                shown.device_lost = True
                return shown
        if phase.refreshes is not None and step >= phase.refreshes:
            return shown


def _leap(
    stage: Stage, display: VirtualDisplay, phase: Phase, responder: Responder | None, policy: MissPolicy
) -> PhaseShown:
    """The same phase on the virtual display, in as few blocks as presses and faults allow."""
    shown = PhaseShown()
    blocks: list[np.ndarray] = []
    ended = False
    next_press = getattr(responder, "next_press_ns", None)
    first = display.flip_block(1)
    if not phase.continues:
        first["missed"] = 0
    shown.onset_ns, shown.first_refresh = int(first["shown_ns"][0]), int(first["refresh"][0])
    last = shown.first_refresh
    blocks.append(first)
    shown.swaps = 1
    if phase.on_onset is not None:
        phase.on_onset(shown.onset_ns)
    while not ended:
        if responder is not None:
            ended = _accept(phase, shown, responder.poll())
            if not ended and not responder.alive():
                shown.device_lost = ended = True
        step = shown.swaps if policy == "hold" else last - shown.first_refresh + 1
        if ended or (phase.refreshes is not None and step >= phase.refreshes):
            break
        count = CAPACITY if phase.refreshes is None else phase.refreshes - step
        stop = None
        if phase.refreshes is not None and policy == "skip":
            stop = shown.first_refresh + phase.refreshes
        coming = next_press() if next_press is not None else None
        if coming is not None:
            count = min(count, max(1, -int((display.now_ns() - coming) // display.period_ns)))
        elif phase.refreshes is None:
            raise RuntimeError("virtual display: an open-ended screen, and no press is ever to come")
        block = display.flip_block(count, stop)
        blocks.append(block)
        shown.swaps += len(block)
        last = int(block["refresh"][-1])
    rows = np.concatenate(blocks)
    _fill(rows, phase, policy, shown.first_refresh)
    stage.sink.put(rows)
    shown.end_ns = int(rows["shown_ns"][-1])
    shown.span = last - shown.first_refresh + 1
    shown.missed = int(rows["missed"][1:].sum())
    for name, bit in (("early", FLIP_EARLY), ("late", FLIP_LATE), ("slips", FLIP_PHASE_SLIP)):
        setattr(shown, name, int(np.count_nonzero(rows["flags"] & bit)))
    return shown


def _table(panel: PanelPlay, length: int) -> np.ndarray:
    """Source frame of each of the phase's refreshes; PanelPlay.rate_hz is per refresh of the display."""
    return source_frames(np.arange(length), panel.rate_hz, Fraction(1), panel.frame_count)


def _fill(rows: np.ndarray, phase: Phase, policy: MissPolicy, first_refresh: int) -> None:
    """Source frames, marks and light patch of a block of rows, as the loop writes them."""
    swaps = np.arange(len(rows))
    if policy == "hold":
        steps = swaps
    else:
        steps = np.zeros(len(rows), np.int64)
        steps[1:] = rows["refresh"][:-1] - first_refresh + 1
    rows["source"] = -1
    length = phase.loop_refreshes or phase.refreshes or 1
    for panel in phase.panels:
        rows["source"][:, panel.column] = _table(panel, length)[steps % length]
    rows["gaze_age_ns"] = -1
    rows["flags"][0] |= phase.marks
    if phase.patch == "on":
        rows["flags"] |= FLIP_LIGHT_PATCH
    elif phase.patch == "refresh":
        rows["flags"] |= np.where(swaps % 2 == 0, FLIP_LIGHT_PATCH, 0).astype(np.int32)
