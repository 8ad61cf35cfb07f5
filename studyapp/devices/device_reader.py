"""The session's side of the reader process (`reader_process`): start it, ask it, and see that it lives.

Its death is noticed like a device's, and it is started again while the session waits for its devices.
"""

from __future__ import annotations

import select
from collections.abc import Sequence
from typing import Any

import numpy as np

from studyapp.clock import now_ns
from studyapp.devices.decoders import BOX_KINDS
from studyapp.devices.device import DeviceSpec
from studyapp.devices.reader_process import read_devices
from studyapp.devices.records import PRESS_RING_DTYPE, press_from_record
from studyapp.devices.status_board import ALIVE, OPENING, StatusBoard
from studyapp.ring import RecordRing, spawn_context
from studyapp.seams import Press
from studyapp.session_writer import StreamRings

TRACKER_KINDS = ("lsl", "gazepoint", "pupil", "tobii", "eyelink")
HEARTBEAT_LIMIT_S = 1.0  # of a reader that lives and does not come round; a dead one is noticed at once


class DeviceReader:
    """The session's side of the reader process. ``streams`` go to the log; a restarted reader goes on with them."""

    def __init__(self, specs: Sequence[DeviceSpec]) -> None:
        self.specs = tuple(specs)
        self.names = tuple(spec.name for spec in self.specs)
        self.streams = StreamRings.create(self.names)
        self.board = StatusBoard(len(self.specs))
        self._presses = RecordRing(PRESS_RING_DTYPE, 4096)
        self._maps: dict[int, np.ndarray] = {}
        self._start()

    def _start(self) -> None:
        context = spawn_context()
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=read_devices,
            args=(theirs, self.specs, self.streams, self._presses, self.board),
            name="device reader",
            daemon=True,
        )
        self._process.start()
        theirs.close()
        for index, coefficients in self._maps.items():
            self._pipe.send(("map", index, coefficients))

    def set_map(self, name: str, coefficients: np.ndarray | None) -> None:
        """Calibrate tracker ``name`` by this polynomial (`studyapp.gaze.calibration.GazeMap`, normalised coordinates)
        from now on, a restarted reader too; None: leave its gaze as it is."""
        index = self.names.index(name)
        self._maps.pop(index, None)
        if coefficients is not None:
            self._maps[index] = coefficients
        self._pipe.send(("map", index, coefficients))

    def calibrate(self, name: str, step: str, points: np.ndarray) -> None:
        """A step of tracker ``name``'s own calibration (`device.Calibrates`); its answers are `heard`."""
        self._pipe.send(("calibrate", self.names.index(name), step, points))

    def heard(self) -> list[tuple[str, dict[str, Any]]]:
        """What trackers said of their calibration since the last call: (device, answer)."""
        said = []
        try:
            while self._pipe.poll():
                index, answer = self._pipe.recv()
                said.append((self.names[index], answer))
        except (EOFError, ConnectionResetError):
            pass  # the reader died: its devices are seen to be missing
        return said

    @property
    def pid(self) -> int:
        """The reader's process id."""
        return int(self._process.pid)

    def restart(self) -> None:
        """Start anew where the process has died; its devices are opened again."""
        if not self._process.is_alive():
            self._pipe.close()
            for index in range(len(self.specs)):
                self.board.mark(index, OPENING)
            self._start()

    def alive(self) -> bool:
        """Is the process there?"""
        return self._process.is_alive()

    def running(self) -> bool:
        """Is the process there, and has it looked at its devices within `HEARTBEAT_LIMIT_S`?"""
        return self._process.is_alive() and self.board.age_s() < HEARTBEAT_LIMIT_S

    def missing(self) -> list[str]:
        """One line for each device that is not there: name and reason."""
        if not self._process.is_alive():
            return ["device reader: the process is gone"]
        states = enumerate(self.names)
        return [f"{name}: {self.board.reason(i) or 'opening'}" for i, name in states if self.board.state(i) != ALIVE]

    def wait_until_there(self, limit_s: float) -> list[str]:
        """Wait for all devices; what is still missing after ``limit_s`` ([]: all there)."""
        deadline_ns = now_ns() + int(limit_s * 1e9)
        while (missing := self.missing()) and now_ns() < deadline_ns:
            self.restart()
            select.select([], [], [], 0.02)
        return missing

    def responder(self) -> ReaderResponder:
        """Presses of all boxes."""
        return ReaderResponder(self)

    def gaze(self, name: str) -> BoardGaze:
        """The newest gaze of device ``name``."""
        return BoardGaze(self, self.names.index(name))

    def presses(self) -> list[Press]:
        """Presses since the last call."""
        return [press_from_record(record, self.names) for record in self._presses.take()] if len(self._presses) else []

    def close(self) -> None:
        """End the process. Twice is harmless."""
        if not self._pipe.closed:
            self._pipe.close()
            self._process.join(5.0)


class ReaderResponder:
    """A `Responder` (studyapp.seams): presses decoded by the reader process."""

    def __init__(self, reader: DeviceReader) -> None:
        self._reader = reader
        self.name = "+".join(spec.name for spec in reader.specs if spec.kind in BOX_KINDS)
        self._boxes = [index for index, spec in enumerate(reader.specs) if spec.kind in BOX_KINDS]

    def poll(self) -> list[Press]:
        return self._reader.presses()

    def alive(self) -> bool:
        return self._reader.running() and all(self._reader.board.state(box) == ALIVE for box in self._boxes)


class BoardGaze:
    """A `GazeSource` (studyapp.seams): the newest sample on the board."""

    def __init__(self, reader: DeviceReader, index: int) -> None:
        self._reader, self._index = reader, index
        self.name = reader.names[index]

    def newest(self) -> tuple[float, float, int, bool] | None:
        return self._reader.board.newest(self._index)

    def alive(self) -> bool:
        return self._reader.running() and self._reader.board.state(self._index) == ALIVE
