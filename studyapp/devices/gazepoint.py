"""Gazepoint trackers: Open Gaze API v2, XML records over TCP (127.0.0.1:4242)."""

from __future__ import annotations

import contextlib
import math
import re
import socket
from dataclasses import dataclass
from typing import Any

import numpy as np

from studyapp.clock import now_ns
from studyapp.devices.clock_model import ClockFit, ClockModel
from studyapp.devices.device import Batch, DeviceEvent, DeviceGone, DeviceSpec, mapped_gaze, silence_limit_s
from studyapp.gaze.calibration import gazepoint_commands

DEFAULT_PORT = "127.0.0.1:4242"
ENABLED = ("COUNTER", "TIME", "TIME_TICK", "POG_BEST", "POG_LEFT", "POG_RIGHT", "PUPIL_LEFT", "USER_DATA")
LONGEST_RECORD = 8192
_TAG = re.compile(r"<(REC|ACK|NACK|CAL)\b([^<>]*?)/?>")
_ATTRIBUTE = re.compile(r'([A-Z_0-9]+)\s*=\s*"([^"<>]*)"')


@dataclass(frozen=True)
class Record:
    """One tag: ``kind`` REC | ACK | NACK | CAL, its attributes, and its text."""

    kind: str
    values: dict[str, str]
    raw: str


class RecordStream:
    """Bytes -> whole tags. Missing spaces between attributes (a known fault of the server) are read all the same; what
    fits no tag is counted in `malformed`."""

    def __init__(self) -> None:
        self._text = ""
        self.malformed = 0

    def feed(self, data: bytes) -> list[Record]:
        """The tags that ``data`` completes."""
        self._text += data.decode("latin-1")
        *lines, self._text = re.split(r"\r\n|\n|\r", self._text)
        if len(self._text) > LONGEST_RECORD:
            self.malformed += len(self._text)
            self._text = ""
        records = []
        for line in lines:
            found = list(_TAG.finditer(line))
            records += [Record(tag[1], dict(_ATTRIBUTE.findall(tag[2])), tag[0]) for tag in found]
            self.malformed += len(line) - sum(len(tag[0]) for tag in found)
        return records


def number(values: dict[str, str], key: str) -> float | None:
    """A finite number, or None."""
    try:
        value = float(values[key])
    except (KeyError, ValueError):
        return None
    return value if math.isfinite(value) else None


def calibration_news(values: dict[str, str]) -> dict[str, Any] | None:
    """A CAL record as an answer of `device.Calibrates`: the next target, or how many targets were calibrated for each
    eye (LVn, RVn) and how far gaze then lay from them on average, in shares of the screen; None: a step in between."""
    if values.get("ID") == "CALIB_START_PT":
        x, y = number(values, "CALX"), number(values, "CALY")
        return None if x is None or y is None else {"target": [x, y]}
    if values.get("ID") != "CALIB_RESULT":
        return None
    found: dict[str, Any] = {"targets": sum(re.fullmatch(r"CALX\d+", key) is not None for key in values)}
    for eye, name in (("L", "left"), ("R", "right")):
        good = [key[2:] for key, value in values.items() if re.fullmatch(rf"{eye}V\d+", key) and value == "1"]
        found[f"{name}_valid"] = len(good)
        away = []
        for n in good:
            at = [number(values, key + n) for key in (f"{eye}X", f"{eye}Y", "CALX", "CALY")]
            if None not in at:
                away.append(math.hypot(at[0] - at[2], at[1] - at[3]))  # type: ignore[operator]
        found[f"{name}_error"] = sum(away) / len(away) if away else None
    if not max(found["left_valid"], found["right_valid"]):
        return {"failed": "no target was seen"}
    return {"result": found}


