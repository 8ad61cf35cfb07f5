"""Whether this machine can play a trial: memory, disk, and what it uploads in a refresh, measured on this display."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import moderngl
import numpy as np
import psutil

from protocols.trial import Trial
from stimuli.errors import InputError, problem
from studyapp.clock import now_ns
from studyapp.present.layout import IN_SEQUENCE, PanelRect
from studyapp.present.uploader import PanelTexture, Quads
from studyapp.seams import Display, FrameSource

UPLOAD_SHARE = 0.5
"""Of each refresh, at most this share may go to uploads: the rest is the swap's, and slack for a busy machine."""
UPLOAD_ROUNDS = 60
BYTES_PER_PX = 4


@dataclass(frozen=True)
class Admission:
    """What a trial asks of the machine. ``upload_bytes_s``: written to textures a second; ``resident_bytes``: all its
    clips; ``from_disk``: they do not fit in memory and are read while they play."""

    resident_bytes: int
    upload_bytes_s: float
    available_bytes: int
    from_disk: bool


def admit(
    sources: Mapping[str, FrameSource],
    disk_bytes_s: float | None = None,
    upload_limit_bytes_s: float | None = None,
    available_bytes: int | None = None,
) -> Admission:
    """Refuse a trial that this machine cannot play (decisions.md, playback memory).

    All clips of the trial fit in 80 % of the free memory, or the measured disk rate ``disk_bytes_s`` is twice what is
    needed; ``upload_limit_bytes_s`` is what may be uploaded (`UploadBudget`). Intervals that follow one another are
    not uploaded together. Raises InputError naming what is short.
    """
    stored = {slot: source for slot, source in sources.items() if not getattr(source, "live", False)}
    frame_bytes = {slot: source.size_px[0] * source.size_px[1] * BYTES_PER_PX for slot, source in sources.items()}
    # Two panels may show one clip: its pages are counted once.
    unique = {id(source): frame_bytes[slot] * source.frame_count for slot, source in stored.items()}
    resident = sum(unique.values())
    upload = at_once({slot: frame_bytes[slot] * source.rate_hz for slot, source in sources.items()})
    available = psutil.virtual_memory().available if available_bytes is None else available_bytes
    from_disk = resident > 0.8 * available
    read = float(sum(frame_bytes[slot] * source.rate_hz for slot, source in stored.items()))
    problems = []
    if from_disk and (disk_bytes_s is None or disk_bytes_s < 2 * read):
        disk = "a disk of unknown rate" if disk_bytes_s is None else f"a disk of {disk_bytes_s / 1e6:.0f} MB/s"
        got = f"{resident / 1e9:.2f} GB of clips, {available / 1e9:.2f} GB free memory and {disk}"
        wanted = f"clips within 80 % of free memory, or a disk of {2 * read / 1e6:.0f} MB/s"
        problems.append(problem("admission", "playback memory", got, wanted))
    if upload_limit_bytes_s is not None and upload > upload_limit_bytes_s:
        problems.append(_too_much(upload, upload_limit_bytes_s))
    if problems:
        raise InputError(*problems)
    return Admission(resident, upload, available, from_disk)


def touch(source: FrameSource) -> int:
    """Read one byte of each memory page of a stored clip, so that no refresh waits for the disk; returns their sum."""
    return sum(int(source.frame(index).reshape(-1)[::4096].sum()) for index in range(source.frame_count))


def at_once(rates: Mapping[str, Fraction]) -> float:
    """Of the bytes a second that each slot asks for, what is asked for at the same time."""
    in_sequence = len(rates) > 1 and all(slot in IN_SEQUENCE for slot in rates)
    return float(max(rates.values()) if in_sequence else sum(rates.values()))


def _too_much(upload: float, limit: float) -> str:
    wanted = f"at most {limit / 1e6:.0f} MB/s (measured here, {UPLOAD_SHARE:.0%} of each refresh)"
    return problem("admission", "upload", f"{upload / 1e6:.0f} MB/s", wanted)


@dataclass(frozen=True)
class UploadBudget:
    """What a display takes, and what a study asks of it. ``measured_bytes_s``: median rate of ``rounds`` refreshes'
    worth of frames of ``size_px`` on ``panels`` panels, drawn and waited for; ``needed_bytes_s``: of the heaviest
    trial."""

    measured_bytes_s: float
    needed_bytes_s: float
    size_px: tuple[int, int]
    panels: int
    rounds: int

    @property
    def limit_bytes_s(self) -> float:
        """Bytes a second that may be uploaded."""
        return UPLOAD_SHARE * self.measured_bytes_s

    def problems(self) -> list[str]:
        """A line where the heaviest trial asks for more; [] where it may be played."""
        return [_too_much(self.needed_bytes_s, self.limit_bytes_s)] if self.needed_bytes_s > self.limit_bytes_s else []


def measure_upload(display: Display, trials: Iterable[Trial], rounds: int = UPLOAD_ROUNDS) -> UploadBudget | None:
    """The budget on ``display`` for the heaviest of ``trials``; None where nothing is uploaded: no pixels, or no panels
    to show."""
    gl = display.context()
    heaviest = max((trial for trial in trials if trial.panels), key=_asked, default=None)
    if heaviest is None or not isinstance(gl, moderngl.Context):
        return None
    width, height = (int(side) for side in heaviest.settings["size_px"])
    slots = [panel.slot for panel in heaviest.panels]
    panels = 1 if all(slot in IN_SEQUENCE for slot in slots) else len(slots)
    taken_ns = _rounds_ns(gl, display.size_px, (width, height), panels, rounds)
    measured = width * height * BYTES_PER_PX * panels / float(np.median(taken_ns)) * 1e9
    return UploadBudget(measured, _asked(heaviest), (width, height), panels, rounds)


def _asked(trial: Trial) -> float:
    """Bytes a second that a planned trial uploads."""
    width, height = (int(side) for side in trial.settings["size_px"])
    return at_once({panel.slot: width * height * BYTES_PER_PX * Fraction(panel.rate_hz) for panel in trial.panels})


class _Noise:
    """Frames of which no two in a row are the same."""

    rate_hz = Fraction(1)
    frame_count = 3

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.size_px = size_px
        self._frames = np.random.default_rng(0).integers(0, 256, (3, size_px[1], size_px[0], BYTES_PER_PX), np.uint8)

    def frame(self, index: int) -> np.ndarray:
        picture: np.ndarray = self._frames[index % 3]
        return picture


def _rounds_ns(
    gl: moderngl.Context, display_px: tuple[int, int], size_px: tuple[int, int], panels: int, rounds: int
) -> Sequence[int]:
    """Nanoseconds of each round: one new frame a panel written, drawn and waited for, as in a refresh of a trial."""
    quads, noise = Quads(gl, display_px), _Noise(size_px)
    textures = [PanelTexture(gl, quads, PanelRect("upload", 0, 0, *size_px), noise) for _ in range(panels)]
    taken = []
    try:
        for place in range(rounds + 10):
            began_ns = now_ns()
            for texture in textures:
                texture.fetch(place % 3)
                texture.draw(place % 3)
            gl.finish()
            taken.append(now_ns() - began_ns)
    finally:
        for texture in textures:
            texture.release()
        quads.release()
    return taken[10:]
