"""Emulated Gazepoint and Pupil Core servers on loopback, each in a process of its own (see `emulators`)."""

from __future__ import annotations

import contextlib
import re
import select
import socket
from multiprocessing.connection import Connection
from typing import Any

import msgpack
import numpy as np
import zmq

from studyapp.clock import now_ns
from studyapp.devices.emulators import Emulator
from studyapp.gaze.angles import ScreenGeometry, separation_dva
from studyapp.ring import leave_interrupts_to_the_session

TICK_HZ = 10_000_000


class _Calibration:
    """The server's side of a calibration."""

    def __init__(self, screen: ScreenGeometry) -> None:
        self._screen = screen
        self._points: list[tuple[float, float]] = []
        self._seen: list[bool] = []
        self._point_s, self._next_ns, self._running, self._shown = 1.0, 0, False, -1
        self.good = False

    def told(self, command: bytes) -> None:
        """One CALIBRATE_ command."""
        values = dict(re.findall(r'(\w+)="([^"]*)"', command.decode("latin-1")))
        match values.get("ID"):
            case "CALIBRATE_CLEAR":
                self._points.clear()
            case "CALIBRATE_ADDPOINT":
                self._points.append((float(values["X"]), float(values["Y"])))
            case "CALIBRATE_TIMEOUT":
                self._point_s = float(values["VALUE"])
            case "CALIBRATE_START":
                self._running, self._next_ns, self.good = values["STATE"] == "1", now_ns(), False
                self._seen.clear()
                self._shown = -1

    def step(self, look: tuple[float, float], shut: bool) -> bytes:
        """What the server says now."""
        if not self._running or now_ns() < self._next_ns:
            return b""
        if self._shown >= 0:
            at = self._screen.to_dva(*self._points[self._shown])
            self._seen.append(not shut and bool(separation_dva(*at, *look) < 3.0))
        self._shown += 1
        self._next_ns = now_ns() + int(self._point_s * 1e9)
        if self._shown < len(self._points):
            x, y = self._points[self._shown]
            text = f'<CAL ID="CALIB_START_PT" PT="{self._shown + 1}" CALX="{x:.5f}" CALY="{y:.5f}" />'
            return text.encode() + b"\r\n"
        self._running, self.good = False, any(self._seen)
        said = ['<CAL ID="CALIB_RESULT"']
        for n, ((x, y), seen) in enumerate(zip(self._points, self._seen, strict=True), 1):
            valid = int(seen)
            said.append(f'CALX{n}="{x:.5f}" CALY{n}="{y:.5f}" LX{n}="{x + 0.01:.5f}" LY{n}="{y:.5f}" LV{n}="{valid}"')
            said.append(f'RX{n}="{x:.5f}" RY{n}="{y:.5f}" RV{n}="{valid}"')
        return " ".join([*said, "/>"]).encode() + b"\r\n"


def emulate_gazepoint(pipe: Connection, rate_hz: float, screen: ScreenGeometry, drift_ppm: float, seed: int) -> None:
    """A server of Open Gaze records. Told ('look', x_dva, y_dva), ('step', x_dva, y_dva, at_ns), ('blink', on), ('raw',
    bytes), ('skew', x_dva, y_dva): gaze is off by so much until it is calibrated. It calibrates as the server does:
    each point in its turn, then the result; a point at which the eye does not look within 3 degrees (skew apart) is
    not valid."""
    leave_interrupts_to_the_session()
    server = socket.create_server(("127.0.0.1", 0))
    pipe.send(("port", f"127.0.0.1:{server.getsockname()[1]}"))
    rng = np.random.default_rng(seed)
    target, shut, line, sending, sent = (0.0, 0.0), False, None, False, 0
    start_ns = now_ns()
    commands = b""
    skew, calibration = (0.0, 0.0), _Calibration(screen)
    step: tuple[float, float, int] | None = None
    try:
        while True:
            waiting: list[Any] = [pipe.fileno(), server, *([line] if line else [])]
            ready, _, _ = select.select(waiting, [], [], 0.002)
            if server in ready:
                line, _ = server.accept()
                commands, sending = b"", False
            if line is not None and line in ready:
                data = line.recv(4096)
                commands += data
                *whole, commands = commands.split(b"\r\n")
                for command in whole:
                    if b"TIME_TICK_FREQUENCY" in command:
                        line.sendall(f'<ACK ID="TIME_TICK_FREQUENCY" FREQ="{TICK_HZ}" />\r\n'.encode())
                    elif b"CALIBRATE_" in command:
                        calibration.told(command)
                    elif b"ENABLE_SEND_DATA" in command:
                        sending, sent = True, int((now_ns() - start_ns) * 1e-9 * rate_hz)
                if not data:
                    line = None
            while pipe.poll():
                message = pipe.recv()
                if message[0] == "look":
                    target = (message[1], message[2])
                elif message[0] == "step":
                    step = message[1:]
                elif message[0] == "blink":
                    shut = bool(message[1])
                elif message[0] == "skew":
                    skew = (message[1], message[2])
                elif message[0] == "raw" and line is not None:
                    line.sendall(message[1])
            if line is not None:
                line.sendall(calibration.step(target, shut))
                skew = (0.0, 0.0) if calibration.good else skew
            while line is not None and sending and sent < int((now_ns() - start_ns) * 1e-9 * rate_hz):
                sent += 1
                if step is not None and start_ns + sent / rate_hz * 1e9 >= step[2]:
                    target, step = step[:2], None
                noisy = rng.normal(target, 0.1) + skew
                x, y = screen.from_dva(noisy[0], noisy[1])
                device_s = sent / rate_hz * (1 + drift_ppm * 1e-6)
                # Every fifth record lacks a space between two attributes, as the real server's sometimes do.
                gap = "" if sent % 5 == 0 else " "
                with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                    line.sendall(
                        f'<REC CNT="{sent}" TIME="{device_s:.5f}"{gap}TIME_TICK="{round(device_s * TICK_HZ)}" '
                        f'BPOGX="{x:.5f}" BPOGY="{y:.5f}" BPOGV="{0 if shut else 1}" LPUPILD="0.00350" />\r\n'.encode()
                    )
    except (EOFError, OSError):
        return  # the session is over


