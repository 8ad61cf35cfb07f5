"""Cedrus XID boxes: finding, identifying and setting their timer. (Packets: `decoders.XidDecoder`.)"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass

import serial

from studyapp.clock import now_ns

BAUD_RATES = (115200, 19200, 9600, 57600, 38400)  # in the order in which boxes are likely
_PRODUCTS = {"0": "Lumina", "1": "SV-1", "2": "RB", "4": "c-pod", "5": "Riponda", "S": "StimTracker"}
_RB_MODELS = {"1": "rb-530", "2": "rb-730", "3": "rb-830", "4": "rb-834"}


@dataclass(frozen=True)
class XidIdentity:
    """What a box says of itself. ``model``: a key map of `decoders`; XID 2 boxes answer queries for their timer."""

    product: str
    model: str
    major: int
    minor: int

    @property
    def has_timer_query(self) -> bool:
        return self.major >= 2

    @property
    def text(self) -> str:
        return f"{self.product} {self.model}, firmware {self.major}.{self.minor}"


def _ask(line: serial.Serial, command: bytes, length: int, limit_s: float = 0.3) -> bytes:
    """Send ``command``; up to ``length`` bytes of answer. XID 1 boxes want 1 ms between bytes."""
    for value in command:
        line.write(bytes([value]))
        time.sleep(0.001)
    answer = b""
    deadline_ns = now_ns() + int(limit_s * 1e9)
    while len(answer) < length and now_ns() < deadline_ns:
        answer += line.read(length - len(answer))
        if len(answer) < length:
            time.sleep(0.001)
    return answer


def identify(line: serial.Serial) -> XidIdentity | None:
    """Who answers on an open line; None where it is no XID box."""
    line.reset_input_buffer()
    answer = _ask(line, b"_c1", 5)
    if not answer.startswith(b"_xid"):
        return None
    if answer != b"_xid0":
        _ask(line, b"c10", 5)
        line.reset_input_buffer()
    details = [_ask(line, command, 1).decode("ascii", "replace") for command in (b"_d2", b"_d3", b"_d4", b"_d5")]
    product, model, major, minor = details
    if not (major.isdigit() and minor.isalnum()):
        return None
    name = "lumina" if product == "0" else _RB_MODELS.get(model, "rb-730")
    return XidIdentity(_PRODUCTS.get(product, product), name, int(major), int(minor) if minor.isdigit() else 0)


def reset_timer(line: serial.Serial) -> int:
    """Set the response timer to 0; session ns of the middle of the shortest of five tries."""
    best = (2**62, 0)
    for _ in range(5):
        before_ns = now_ns()
        line.write(b"e5")
        line.flush()
        after_ns = now_ns()
        best = (after_ns - before_ns, (before_ns + after_ns) // 2)
        # The last reset counts, so stop at the first quick one.
        if best[0] < 1_000_000:
            break
    return best[1]


def find(ports: list[str]) -> list[tuple[str, int, XidIdentity]]:
    """(port, baud, identity) of every XID box on ``ports``, each tried at all rates."""
    found = []
    for port in ports:
        for baud in BAUD_RATES:
            with contextlib.suppress(serial.SerialException, OSError), serial.Serial(port, baud, timeout=0) as line:
                identity = identify(line)
                if identity is not None:
                    found.append((port, baud, identity))
                    break
    return found
