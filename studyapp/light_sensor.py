"""Light, where a sensor is attached: a photodiode logger on the light patch against the presenter's own record.

The logger is a serial line of text, ``<microseconds>:<event>`` at 115200 baud, with the events ``PD`` (light came on),
``pd`` (light went off) and, where it moves an artificial eye (`studyapp.gaze.eye_to_light`), ``EY``, all on its own
clock. `Emulator` is such a logger on a pseudo-terminal.
"""

from __future__ import annotations

import os
import tty
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import serial

from protocols.records import FLIP_DTYPE, FLIP_LIGHT_PATCH
from stimuli.errors import InputError, problem
from studyapp.clock import now_ns
from studyapp.present.frame_loop import Phase, show_phase, undisturbed
from studyapp.present.presenter import KeptFlips, Presenter
from studyapp.seams import Display, Flip

BAUD = 115_200
ON, OFF, EYE = "PD", "pd", "EY"
TOGGLES = 960
PART = 120
"""Toggles shown at a time; even, so that the patch goes on alternating."""
EYE_WAIT_NS = 20_000_000
LONGEST_LIGHT_MS = 100.0
"""No display answers later than this."""


@dataclass(frozen=True)
class LightEdge:
    """One event of the logger: its own clock in microseconds, and whether the light came on."""

    device_us: int
    on: bool


@dataclass(frozen=True)
class LightResult:
    """Flip to light. ``mean_ms`` is from the stamp of the flip to the light, ``sd_ms`` its SD; ``drift_ppm`` of the
    logger's clock against the session clock; ``light_missed``: refreshes lost as the light tells it,
    ``recorded_missed``: as the presenter recorded them, ``agreeing``: at the very same flips."""

    edges: int
    mean_ms: float
    sd_ms: float
    drift_ppm: float
    light_missed: int
    recorded_missed: int
    agreeing: bool

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)


@dataclass(frozen=True)
class LogEvent:
    """Any event of the logger: its own clock in microseconds, and ON, OFF or EYE."""

    device_us: int
    event: str


def parse_events(raw: bytes) -> tuple[list[LogEvent], bytes, int]:
    """Events in ``raw``, what is left of an unfinished line, and how many lines were neither light's nor the eye's."""
    *lines, rest = raw.split(b"\n")
    events, other = [], 0
    for line in lines:
        stamp, _, event = line.strip().partition(b":")
        if stamp.isdigit() and event in (ON.encode(), OFF.encode(), EYE.encode()) and len(stamp) <= 18:
            events.append(LogEvent(int(stamp), event.decode()))
        elif line.strip():
            other += 1
    return events, rest, other


def parse_lines(raw: bytes) -> tuple[list[LightEdge], bytes, int]:
    """Edges in ``raw``, what is left of an unfinished line, and how many lines were no light events."""
    events, rest, other = parse_events(raw)
    edges = [LightEdge(event.device_us, event.event == ON) for event in events if event.event != EYE]
    return edges, rest, other + len(events) - len(edges)