def emulate_pupil(pipe: Connection, rate_hz: float, screen: ScreenGeometry, drift_ppm: float, seed: int) -> None:
    """Pupil Remote and its data port. Told ('look', x_dva, y_dva), ('step', x_dva, y_dva, at_ns), ('blink', on),
    ('raw', topic, bytes)."""
    leave_interrupts_to_the_session()
    context = zmq.Context()
    remote, data = context.socket(zmq.REP), context.socket(zmq.PUB)
    remote_port, data_port = remote.bind_to_random_port("tcp://127.0.0.1"), data.bind_to_random_port("tcp://127.0.0.1")
    pipe.send(("port", f"127.0.0.1:{remote_port}"))
    rng = np.random.default_rng(seed)
    target, shut, sent = (0.0, 0.0), False, 0
    step: tuple[float, float, int] | None = None
    start_ns = now_ns()

    def pupil_s() -> float:
        return (now_ns() - start_ns) * 1e-9 * (1 + drift_ppm * 1e-6)

    try:
        while True:
            select.select([pipe.fileno()], [], [], 0.002)
            while remote.poll(0):
                asked = remote.recv_string()
                remote.send_string(str(data_port) if asked == "SUB_PORT" else f"{pupil_s():.9f}")
            while pipe.poll():
                message = pipe.recv()
                if message[0] == "look":
                    target = (message[1], message[2])
                elif message[0] == "step":
                    step = message[1:]
                elif message[0] == "blink":
                    shut = bool(message[1])
                else:
                    data.send_multipart([message[1], message[2]])
            while sent < int((now_ns() - start_ns) * 1e-9 * rate_hz):
                sent += 1
                if step is not None and start_ns + sent / rate_hz * 1e9 >= step[2]:
                    target, step = step[:2], None
                noisy = rng.normal(target, 0.1)
                x, y = screen.from_dva(noisy[0], noisy[1])
                datum = {
                    "topic": "gaze.3d.01.", "norm_pos": [float(x), 1.0 - float(y)],
                    "confidence": 0.1 if shut else 0.98,
                    "timestamp": sent / rate_hz * (1 + drift_ppm * 1e-6), "base_data": [{"diameter_3d": 3.4}],
                }  # fmt: skip
                data.send_multipart([b"gaze.3d.01.", msgpack.packb(datum, use_bin_type=True)])
    except (EOFError, OSError):
        return  # the session is over
    finally:
        context.destroy(0)


def gazepoint_emulator(rate_hz: float, screen: ScreenGeometry, drift_ppm: float = 0.0, seed: int = 0) -> Emulator:
    """A Gazepoint server; ``port`` is HOST:PORT."""
    return Emulator(emulate_gazepoint, (rate_hz, screen, drift_ppm, seed), "gazepoint emulator")


def pupil_emulator(rate_hz: float, screen: ScreenGeometry, drift_ppm: float = 0.0, seed: int = 0) -> Emulator:
    """A Pupil Capture; ``port`` is HOST:PORT of its remote."""
    return Emulator(emulate_pupil, (rate_hz, screen, drift_ppm, seed), "pupil emulator")
