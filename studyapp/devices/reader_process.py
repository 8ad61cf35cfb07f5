"""Device reading in its own process: nothing of it can delay a refresh, and its death is noticed like a device's.

Presses go to the presenter and to the log, gaze to the log and, newest only, to a board in shared memory that the
presenter looks at in every refresh. A device that vanishes is marked on the board, logged, and tried again ten times a
second until it is back.
"""

from __future__ import annotations

import select
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import RawArray
from typing import Any

import numpy as np

from studyapp.clock import now_ns
from studyapp.devices.decoders import BOX_KINDS
from studyapp.devices.device import Batch, Calibrates, Device, DeviceEvent, DeviceGone, DeviceSpec
from studyapp.devices.records import FIT_RING_DTYPE, GAZE_RING_DTYPE, PRESS_RING_DTYPE, event_record, press_from_record
from studyapp.devices.records import press_record as as_record
from studyapp.gaze.calibration import GazeMap
from studyapp.ring import RecordRing, leave_interrupts_to_the_session, spawn_context
from studyapp.seams import Press
from studyapp.session_writer import StreamRings

TRACKER_KINDS = ("lsl", "gazepoint", "pupil", "tobii", "eyelink")
OPENING, ALIVE, GONE = 0, 1, 2
HEARTBEAT_LIMIT_S = 1.0  # of a reader that lives and does not come round; a dead one is noticed at once
REOPEN_S = 0.1
POLL_S = 0.002
FIT_S = 1.0
_SLOT = np.dtype(
    [
        ("state", "<i8"),
        ("changed_ns", "<i8"),
        ("sequence", "<i8"),  # odd while the sample below is being written
        ("x_dva", "<f8"),
        ("y_dva", "<f8"),
        ("mapped_ns", "<i8"),
        ("valid", "<i8"),
        ("reason", "S120"),
    ]
)


class StatusBoard:
    """One slot a device in shared memory: is it there, since when, and its newest gaze sample. One writer."""

    def __init__(self, n_devices: int, memory: Any = None) -> None:
        self._n = n_devices
        self._memory = RawArray("B", 8 + n_devices * _SLOT.itemsize) if memory is None else memory
        flat = np.frombuffer(self._memory, np.uint8)
        self._beat = flat[:8].view(np.int64)
        self._slots = flat[8:].view(_SLOT)

    def __reduce__(self) -> tuple[Any, ...]:
        return StatusBoard, (self._n, self._memory)

    def beat(self) -> None:
        """The reader is running."""
        self._beat[0] = now_ns()

    def age_s(self) -> float:
        """Seconds since the last beat."""
        return (now_ns() - int(self._beat[0])) * 1e-9

    def mark(self, device: int, state: int, reason: str = "") -> None:
        """A device came, or went, and why."""
        slot = self._slots[device]
        slot["reason"] = reason.encode("ascii", "replace")[:120]
        slot["changed_ns"] = now_ns()
        slot["state"] = state

    def state(self, device: int) -> int:
        """OPENING, ALIVE or GONE."""
        return int(self._slots[device]["state"])

    def reason(self, device: int) -> str:
        """How it showed that the device was gone."""
        return bytes(self._slots[device]["reason"]).decode()

    def look(self, device: int, sample: np.ndarray) -> None:
        """Publish the newest GAZE_DTYPE sample."""
        slot = self._slots[device]
        slot["sequence"] += 1
        slot["x_dva"], slot["y_dva"] = sample["x_dva"], sample["y_dva"]
        slot["mapped_ns"], slot["valid"] = sample["mapped_ns"], sample["valid"]
        slot["sequence"] += 1

    def newest(self, device: int) -> tuple[float, float, int, bool] | None:
        """(x_dva, y_dva, mapped_ns, valid) of the newest sample, None before the first."""
        slot = self._slots[device]
        for _ in range(100):
            before = int(slot["sequence"])
            if before == 0:
                return None
            found = (float(slot["x_dva"]), float(slot["y_dva"]), int(slot["mapped_ns"]), bool(slot["valid"]))
            if before % 2 == 0 and int(slot["sequence"]) == before:
                return found
        return None


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
                    self.board.mark(index, GONE, str(error))
                    self.event(index, DeviceEvent(now_ns(), "absent", {"reason": str(error)}))
                continue
            kind = "reconnected" if self.seen[index] else "connected"
            self.seen[index] = True
            self.board.beat()
            self.board.mark(index, ALIVE)
            self.event(index, DeviceEvent(now_ns(), kind, {"port": spec.port}))

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
                self.board.mark(index, GONE, str(error))
                self.event(index, DeviceEvent(now_ns(), "vanished", {"reason": str(error)}))
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