def compare(
    rows: np.ndarray, edges: Sequence[LightEdge], synchronised_us: tuple[int, int], refresh_ns: float
) -> LightResult:
    """Match light edges with the flips that switched the patch.

    ``rows``: FLIP_DTYPE rows of one run; ``synchronised_us``: (device, session) microseconds of one common moment
    before the first flip. The logger's drift is fitted with the match. Raises InputError where the light does not
    follow the patch.
    """
    lit = (rows["flags"] & FLIP_LIGHT_PATCH) > 0
    switched = np.flatnonzero(np.diff(lit.astype(np.int8), prepend=0))
    if len(edges) != len(switched):
        wanted = f"{len(switched)} (is the sensor on the patch, and its threshold between black and white?)"
        raise InputError(problem("light sensor", "edges", len(edges), wanted))
    wrong = sum(edge.on != bool(lit[place]) for edge, place in zip(edges, switched, strict=True))
    if wrong:
        raise InputError(problem("light sensor", "edges of the wrong kind", wrong, "light on where the patch is white"))
    if len(switched) < 10:
        raise InputError(problem("light sensor", "edges", len(switched), "10 or more"))
    light_ns = (np.array([edge.device_us for edge in edges], np.int64) - synchronised_us[0]) * 1000
    shown_ns = rows["shown_ns"][switched] - synchronised_us[1] * 1000
    # Drift of the logger's clock: slope of (light - shown) over time.
    late_ns = (light_ns - shown_ns).astype(np.float64)
    slope, _ = np.polyfit(shown_ns.astype(np.float64), late_ns, 1)
    late_ns -= slope * shown_ns
    mean_ms = float(late_ns.mean()) / 1e6
    if not -1.0 <= mean_ms <= LONGEST_LIGHT_MS:
        raise InputError(problem("light sensor", "flip to light", f"{mean_ms:.1f} ms", f"0 to {LONGEST_LIGHT_MS:g} ms"))
    # Refreshes between two edges: by light, and by the presenter's index.
    by_light = np.round(np.diff(light_ns) / (1 + slope) / refresh_ns).astype(int)
    by_record = np.diff(rows["refresh"][switched])
    swaps = np.diff(switched)
    return LightResult(
        edges=len(edges),
        mean_ms=mean_ms,
        sd_ms=float(late_ns.std(ddof=1)) / 1e6,
        drift_ppm=float(slope) * 1e6,
        light_missed=int((by_light - swaps).sum()),
        recorded_missed=int((by_record - swaps).sum()),
        agreeing=bool(np.array_equal(by_light, by_record)),
    )


class Logger:
    """The serial line; its clock and ours are compared at the moment of its reply to 'i'."""

    def __init__(self, port: str, meanwhile: Callable[[], None] | None = None) -> None:
        try:
            self._line = serial.Serial(port, BAUD, timeout=0)
        except serial.SerialException as error:
            said = str(error).split(":")[0]
            raise InputError(
                problem("light sensor", "port", f"{port} ({said})", "a serial port, or 'emulated'")
            ) from None
        self._raw = b""
        self._meanwhile = meanwhile

    def synchronise(self, attempts: int = 20) -> tuple[int, int]:
        """(device, session) microseconds of one moment: the reply with the shortest round trip of ``attempts``."""
        best: tuple[int, int, int] | None = None
        for _ in range(attempts):
            asked = now_ns()
            self._line.write(b"i")
            if self._meanwhile is not None:
                self._meanwhile()
            reply = b""
            while not reply.endswith(b"\n") and now_ns() - asked < 500_000_000:
                reply += self._line.read(64)
            answered = now_ns()
            stamp = reply.strip().partition(b":")[0]
            if stamp.isdigit() and (best is None or answered - asked < best[0]):
                best = (answered - asked, int(stamp), (asked + answered) // 2000)
        if best is None:
            raise InputError(problem("light sensor", "reply to 'i'", "none", "<microseconds>:i within 0.5 s"))
        return best[1], best[2]

    def edges(self) -> list[LightEdge]:
        """All edges that have come so far, without waiting."""
        return parse_lines(self._all())[0]

    def events(self) -> list[LogEvent]:
        """All events that have come so far, the eye's too, without waiting."""
        return parse_events(self._all())[0]

    def move_eye(self) -> None:
        """Have the artificial eye step to its other side, 0 to 20 ms from now."""
        self._line.write(b"e")

    def _all(self) -> bytes:
        while chunk := self._line.read(65536):
            self._raw += chunk
        return self._raw

    def close(self) -> None:
        """Close the port."""
        self._line.close()


class Emulator:
    """A logger on a pseudo-terminal: light follows the patch ``latency_ms`` later, with jitter and a drifting clock.

    ``see`` tells it what the display shows; ``lose``: numbers of flips (0, 1, ...) whose light never comes; ``eye``:
    the artificial eye, told when (session ns) to step.
    """

    eye: Callable[[int], None] | None = None

    def __init__(
        self, latency_ms: float = 3.0, jitter_ms: float = 0.05, drift_ppm: float = 40.0, seed: int = 0,
        lose: frozenset[int] = frozenset(),
    ) -> None:  # fmt: skip
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.port = os.ttyname(self._theirs)
        self._latency_ns, self._jitter_ns = latency_ms * 1e6, jitter_ms * 1e6
        self._drift, self._zero_ns = drift_ppm * 1e-6, now_ns()
        self._rng = np.random.default_rng(seed)
        self._on = False
        self._seen = 0
        self._lose = lose

    def see(self, shown_ns: int, on: bool) -> None:
        """The patch is white or black from ``shown_ns`` on."""
        self._seen += 1
        if on != self._on and self._seen - 1 not in self._lose:
            self._on = on
            at = shown_ns + self._latency_ns + self._rng.normal(0, self._jitter_ns)
            os.write(self._ours, f"{self._device_us(at)}:{ON if on else OFF}\r\n".encode())

    def answer(self) -> None:
        """Reply to the commands that have come."""
        try:
            commands = os.read(self._ours, 64)
        except BlockingIOError:
            return
        for _ in range(commands.count(b"i")):
            os.write(self._ours, f"{self._device_us(now_ns())}:i\r\n".encode())
        for _ in range(commands.count(b"e")):
            at_ns = now_ns() + int(self._rng.uniform(0, EYE_WAIT_NS))
            if self.eye is not None:
                self.eye(at_ns)
                os.write(self._ours, f"{self._device_us(at_ns)}:{EYE}\r\n".encode())

    def _device_us(self, at_ns: float) -> int:
        return round((at_ns - self._zero_ns) * (1 + self._drift) / 1000) + 5_000_000

    def close(self) -> None:
        """Close both ends."""
        os.close(self._ours)
        os.close(self._theirs)


class SeenDisplay:
    """A display that an emulated sensor looks at."""

    def __init__(self, display: Display, emulator: Emulator, lit: Callable[[int], bool]) -> None:
        self._display, self._emulator, self._lit = display, emulator, lit
        self._flips = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._display, name)

    def flip(self) -> Flip:
        """Flip, and let the sensor see it."""
        flip = self._display.flip()
        self._emulator.see(flip.shown_ns, self._lit(self._flips))
        self._flips += 1
        return flip


