"""Device reading in its own process: nothing of it can delay a refresh.

Presses go to the presenter and to the log, gaze to the log and, newest only, to a board in shared memory that the
presenter looks at in every refresh. A device that vanishes is marked on the board, logged, and tried again ten times a
second until it is back. (The session's side: `device_reader`.)
"""

from __future__ import annotations

import select
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from studyapp.clock import now_ns
from studyapp.devices.decoders import BOX_KINDS
from studyapp.devices.device import Batch, Calibrates, Device, DeviceEvent, DeviceGone, DeviceSpec
from studyapp.devices.records import FIT_RING_DTYPE, GAZE_RING_DTYPE, event_record
from studyapp.devices.records import press_record as as_record
from studyapp.devices.status_board import ALIVE, GONE, OPENING, StatusBoard
from studyapp.gaze.calibration import GazeMap
from studyapp.ring import RecordRing, leave_interrupts_to_the_session
from studyapp.session_writer import StreamRings

REOPEN_S = 0.1
POLL_S = 0.002
FIT_S = 1.0


def open_device(spec: DeviceSpec) -> Device:
    """Open the device that ``spec`` names. Raises DeviceGone, and KeyError for an unknown kind."""
    if spec.kind in BOX_KINDS:
        from studyapp.devices.serial_box import SerialBox

        return SerialBox(spec)
    return _tracker_opener(spec.kind)(spec)


def _tracker_opener(kind: str) -> Callable[[DeviceSpec], Device]:
    # Imported only in the process that reads: pylsl and zmq start threads of their own.
    if kind == "lsl":
        from studyapp.devices.lsl import LslGaze

        return LslGaze
    if kind == "gazepoint":
        from studyapp.devices.gazepoint import Gazepoint

        return Gazepoint
    if kind == "pupil":
        from studyapp.devices.pupil import PupilCore

        return PupilCore
    if kind == "tobii":
        from studyapp.devices.tobii import TobiiPro

        return TobiiPro
    if kind == "eyelink":
        from studyapp.devices.eyelink import EyeLink

        return EyeLink
    raise KeyError(kind)


