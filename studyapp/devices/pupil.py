"""Pupil Core: the network API of Pupil Capture (ZMQ requests, msgpack records; 127.0.0.1:50020)."""

from __future__ import annotations

import math
from typing import Any

import msgpack
import numpy as np
import zmq

from protocols.records import GAZE_DTYPE
from studyapp.clock import now_ns
from studyapp.devices.clock_model import ClockFit, ClockModel
from studyapp.devices.device import Batch, DeviceEvent, DeviceGone, DeviceSpec, silence_limit_s

DEFAULT_PORT = "127.0.0.1:50020"
MIN_CONFIDENCE = 0.6


def decode_gaze(topic: bytes, payload: bytes) -> tuple[float, float, float, float, float] | None:
    """(timestamp s, x, y in 0..1 from the TOP left, confidence, pupil mm or nan) of a gaze or surface datum.

    Pupil's own origin is bottom left. None where the message is no such datum: wrong msgpack, types, nan.
    """
    try:
        datum = msgpack.unpackb(payload, raw=False, strict_map_key=False)
    except (ValueError, msgpack.exceptions.UnpackException, UnicodeDecodeError, TypeError, RecursionError):
        return None
    if not isinstance(datum, dict):
        return None
    if topic.startswith(b"surfaces"):
        listed = datum.get("gaze_on_surfaces")
        datum = listed[-1] if isinstance(listed, list) and listed and isinstance(listed[-1], dict) else {}
    position = datum.get("norm_pos")
    if not isinstance(position, list | tuple) or len(position) != 2:
        return None
    numbers = [datum.get("timestamp"), *position, datum.get("confidence")]
    if not all(isinstance(n, int | float) and not isinstance(n, bool) and math.isfinite(n) for n in numbers):
        return None
    stamp, x, y, confidence = (float(n) for n in numbers)  # type: ignore[arg-type]
    return stamp, x, 1.0 - y, confidence, _pupil_mm(datum)


def _pupil_mm(datum: dict[Any, Any]) -> float:
    base = datum.get("base_data")
    if isinstance(base, list | tuple) and base and isinstance(base[0], dict):
        diameter = base[0].get("diameter_3d")
        if isinstance(diameter, int | float) and math.isfinite(diameter):
            return float(diameter)
    return math.nan


class PupilCore:
    """A `Device`. ``spec.port`` HOST:PORT of Pupil Remote; options: ``topic`` (default 'gaze.'; 'surfaces.NAME' for a
    screen marked as a surface). The clock is asked for once a second; the shortest round trips count."""

    descriptor: int | None = None

    def __init__(self, spec: DeviceSpec) -> None:
        if spec.screen is None:
            raise DeviceGone("pupil: needs the screen's size and distance (lab file: display)")
        self._spec, self._screen = spec, spec.screen
        self._address = spec.port or DEFAULT_PORT
        self._context = zmq.Context()
        self._remote = self._context.socket(zmq.REQ)
        self._data = self._context.socket(zmq.SUB)
        self._clock = ClockModel("round_trip")
        self._fit: ClockFit | None = None
        self._asked_ns = 0
        self._waiting = False
        self._malformed = 0
        try:
            self._open()
        except (zmq.ZMQError, ValueError) as error:
            self.close()
            raise DeviceGone(f"pupil {self._address}: {error}") from error
        self._last_ns = now_ns()

    def _open(self) -> None:
        for line in (self._remote, self._data):
            line.setsockopt(zmq.LINGER, 0)
        self._remote.connect(f"tcp://{self._address}")
        self._remote.send_string("SUB_PORT")
        if not self._remote.poll(300):
            self.close()
            raise DeviceGone(f"pupil {self._address}: no answer from Pupil Remote")
        port = int(self._remote.recv_string())
        host = self._address.rpartition(":")[0]
        self._data.connect(f"tcp://{host}:{port}")
        self._data.subscribe(str(self._spec.options.get("topic", "gaze.")))

    def poll(self) -> Batch:
        rows = []
        events: list[DeviceEvent] = []
        try:
            while self._data.poll(0):
                frames = self._data.recv_multipart()
                host_ns = now_ns()
                self._last_ns = host_ns
                found = decode_gaze(frames[0], frames[1]) if len(frames) == 2 else None
                if found is None:
                    self._malformed += 1
                    events.append(DeviceEvent(host_ns, "malformed", {"messages": self._malformed}))
                else:
                    rows.append((found, host_ns))
            self._ask_time()
        except (zmq.ZMQError, ValueError) as error:
            raise DeviceGone(f"pupil {self._address}: {error}") from error
        if not rows and now_ns() - self._last_ns > silence_limit_s(self._spec) * 1e9:
            raise DeviceGone(f"pupil {self._address}: silent for {(now_ns() - self._last_ns) * 1e-9:.2f} s")
        return Batch(gaze=self._samples(rows), events=tuple(events[-1:]))

    def _samples(self, rows: list[tuple[tuple[float, float, float, float, float], int]]) -> np.ndarray:
        gaze = np.zeros(len(rows), GAZE_DTYPE)
        if not rows:
            return gaze
        values = np.array([row for row, _ in rows])
        host_ns = np.array([at for _, at in rows], np.int64)
        x_dva, y_dva = self._screen.to_dva(values[:, 1], values[:, 2])
        gaze["device_s"], gaze["host_ns"] = values[:, 0], host_ns
        gaze["x_dva"], gaze["y_dva"], gaze["pupil_mm"] = x_dva, y_dva, values[:, 4]
        gaze["valid"] = (values[:, 3] >= MIN_CONFIDENCE) & (np.abs(values[:, 1:3] - 0.5) <= 1.0).all(axis=1)
        fit = self._fit
        gaze["mapped_ns"] = host_ns if fit is None else np.minimum(fit.session_ns_many(values[:, 0]), host_ns)
        return gaze

    def _ask_time(self) -> None:
        """Ask for Pupil's time, never waiting for the answer."""
        if self._waiting and self._remote.poll(0):
            answered_ns = now_ns()
            self._clock.round_trip(float(self._remote.recv_string()), self._asked_ns, answered_ns)
            self._waiting = False
            self._fit = self._clock.fit()
        elif not self._waiting and now_ns() - self._asked_ns > self._clock.ask_again_ns:
            self._asked_ns, self._waiting = now_ns(), True
            self._remote.send_string("t")

    def fit(self) -> ClockFit | None:
        return self._fit

    def close(self) -> None:
        self._remote.close(0)
        self._data.close(0)
        self._context.term()


def annotation(label: str, pupil_s: float, duration_s: float = 0.0) -> tuple[bytes, bytes]:
    """A marker for Pupil Capture's own recording: the two frames to send on its PUB port."""
    data = {"topic": "annotation", "label": label, "timestamp": pupil_s, "duration": duration_s}
    packed: bytes = msgpack.packb(data, use_bin_type=True)
    return b"annotation", packed