def measure_light(display: Display, port: str, toggles: int = TOGGLES) -> dict[str, Any]:
    """Toggle the light patch at every refresh and compare with the sensor on ``port`` ('emulated': the emulator).

    Returns `LightResult` as a dictionary with ``port``. Raises InputError where the sensor does not answer.
    """
    if display.context() is None:
        raise InputError(problem("light sensor", "display", display.description, "one with light: glfw or offscreen"))
    emulator = Emulator() if port == "emulated" else None
    seen: Any = (
        display if emulator is None else SeenDisplay(display, emulator, lambda flip: flip < toggles and flip % 2 == 0)
    )
    logger = Logger(port if emulator is None else emulator.port, None if emulator is None else emulator.answer)
    sink = KeptFlips()
    presenter = Presenter(seen, sink, patch="refresh")
    try:
        moment = logger.synchronise()
        logger_edges_before = len(logger.edges())
        with undisturbed():
            # In parts, emptying the line between them: a tty holds 4096 bytes.
            for begun in range(0, toggles, PART):
                show_phase(presenter.stage, Phase(min(PART, toggles - begun), patch="refresh"), None, None, "hold")
                logger.edges()
            show_phase(presenter.stage, Phase(24, patch="dark"), None, None, "hold")
        edges = logger.edges()[logger_edges_before:]
    finally:
        presenter.close()
        logger.close()
        if emulator is not None:
            emulator.close()
    rows = sink.rows().astype(FLIP_DTYPE)
    period_ns = float(getattr(display, "period_ns", 1e9 / float(display.nominal_hz)))
    return {**compare(rows, edges, moment, period_ns).as_dict(), "port": port}
