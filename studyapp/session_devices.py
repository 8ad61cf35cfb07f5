"""The devices of one session: a person's (lab file, keyboard), or emulated ones on real lines (simulated observer)."""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stimuli.errors import InputError, problem
from studyapp.cli import JobFailed
from studyapp.devices.decoders import BOX_KINDS, BYTE_BOXES
from studyapp.devices.device import DeviceSpec
from studyapp.devices.device_reader import TRACKER_KINDS, BoardGaze, DeviceReader
from studyapp.devices.emulators import Emulator, box_emulator, gaze_emulator
from studyapp.devices.keyboard import Keyboard
from studyapp.devices.mouse_gaze import MouseGaze
from studyapp.devices.simulated import BoxAnswers, EmulatedPresses, LeapingPresses
from studyapp.gaze.angles import ScreenGeometry
from studyapp.gaze.calibrate import Calibrator
from studyapp.gaze.targets import TargetScreen
from studyapp.lab_file import Lab
from studyapp.seams import Display
from studyapp.session_writer import StreamRings
from studyapp.trial import AnswerDevice

BUTTONS = tuple("12345678")
GAZE_HZ = 250.0
START_LIMIT_S = 30.0
EMULATOR_SILENCE_S = 10.0
"""An emulator shares the processor with everything else and may stutter; one that is gone closes its line."""


@dataclass
class SessionDevices:
    """What a session needs of its devices. ``reader`` None: only the keyboard. ``emulators``: box and eyes, if any;
    ``calibrate``: how the tracker is calibrated before the session (`studyapp.gaze.calibrate`; '': it is already)."""

    answers: AnswerDevice
    gaze: BoardGaze | MouseGaze | None = None
    reader: DeviceReader | None = None
    emulators: tuple[Emulator, ...] = ()
    reconnect_s: float = 60.0
    streams: StreamRings = field(default_factory=StreamRings)
    calibrate: str = ""

    def reconnect(self) -> list[str]:
        """Wait for lost devices; what is still missing ([]: go on)."""
        if self.reader is None:
            return []
        # A reader that died is started again, and takes a while; a device may never come back.
        limit_s = self.reconnect_s if self.reader.alive() else START_LIMIT_S
        missing = self.reader.wait_until_there(limit_s)
        if not missing and not self.answers.alive():
            # The lines stand and the box does not answer: nothing that waiting would mend.
            return [f"{self.answers.name}: no press came through the line"]
        return missing

    def pids(self) -> dict[str, int]:
        """Role -> process id of every process beside the presenter's."""
        found = {f"emulator_{n}": emulator.pid for n, emulator in enumerate(self.emulators)}
        return found if self.reader is None else {**found, "reader": self.reader.pid}


class SessionCalibration:
    """The tracker's calibration before a session; ``record``: what came of it, None before and where there is none."""

    def __init__(self, devices: SessionDevices, display: Display, screen: ScreenGeometry) -> None:
        self._devices, self._display, self._screen = devices, display, screen
        self.record: dict[str, Any] | None = None

    def run(self, targets: TargetScreen, points: np.ndarray) -> None:
        """Calibrate as the lab file asks. Raises InputError and JobFailed as `Calibrator.run`."""
        assert self._devices.reader is not None
        assert self._devices.gaze is not None
        calibrator = Calibrator(self._devices.reader, self._devices.gaze.name, self._display, targets, self._screen)
        self.record = calibrator.run(self._devices.calibrate, points)


