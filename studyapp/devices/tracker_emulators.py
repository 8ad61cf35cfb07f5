"""Emulated Gazepoint and Pupil Core servers on loopback, each in a process of its own (see `emulators`)."""

from __future__ import annotations

import contextlib
import select
import socket
from multiprocessing.connection import Connection
from typing import Any

import msgpack
import numpy as np
import zmq

from studyapp.clock import now_ns
from studyapp.devices.emulators import Emulator
from studyapp.gaze.angles import ScreenGeometry
from studyapp.ring import leave_interrupts_to_the_session

TICK_HZ = 10_000_000


def emulate_gazepoint(pipe: Connection, rate_hz: float, screen: ScreenGeometry, drift_ppm: float, seed: int) -> None:
    """A server of Open Gaze records. Told ('look', x_dva, y_dva), ('blink', on), ('raw', bytes)."""
    leave_interrupts_to_the_session()
    server = socket.create_server(("127.0.0.1", 0))
    pipe.send(("port", f"127.0.0.1:{server.getsockname()[1]}"))
    rng = np.random.default_rng(seed)
    target, shut, line, sending, sent = (0.0, 0.0), False, None, False, 0
    start_ns = now_ns()
    commands = b""
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
                    elif b"ENABLE_SEND_DATA" in command:
                        sending, sent = True, int((now_ns() - start_ns) * 1e-9 * rate_hz)
                if not data:
                    line = None
            while pipe.poll():
                message = pipe.recv()
                if message[0] == "look":
                    target = (message[1], message[2])
                elif message[0] == "blink":
                    shut = bool(message[1])
                elif message[0] == "raw" and line is not None:
                    line.sendall(message[1])
            while line is not None and sending and sent < int((now_ns() - start_ns) * 1e-9 * rate_hz):
                sent += 1
                noisy = rng.normal(target, 0.1)
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
    """Pupil Remote and its data port. Told ('look', x_dva, y_dva), ('blink', on), ('raw', topic, bytes)."""
    leave_interrupts_to_the_session()
    context = zmq.Context()
    remote, data = context.socket(zmq.REP), context.socket(zmq.PUB)
    remote_port, data_port = remote.bind_to_random_port("tcp://127.0.0.1"), data.bind_to_random_port("tcp://127.0.0.1")
    pipe.send(("port", f"127.0.0.1:{remote_port}"))
    rng = np.random.default_rng(seed)
    target, shut, sent = (0.0, 0.0), False, 0
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
                elif message[0] == "blink":
                    shut = bool(message[1])
                else:
                    data.send_multipart([message[1], message[2]])
            while sent < int((now_ns() - start_ns) * 1e-9 * rate_hz):
                sent += 1
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
