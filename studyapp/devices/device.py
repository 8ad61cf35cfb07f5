"""What every device is to the reader process: open, poll, close; and how a lab names one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from protocols.records import GAZE_DTYPE
from studyapp.devices.clock_model import ClockFit
from studyapp.gaze.angles import ScreenGeometry
from studyapp.seams import Press

SILENCE_LIMIT_S = 0.2
"""A stream of known rate that is silent for so long has vanished (a session must notice within 250 ms); a device's
option ``silence_s`` replaces it. A line that is closed is noticed at once, whatever the limit."""


def mapped_gaze(rows: Sequence[tuple[Any, ...]], fit: ClockFit | None) -> np.ndarray:
    """Rows of GAZE_DTYPE, with device stamps on the session's clock where there is a fit, never after their arrival."""
    gaze = np.array(rows, GAZE_DTYPE) if rows else np.zeros(0, GAZE_DTYPE)
    if len(gaze) and fit is not None:
        gaze["mapped_ns"] = np.minimum(fit.session_ns_many(gaze["device_s"]), gaze["host_ns"])
    return gaze


def silence_limit_s(spec: DeviceSpec) -> float:
    """`SILENCE_LIMIT_S`, or the device's own ``silence_s``."""
    return float(spec.options.get("silence_s", SILENCE_LIMIT_S))


class DeviceGone(RuntimeError):
    """The device cannot be reached (any more); the text says how that showed."""


@dataclass(frozen=True)
class DeviceSpec:
    """One device of a lab. ``kind``: a box kind of `decoders` or lsl | gazepoint | pupil | tobii | eyelink; ``port``:
    serial port, stream source id, or host:port; ``options`` as the kind's module says (trackers: ``calibrate``, see
    `studyapp.gaze.calibrate`); ``keys``: device key -> key name of the protocol."""

    name: str
    kind: str
    port: str
    options: Mapping[str, Any] = field(default_factory=dict)
    keys: Mapping[str, str] = field(default_factory=dict)
    screen: ScreenGeometry | None = None


@dataclass(frozen=True)
class DeviceEvent:
    """Something to be logged: ``kind`` of at most 16 letters, JSON-ready ``payload``, the bytes it came from."""

    t_ns: int
    kind: str
    payload: Mapping[str, object]
    raw: bytes = b""


@dataclass(frozen=True)
class Batch:
    """What one poll brought. ``gaze``: (N,) GAZE_DTYPE; ``news``: what a tracker says of its calibration."""

    presses: tuple[Press, ...] = ()
    gaze: np.ndarray = field(default_factory=lambda: np.zeros(0, GAZE_DTYPE))
    events: tuple[DeviceEvent, ...] = ()
    news: tuple[dict[str, Any], ...] = ()


@runtime_checkable
class Calibrates(Protocol):
    """A tracker that has a calibration of its own (`studyapp.gaze.calibrate`)."""

    def calibrate(self, step: str, points: np.ndarray) -> dict[str, Any] | None:
        """``step``: begin (at the normalised (N, 2) points), point (take in this one now), finish, abort. Answers with
        one of paced (host | device), target, collected, result, failed; None: the answer comes later (`news`)."""
        ...


class Device(Protocol):
    """A device in the reader process. ``descriptor``: readable when there is something to read; None: poll."""

    descriptor: int | None

    def poll(self) -> Batch:
        """What came since the last call, without waiting. Raises DeviceGone."""
        ...

    def fit(self) -> ClockFit | None:
        """The device's clock on ours; None where it has none or nothing is known yet."""
        ...

    def close(self) -> None:
        """Give the line back."""
        ...