@contextlib.contextmanager
def emulated_devices(
    display: Display, screen: ScreenGeometry, seed: int, kind: str = "xid"
) -> Iterator[SessionDevices]:
    """A box on a pseudo-terminal and an eye tracker on LSL loopback, each in a process of its own, read by ours.

    Raises JobFailed where they cannot be reached within `START_LIMIT_S`.
    """
    with contextlib.ExitStack() as stack:
        box = box_emulator(kind)
        stack.callback(box.close)
        eyes = gaze_emulator(f"studyapp-{uuid.uuid4()}", GAZE_HZ, screen, seed)
        stack.callback(eyes.close)
        reader = DeviceReader(
            [
                DeviceSpec("box", kind, box.port, {"silence_s": EMULATOR_SILENCE_S}),
                DeviceSpec(
                    "eyes", "lsl", eyes.port, {"loopback": True, "silence_s": EMULATOR_SILENCE_S}, screen=screen
                ),
            ]
        )
        stack.callback(reader.close)
        missing = reader.wait_until_there(START_LIMIT_S)
        if missing:
            raise JobFailed(f"devices: {'; '.join(missing)}")
        gaze = reader.gaze("eyes")
        # The virtual display's clock is not the session's: there, presses are asked of the line when it gets to them.
        if display.stamp_class == "virtual":
            presses: EmulatedPresses = LeapingPresses(display.now_ns, reader, box, BUTTONS, (gaze.alive,))
        else:
            presses = EmulatedPresses(reader, box, BUTTONS, (gaze.alive,))
        yield SessionDevices(presses, gaze, reader, (box, eyes), 1.0, reader.streams)


@contextlib.contextmanager
def lab_devices(display: Display, lab: Lab, screen: ScreenGeometry) -> Iterator[SessionDevices]:
    """The lab file's box and eye tracker; the keyboard where it names no box. Raises InputError on unknown kinds and
    JobFailed where a device cannot be reached."""
    kinds = (*BOX_KINDS, *TRACKER_KINDS, "mouse")
    wrong = [device for device in lab.devices if device.kind not in kinds]
    if wrong:
        where = lab.path or "lab"
        raise InputError(*[problem(where, f"device {d.name}: kind", d.kind, " | ".join(kinds)) for d in wrong])
    specs = [
        DeviceSpec(device.name, device.kind, device.port, dict(device.options), dict(device.keys), screen)
        for device in lab.devices
    ]
    mouse = next((spec for spec in specs if spec.kind == "mouse"), None)
    if mouse is not None:
        specs.remove(mouse)
        if any(spec.kind in TRACKER_KINDS for spec in specs):
            raise InputError(problem(lab.path, f"device {mouse.name}", "beside an eye tracker", "the one or the other"))
    pointed = None if mouse is None else _mouse(display, screen)
    if not specs:
        yield SessionDevices(Keyboard(display), pointed)
        return
    reader = DeviceReader(specs)
    try:
        missing = reader.wait_until_there(START_LIMIT_S)
        if missing:
            raise JobFailed(f"devices: {'; '.join(missing)}")
        boxes = [spec for spec in specs if spec.kind in BOX_KINDS]
        trackers = [spec for spec in specs if spec.kind in TRACKER_KINDS]
        gaze = reader.gaze(trackers[0].name) if trackers else pointed
        others = (gaze.alive,) if gaze is not None else ()
        answers: AnswerDevice = Keyboard(display)
        if boxes:
            answers = BoxAnswers(reader, _buttons(boxes[0]), others)
        style = str(trackers[0].options.get("calibrate", "")) if trackers else ""
        yield SessionDevices(answers, gaze, reader, streams=reader.streams, calibrate=style)
    finally:
        reader.close()


def _mouse(display: Display, screen: ScreenGeometry) -> MouseGaze:
    """The pointer in place of the eyes, for trying things out. InputError where the display has no pointer."""
    pointer = getattr(display, "pointer", None)
    if pointer is None:
        raise InputError(problem("device", "mouse as gaze", display.description, "a window (--display glfw)"))
    return MouseGaze(pointer, screen)


def _buttons(spec: DeviceSpec) -> tuple[str, ...]:
    """The names of a box's buttons, left to right."""
    own = tuple(BYTE_BOXES[spec.kind].bits.values()) if spec.kind in BYTE_BOXES else BUTTONS
    return tuple(spec.keys.get(key, key) for key in own if key != "trigger")