class Gazepoint:
    """A `Device`. ``spec.port`` HOST:PORT (default 127.0.0.1:4242); the lab file must give the screen.

    Gaze is the best point of both eyes (BPOGX, BPOGY: 0..1 from the top left). Stamps are TIME_TICK over the frequency
    the server names; without it, TIME.
    """

    def __init__(self, spec: DeviceSpec) -> None:
        if spec.screen is None:
            raise DeviceGone("gazepoint: needs the screen's size and distance (lab file: display)")
        self._spec, self._screen = spec, spec.screen
        host, _, port = (spec.port or DEFAULT_PORT).rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=0.3)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.sendall(b'<GET ID="TIME_TICK_FREQUENCY" />\r\n')
            for name in ENABLED:
                self._socket.sendall(f'<SET ID="ENABLE_SEND_{name}" STATE="1" />\r\n'.encode())
            self._socket.sendall(b'<SET ID="ENABLE_SEND_DATA" STATE="1" />\r\n')
            self._socket.setblocking(False)
        except (OSError, ValueError) as error:
            raise DeviceGone(f"gazepoint {spec.port or DEFAULT_PORT}: {error}") from error
        self.descriptor: int | None = self._socket.fileno()
        self._records = RecordStream()
        self._tick_hz: float | None = None
        self._clock = ClockModel("one_sided")
        self._fit: ClockFit | None = None
        self._fitted_ns = 0
        self._last_ns = now_ns()
        self._malformed = 0

    def poll(self) -> Batch:
        try:
            data = self._socket.recv(65536)
        except BlockingIOError:
            data = None
        except OSError as error:
            raise DeviceGone(f"gazepoint {self._spec.port}: the line was cut ({error})") from error
        host_ns = now_ns()
        if data == b"":
            raise DeviceGone(f"gazepoint {self._spec.port}: the server closed the line")
        if data is None:
            if host_ns - self._last_ns > silence_limit_s(self._spec) * 1e9:
                raise DeviceGone(f"gazepoint {self._spec.port}: silent for {(host_ns - self._last_ns) * 1e-9:.2f} s")
            return Batch()
        rows, events, news = [], [], []
        for record in self._records.feed(data):
            if record.kind == "REC":
                row = self._sample(record.values, host_ns)
                if row is not None:
                    rows.append(row)
                if record.values.get("USER"):
                    events.append(DeviceEvent(host_ns, "marker", {"user": record.values["USER"][:60]}))
            elif record.values.get("ID") == "TIME_TICK_FREQUENCY":
                self._tick_hz = number(record.values, "FREQ") or self._tick_hz
            elif record.kind in ("NACK", "CAL"):
                events.append(DeviceEvent(host_ns, record.kind.lower(), {"text": record.raw[:100]}))
                if record.kind == "CAL" and (said := calibration_news(record.values)) is not None:
                    news.append(said)
        if self._records.malformed > self._malformed:
            events.append(DeviceEvent(host_ns, "malformed", {"bytes": self._records.malformed - self._malformed}))
            self._malformed = self._records.malformed
        self._last_ns = host_ns
        if self._fit is None or host_ns - self._fitted_ns > 1e9:
            self._fit, self._fitted_ns = self._clock.fit(), host_ns
        return Batch(gaze=mapped_gaze(rows, self._fit), events=tuple(events), news=tuple(news))

    def _sample(self, values: dict[str, str], host_ns: int) -> tuple[float, ...] | None:
        """One row; None where the record has neither stamp nor point."""
        tick = number(values, "TIME_TICK")
        device_s = tick / self._tick_hz if tick is not None and self._tick_hz else number(values, "TIME")
        x, y = number(values, "BPOGX"), number(values, "BPOGY")
        if device_s is None or x is None or y is None:
            return None
        x_dva, y_dva = self._screen.to_dva(np.float64(x), np.float64(y))
        valid = values.get("BPOGV") == "1" and -0.5 <= x <= 1.5 and -0.5 <= y <= 1.5
        self._clock.arrival(device_s, host_ns)
        diameter_m = number(values, "LPUPILD")
        pupil_mm = diameter_m * 1e3 if diameter_m is not None else math.nan
        return (device_s, host_ns, 0, float(x_dva), float(y_dva), pupil_mm, valid, 0)

    def calibrate(self, step: str, points: np.ndarray) -> dict[str, Any] | None:
        """Device-paced (see `studyapp.gaze.calibrate`): the server goes through the points by itself, and says each;
        its own window stays hidden, since the session shows the targets."""
        lines = gazepoint_commands(points) if step == "begin" else [b'<SET ID="CALIBRATE_START" STATE="0" />\r\n']
        try:
            self._socket.sendall(b"".join(lines))
        except OSError as error:
            raise DeviceGone(f"gazepoint {self._spec.port}: the line was cut ({error})") from error
        return {"paced": "device"} if step == "begin" else None

    def fit(self) -> ClockFit | None:
        return self._fit

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.close()
