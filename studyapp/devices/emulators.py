"""Device emulators: what the program talks to where no hardware is attached, over the same lines as hardware.

A box emulator holds the other end of a pseudo-terminal and speaks its kind's bytes; a gaze emulator is an LSL outlet on
loopback. Each runs in a process of its own and is told what to do through a pipe; killing it cuts the line.
(Gazepoint and Pupil Core: `tracker_emulators`.)
"""

from __future__ import annotations

import os
import select
import struct
import tty
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from studyapp.clock import now_ns
from studyapp.devices.decoders import BYTE_BOXES, byte_ns, xid_packet
from studyapp.gaze.angles import ScreenGeometry
from studyapp.ring import leave_interrupts_to_the_session, spawn_context

HOLD_NS = 60_000_000  # how long a simulated finger stays down


class BoxFirmware:
    """The inside of a box: commands in, bytes out, and its own clock that runs ``drift_ppm`` fast."""

    def __init__(self, kind: str, model: str = "rb-730", drift_ppm: float = 0.0) -> None:
        self._kind, self._model, self._rate = kind, model, 1 + drift_ppm * 1e-6
        self._zero_s = 0.0
        self._state = 0
        self._command = b""

    def device_s(self, t_s: float) -> float:
        """What the box's clock says at host time ``t_s``."""
        return (t_s - self._zero_s) * self._rate

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Answer what the host sent (Cedrus commands; other boxes ignore everything)."""
        if self._kind != "xid":
            return b""
        answers = {b"_c1": b"_xid0", b"_d1": b"Cedrus RB", b"_d2": b"2", b"_d3": b"2", b"_d4": b"2", b"_d5": b"1"}
        out = b""
        for value in data:
            self._command += bytes([value])
            if self._command in answers:
                out += answers[self._command]
            elif self._command == b"_e5":
                out += struct.pack("<3sI", b"_e5", int(self.device_s(t_s) * 1000) & 0xFFFFFFFF)
            elif self._command == b"e5":
                self._zero_s = t_s
            elif len(self._command) < 3 and self._command[:1] in (b"_", b"e"):
                continue
            self._command = b""
        return out

    def key(self, key: str, pressed: bool, t_s: float) -> bytes:
        """The bytes for a key that goes down or up at host time ``t_s``."""
        if self._kind == "xid":
            # The box counts whole milliseconds.
            return xid_packet(key, pressed, int(self.device_s(t_s) * 1000) / 1000, self._model)
        if self._kind in BYTE_BOXES:
            box = BYTE_BOXES[self._kind]
            mask = next(mask for mask, name in box.bits.items() if name == key)
            if box.momentary:
                return bytes([mask]) if pressed else b""
            self._state = self._state | mask if pressed else self._state & ~mask
            return bytes([self._state])
        stamp_us = round(self.device_s(t_s) * 1e6)
        if self._kind == "tpad":
            return f"A {'P' if pressed else 'R'} {key} {stamp_us // 1000}\r\n".encode()
        return f"{stamp_us}:{key}{'' if pressed else '-'}\n".encode()


def emulate_box(pipe: Connection, kind: str, model: str, drift_ppm: float) -> None:
    """The process of a box on a pseudo-terminal. Told ('press', key, at_ns), ('noise', bytes) or ('flood', hz, s); says
    ('port', name) at first and ('pressed', key, ns) after each. A byte box's byte takes as long as on a real line."""
    leave_interrupts_to_the_session()
    master, slave = os.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    pipe.send(("port", os.ttyname(slave)))
    firmware = BoxFirmware(kind, model, drift_ppm)
    due: list[tuple[int, str, bool]] = []
    down: set[str] = set()
    on_its_way_ns = byte_ns(BYTE_BOXES[kind].baud) if kind in BYTE_BOXES else 0
    told = True  # a flood's presses are not reported one by one: nobody reads so many
    try:
        while True:
            wait_s = max(0.0, (due[0][0] - now_ns()) * 1e-9) if due else 1.0
            ready, _, _ = select.select([master, pipe.fileno()], [], [], wait_s)
            if master in ready:
                answer = firmware.receive(os.read(master, 4096), now_ns() * 1e-9)
                if answer:
                    os.write(master, answer)
            while due and due[0][0] <= now_ns():
                _, key, pressed = due.pop(0)
                written_ns = now_ns()
                # Shorter than the system's shortest sleep.
                while now_ns() < written_ns + on_its_way_ns:
                    pass
                # A key that goes down again comes up first; one that is up already stays so.
                if key in down:
                    down.discard(key)
                    os.write(master, firmware.key(key, False, written_ns * 1e-9))
                if pressed:
                    down.add(key)
                    os.write(master, firmware.key(key, True, written_ns * 1e-9))
                    if told:
                        pipe.send(("pressed", key, written_ns))
            while pipe.poll():
                message = pipe.recv()
                if message[0] == "noise":
                    os.write(master, message[1])
                elif message[0] == "forget":
                    due = [(at_ns, key, pressed) for at_ns, key, pressed in due if not pressed and key in down]
                elif message[0] == "flood":
                    start_ns, step_ns, told = now_ns(), 1e9 / message[1], False
                    edges = int(message[1] * message[2])
                    due += [(start_ns + int(n * step_ns), str(1 + n // 2 % 4), n % 2 == 0) for n in range(edges)]
                else:
                    _, key, at_ns = message
                    due += [(at_ns, key, True), (at_ns + HOLD_NS, key, False)]
                    due.sort()
    except (EOFError, OSError):
        return  # the session is over


def emulate_gaze(pipe: Connection, source_id: str, rate_hz: float, screen: ScreenGeometry, seed: int) -> None:
    """The process of an eye tracker on LSL. Told ('look', x_dva, y_dva), ('step', x_dva, y_dva, at_ns) or ('blink',
    seconds); looks at the centre at first, with 0.1 degrees of noise. Says ('port', source_id) once it is up."""
    leave_interrupts_to_the_session()
    from studyapp.devices.lsl import keep_to_this_machine, outlet_of_gaze

    keep_to_this_machine()
    import pylsl

    outlet = outlet_of_gaze(source_id, rate_hz)
    rng = np.random.default_rng(seed)
    pipe.send(("port", source_id))
    target, blink_until_ns = (0.0, 0.0), 0
    step: tuple[float, float, int] | None = None
    start_ns, sent = now_ns(), 0
    offset_s = pylsl.local_clock() - now_ns() * 1e-9
    try:
        while True:
            select.select([pipe.fileno()], [], [], 0.004)
            while pipe.poll():
                message = pipe.recv()
                if message[0] == "blink":
                    blink_until_ns = now_ns() + int(message[1] * 1e9)
                elif message[0] == "count":
                    pipe.send(("sent", sent))
                elif message[0] == "step":
                    step = message[1:]
                else:
                    target = (message[1], message[2])
            n = int((now_ns() - start_ns) * 1e-9 * rate_hz) - sent
            if n <= 0:
                continue
            taken_ns = start_ns + (sent + 1 + np.arange(n)) / rate_hz * 1e9
            targets = np.full((n, 2), target)
            if step is not None:
                targets[taken_ns >= step[2]] = step[:2]
                target, step = (step[:2], None) if taken_ns[-1] >= step[2] else (target, step)
            noisy = rng.normal(targets, 0.1)
            x, y = screen.from_dva(noisy[:, 0], noisy[:, 1])
            confidence = np.full(n, 0.0 if now_ns() < blink_until_ns else 0.95)
            block = np.column_stack([x, y, confidence, rng.normal(3.5, 0.05, n)])
            sent += n
            # liblsl counts back from the newest sample's stamp by the nominal rate.
            outlet.push_chunk(block, start_ns * 1e-9 + sent / rate_hz + offset_s)
    except (EOFError, OSError):
        return  # the session is over


class Emulator:
    """An emulator's process, seen from the session. ``port``: what the device reader opens."""

    def __init__(self, target: Callable[..., None], arguments: tuple[Any, ...], name: str) -> None:
        context = spawn_context()
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=target, args=(theirs, *arguments), name=name, daemon=True)
        self._process.start()
        theirs.close()
        self.port = str(self._receive(30.0)[1])

    def _receive(self, limit_s: float) -> tuple[Any, ...]:
        if not self._pipe.poll(limit_s):
            raise TimeoutError(f"{self._process.name}: no word in {limit_s:g} s")
        message: tuple[Any, ...] = self._pipe.recv()
        return message

    @property
    def pid(self) -> int:
        """The emulator's process id."""
        return int(self._process.pid or 0)

    def alive(self) -> bool:
        """Is the process there?"""
        return self._process.is_alive()

    def tell(self, *message: Any) -> None:
        """A command of the emulator's own; a dead emulator hears nothing."""
        try:
            self._pipe.send(message)
        except OSError:
            self._process.join(0.0)

    def step_to(self, x_dva: float, at_ns: int) -> None:
        """An emulated eye looks so far to the right of the centre from session time ``at_ns`` on."""
        self.tell("step", x_dva, 0.0, at_ns)

    def heard(self) -> list[tuple[Any, ...]]:
        """What it said since the last call."""
        said = []
        try:
            while self._pipe.poll():
                said.append(self._pipe.recv())
        except (EOFError, OSError):
            self._process.join(0.0)
        return said

    def close(self) -> None:
        """End the process. Twice is harmless."""
        if not self._pipe.closed:
            self._pipe.close()
            self._process.join(2.0)
            if self._process.is_alive():
                self._process.kill()
                self._process.join(2.0)


def box_emulator(kind: str = "xid", model: str = "rb-730", drift_ppm: float = 0.0) -> Emulator:
    """A response box on a pseudo-terminal of its own."""
    return Emulator(emulate_box, (kind, model, drift_ppm), "box emulator")


def gaze_emulator(source_id: str, rate_hz: float, screen: ScreenGeometry, seed: int = 0) -> Emulator:
    """An eye tracker as an LSL stream on loopback."""
    return Emulator(emulate_gaze, (source_id, rate_hz, screen, seed), "gaze emulator")
