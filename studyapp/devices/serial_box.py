"""A response box on a serial line (pyserial): bytes in, presses out, with the box's own clock where it has one."""

from __future__ import annotations

import contextlib
from pathlib import Path

import serial
from serial.tools import list_ports

from studyapp.clock import now_ns
from studyapp.devices import cedrus_xid
from studyapp.devices.clock_model import ClockFit, ClockModel
from studyapp.devices.decoders import BYTE_BOXES, LINE_BOXES, Decoder, XidDecoder, byte_ns, decoder_for
from studyapp.devices.device import Batch, DeviceEvent, DeviceGone, DeviceSpec, silence_limit_s
from studyapp.seams import Press

HALF_MS_S = 0.0005  # boxes cut their stamps to whole milliseconds


class SerialBox:
    """An open box. ``spec.kind``: a kind of `decoders.BOX_KINDS`; options: ``model`` (Cedrus), ``baud``.

    Raises DeviceGone where the port cannot be opened or a Cedrus box does not answer.
    """

    def __init__(self, spec: DeviceSpec) -> None:
        self._spec = spec
        self._decoder: Decoder = decoder_for(spec.kind, str(spec.options.get("model", "rb-730")))
        self._clock: ClockModel | None = None
        self._fit: ClockFit | None = None
        self._asked_ns = 0
        self._answered_ns = 0
        self._malformed = 0
        self._baud = int(spec.options.get("baud", _default_baud(spec.kind)))
        self._start_stop = BYTE_BOXES.get(spec.kind)
        # Boxes without a clock: 0.09 ms at 115200 baud, 0.52 ms at 19200.
        self._on_its_way_ns = 0 if self._start_stop is None else byte_ns(self._baud)
        try:
            write_limit_s = max(0.5, silence_limit_s(spec))
            self._line = serial.Serial(spec.port, self._baud, timeout=0, write_timeout=write_limit_s)
        except (serial.SerialException, OSError, ValueError) as error:
            raise DeviceGone(f"{spec.port}: cannot be opened ({error})") from error
        self.descriptor: int | None = self._line.fileno()
        self._warnings = latency_warning(spec.port)
        try:
            self._prepare()
        except (serial.SerialException, OSError) as error:
            self.close()
            raise DeviceGone(f"{spec.port}: went away while it was set up ({error})") from error

    def _prepare(self) -> None:
        # Pseudo-terminals and some drivers do not know the request; then the kernel's own latency stays.
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            self._line.set_low_latency_mode(True)
        if self._start_stop is not None and self._start_stop.start:
            self._line.write(self._start_stop.start)
        if isinstance(self._decoder, XidDecoder):
            identity = cedrus_xid.identify(self._line)
            if identity is None:
                self.close()
                raise DeviceGone(f"{self._spec.port}: no Cedrus XID answer at {self._baud} baud")
            self._decoder.timer_reset(cedrus_xid.reset_timer(self._line) * 1e-9)
            self._clock = ClockModel("round_trip" if identity.has_timer_query else "one_sided")
            self._query = identity.has_timer_query
            self._warnings = (*self._warnings, f"Cedrus XID {identity.text}")
        elif self._spec.kind in LINE_BOXES:
            self._clock = ClockModel("one_sided")
            self._query = False
        else:
            self._query = False
        self._answered_ns = now_ns()

    def poll(self) -> Batch:
        try:
            data = self._line.read(4096)
            host_ns = now_ns()
        except (serial.SerialException, OSError, TypeError) as error:  # TypeError: pyserial on a vanished handle
            raise DeviceGone(f"{self._spec.port}: the line was cut ({error})") from error
        events = [DeviceEvent(host_ns, "info", {"text": text}) for text in self._warnings]
        self._warnings = ()
        presses = []
        for change in self._decoder.feed(data, host_ns * 1e-9) if data else ():
            mapped_ns = self._mapped(change.device_s, host_ns)
            key = self._spec.keys.get(change.key, change.key)
            payload = {"key": key, "device_s": change.device_s, "mapped_ns": mapped_ns}
            events.append(DeviceEvent(host_ns, "press" if change.pressed else "release", payload, change.raw))
            if change.pressed:
                presses.append(Press(key, host_ns, mapped_ns, self._spec.name, change.device_s, change.raw))
        self._take_timer_answers(host_ns)
        if self._query:
            self._ask(host_ns)
        if self._decoder.malformed > self._malformed:
            events.append(DeviceEvent(host_ns, "malformed", {"bytes": self._decoder.malformed - self._malformed}, data))
            self._malformed = self._decoder.malformed
        return Batch(tuple(presses), events=tuple(events))

    def _mapped(self, device_s: float | None, host_ns: int) -> int:
        if device_s is None or self._clock is None:
            return host_ns - self._on_its_way_ns
        if not self._query:
            self._clock.arrival(device_s, host_ns)
            self._fit = self._clock.fit()
        if self._fit is None:
            return host_ns
        half = HALF_MS_S if isinstance(self._decoder, XidDecoder) else 0.0
        return min(self._fit.session_ns(device_s + half), host_ns)

    def _ask(self, host_ns: int) -> None:
        """Ask a Cedrus box for its time ten times a second: its clock, and whether it is still there."""
        assert isinstance(self._decoder, XidDecoder)
        if self._asked_ns > self._answered_ns:
            if host_ns - self._asked_ns > silence_limit_s(self._spec) * 1e9 / 2:
                raise DeviceGone(f"{self._spec.port}: the box stopped answering")
        elif host_ns - self._asked_ns >= 1e8:
            self._asked_ns = now_ns()
            self._decoder.timer_queried()
            try:
                self._line.write(b"_e5")
            except (serial.SerialException, OSError) as error:
                raise DeviceGone(f"{self._spec.port}: the line was cut ({error})") from error

    def _take_timer_answers(self, host_ns: int) -> None:
        if not self._query or not isinstance(self._decoder, XidDecoder) or not self._decoder.timer_answers:
            return
        for device_s, _ in self._decoder.timer_answers:
            assert self._clock is not None
            self._clock.round_trip(device_s + HALF_MS_S, self._asked_ns, host_ns)
        self._decoder.timer_answers.clear()
        self._answered_ns = host_ns
        self._fit = self._clock.fit() if self._clock is not None else None

    def fit(self) -> ClockFit | None:
        return self._fit

    def close(self) -> None:
        with contextlib.suppress(serial.SerialException, OSError):
            if self._start_stop is not None and self._start_stop.stop:
                self._line.write(self._start_stop.stop)
            self._line.close()


def _default_baud(kind: str) -> int:
    if kind in BYTE_BOXES:
        return BYTE_BOXES[kind].baud
    return LINE_BOXES[kind].baud if kind in LINE_BOXES else 115200


def latency_warning(port: str) -> tuple[str, ...]:
    """One sentence where the FTDI driver holds bytes back for more than 1 ms (Linux tells in sysfs)."""
    timer = Path("/sys/class/tty") / Path(port).name / "device" / "latency_timer"
    with contextlib.suppress(OSError, ValueError):
        milliseconds = int(timer.read_text())
        if milliseconds > 1:
            return (f"{port}: FTDI latency timer: got {milliseconds} ms, wanted 1 (echo 1 > {timer})",)
    return ()


def attached_ports() -> list[tuple[str, str]]:
    """(port, description) of every serial port the system names."""
    return [(port.device, port.description) for port in sorted(list_ports.comports())]