class _Reader:
    def __init__(
        self, specs: Sequence[DeviceSpec], streams: StreamRings, presses: RecordRing, board: StatusBoard
    ) -> None:
        self.specs, self.streams, self.presses, self.board = specs, streams, presses, board
        self.devices: list[Device | None] = [None] * len(specs)
        self.try_ns = [0] * len(specs)
        self.seen = [False] * len(specs)
        self.fit_ns = 0
        self.maps: dict[int, GazeMap] = {}
        self.news: list[tuple[int, dict[str, Any]]] = []

    def obey(self, message: object) -> bool:
        """A calibration step or a map from the session; False: it is time to end."""
        match message:
            case ("map", int(index), coefficients):
                if coefficients is None:
                    self.maps.pop(index, None)
                else:
                    self.maps[index] = GazeMap(np.asarray(coefficients, float), float("nan"))
            case ("calibrate", int(index), str(step), points):
                self.calibrate(index, step, np.asarray(points, float))
            case _:
                return False
        return True

    def calibrate(self, index: int, step: str, points: np.ndarray) -> None:
        device = self.devices[index]
        if not isinstance(device, Calibrates):
            if step != "abort":
                there = "has no calibration of its own" if device is not None else "is not there"
                self.news.append((index, {"failed": f"the tracker {there}"}))
            return
        try:
            said = device.calibrate(step, points)
        except DeviceGone as error:
            said = {"failed": str(error)}
        if said is not None:
            self.news.append((index, said))

    def tell(self, pipe: Connection) -> None:
        """Pass on what the trackers say of their calibration."""
        for item in self.news:
            pipe.send(item)
        self.news.clear()

    def mapped(self, index: int, gaze: np.ndarray) -> np.ndarray:
        """Samples with the session's own calibration of that tracker, where it has one."""
        found, screen = self.maps.get(index), self.specs[index].screen
        if found is None or screen is None or not len(gaze):
            return gaze
        seen = gaze["valid"] > 0
        raw = np.column_stack(screen.from_dva(gaze["x_dva"][seen], gaze["y_dva"][seen]))
        gaze = gaze.copy()
        gaze["x_dva"][seen], gaze["y_dva"][seen] = screen.to_dva(*found(raw).T)
        return gaze

    def event(self, device: int, event: DeviceEvent) -> None:
        if self.streams.events is not None:
            self.streams.events.put(event_record(event.t_ns, device, event.kind, dict(event.payload), event.raw))

    def turn(self, device: int, state: int, kind: str, payload: dict[str, Any]) -> None:
        """A device came or went: first on record, then on the board; whoever sees it there finds the event logged."""
        self.event(device, DeviceEvent(now_ns(), kind, payload))
        self.board.mark(device, state, str(payload.get("reason", "")))

    def open_missing(self) -> None:
        """Try every device that is not there, each ten times a second."""
        for index, spec in enumerate(self.specs):
            if self.devices[index] is not None or now_ns() < self.try_ns[index]:
                continue
            try:
                self.devices[index] = open_device(spec)
            except DeviceGone as error:
                self.try_ns[index] = now_ns() + int(REOPEN_S * 1e9)
                if self.board.state(index) == OPENING:
                    self.turn(index, GONE, "absent", {"reason": str(error)})
                continue
            kind = "reconnected" if self.seen[index] else "connected"
            self.seen[index] = True
            self.board.beat()
            self.turn(index, ALIVE, kind, {"port": spec.port})

    def wait(self, pipe: Connection) -> None:
        """Until a line has bytes, or a polled device is due."""
        lines = [d.descriptor for d in self.devices if d is not None and d.descriptor is not None]
        polled = any(d is None or d.descriptor is None for d in self.devices)
        select.select([*lines, pipe.fileno()], [], [], POLL_S if polled else 0.02)

    def poll(self) -> None:
        """Take what every device has."""
        for index, device in enumerate(self.devices):
            if device is None:
                continue
            try:
                self.store(index, device.poll())
            except DeviceGone as error:
                self.turn(index, GONE, "vanished", {"reason": str(error)})
                device.close()
                self.devices[index] = None
                self.try_ns[index] = now_ns() + int(REOPEN_S * 1e9)

    def store(self, index: int, batch: Batch) -> None:
        for press in batch.presses:
            self.presses.put(as_record(index, press))
        for event in batch.events:
            self.event(index, event)
        self.news += [(index, said) for said in batch.news]
        if len(batch.gaze):
            gaze = self.mapped(index, batch.gaze)
            self.board.look(index, gaze[-1])
            if self.streams.gaze is not None:
                records = np.empty(len(gaze), GAZE_RING_DTYPE)
                records["device"], records["sample"] = index, gaze
                self.streams.gaze.put_many(records)

    def fits(self) -> None:
        """Put every clock's fit on record once a second."""
        if now_ns() < self.fit_ns or self.streams.fits is None:
            return
        self.fit_ns = now_ns() + int(FIT_S * 1e9)
        for index, device in enumerate(self.devices):
            fit = device.fit() if device is not None else None
            if fit is not None:
                row = np.zeros((), FIT_RING_DTYPE)
                row["t_ns"], row["device"], row["offset_ns"] = now_ns(), index, fit.offset_ns
                row["drift_ppm"], row["uncertainty_ns"], row["n"] = fit.drift_ppm, fit.uncertainty_ns, fit.n
                self.streams.fits.put(row)


def read_devices(
    pipe: Connection, specs: Sequence[DeviceSpec], streams: StreamRings, presses: RecordRing, board: StatusBoard
) -> None:
    """The reader process: runs until its pipe is closed; through it come calibration steps and maps."""
    leave_interrupts_to_the_session()
    reader = _Reader(specs, streams, presses, board)
    board.beat()
    try:
        while True:
            reader.open_missing()
            reader.wait(pipe)
            reader.poll()
            reader.fits()
            board.beat()
            if pipe.poll() and not reader.obey(pipe.recv()):
                break
            reader.tell(pipe)
    except (EOFError, BrokenPipeError):
        pass  # the session is over
    finally:
        for device in reader.devices:
            if device is not None:
                device.close()
