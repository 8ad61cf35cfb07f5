"""Bytes from response boxes -> presses. Pure: a decoder is fed bytes and returns what they say, and never raises.

Three grammars: Cedrus XID packets (6 bytes, with the box's own clock), boxes that send one byte of button bits (table:
fORP, PST SR-Box, "as RB-820"), and text lines ``<stamp>:<event>`` (Arduino boxes, Black Box ToolKit TPad). A decoder
that has lost its place finds the next valid packet by itself; what it skips is counted in `malformed`.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class KeyChange:
    """A key went down (``pressed``) or up. ``device_s``: the box's own clock, None where it has none; ``raw``: the
    very bytes it was decoded from."""

    key: str
    pressed: bool
    device_s: float | None
    raw: bytes


class Decoder(Protocol):
    """Fed bytes in any portions, returns changes in order. ``malformed``: bytes that belonged to no valid packet."""

    malformed: int

    def feed(self, data: bytes, host_s: float) -> list[KeyChange]:
        """Decode what ``data`` (received at ``host_s``, host clock) completes."""
        ...


# --- Cedrus XID -------------------------------------------------------------------------------------------------------

XID_PACKET = struct.Struct("<cBI")
XID_QUERY_TIMER = struct.Struct("<3sI")
_XID_KEY_MAPS: dict[str, dict[int, str]] = {
    # raw key number on the line -> button counted from the left, as the maker's own table has it
    "rb-530": {1: "1", 3: "2", 4: "3", 5: "4", 6: "5"},
    "rb-730": {n: str(n) for n in range(1, 9)},
    "rb-830": {1: "4", 2: "5", 3: "2", 4: "3", 5: "6", 6: "7", 7: "1", 8: "8"},
    "rb-834": {n: str(n) for n in range(1, 9)},
    "lumina": {n: str(n) for n in range(1, 6)},
}
XID_MODELS = tuple(sorted(_XID_KEY_MAPS))


class XidDecoder:
    """Cedrus XID response packets: 'k', parameter byte, uint32 little-endian milliseconds since the timer's reset.

    A packet counts only if port and reserved bits are 0, the key exists on the model, it changes that key's state, and
    (once `timer_reset` was told) its stamp lies within ``tolerance_s`` + 1e-3 of the elapsed time of what the host's
    clock expects; otherwise the window slides by one byte. Answers to the timer query are kept in `timer_answers`.
    """

    def __init__(self, model: str = "rb-730", tolerance_s: float = 2.0) -> None:
        self._keys = _XID_KEY_MAPS[model]
        self._tolerance_s = tolerance_s
        self._buffer = bytearray()
        self._down: set[int] = set()
        self._reset_s: float | None = None
        self._timer_query_open = False
        self.malformed = 0
        self.timer_answers: list[tuple[float, float]] = []  # (device s, host s when complete)

    def timer_reset(self, host_s: float) -> None:
        """The response timer was set to 0 at ``host_s``: stamps can be checked from now on."""
        self._reset_s = host_s

    def timer_queried(self) -> None:
        """An answer ``_e5`` + uint32 is expected; without this it counts as noise."""
        self._timer_query_open = True

    def _plausible(self, device_s: float, host_s: float) -> bool:
        if self._reset_s is None:
            return True
        elapsed_s = host_s - self._reset_s
        # uint32 milliseconds wrap after 49.7 days.
        difference_s = (device_s - elapsed_s + 2**31 / 1000) % (2**32 / 1000) - 2**31 / 1000
        return abs(difference_s) <= self._tolerance_s + 1e-3 * abs(elapsed_s)

    def feed(self, data: bytes, host_s: float) -> list[KeyChange]:
        self._buffer += data
        changes = []
        while self._buffer:
            first = self._buffer[0]
            if first == 0x5F and self._timer_query_open:  # '_'
                if len(self._buffer) < 7:
                    if b"_e5".startswith(bytes(self._buffer[:3])):
                        break
                elif self._buffer[:3] == b"_e5":
                    _, ticks = XID_QUERY_TIMER.unpack(self._buffer[:7])
                    if self._plausible(ticks / 1000, host_s):
                        del self._buffer[:7]
                        self._timer_query_open = False
                        self.timer_answers.append((ticks / 1000, host_s))
                        continue
            elif first == 0x6B:  # 'k'
                if len(self._buffer) >= 2 and not self._parameter_valid(self._buffer[1]):
                    self._slide()
                    continue
                if len(self._buffer) < 6:
                    break
                change = self._packet(bytes(self._buffer[:6]), host_s)
                if change is not None:
                    del self._buffer[:6]
                    changes.append(change)
                    continue
            self._slide()
        return changes

    def _slide(self) -> None:
        del self._buffer[0]
        self.malformed += 1

    def _parameter_valid(self, parameter: int) -> bool:
        return parameter & 0x0F == 0 and ((parameter >> 5) or 8) in self._keys

    def _packet(self, raw: bytes, host_s: float) -> KeyChange | None:
        _, parameter, ticks = XID_PACKET.unpack(raw)
        key, pressed = (parameter >> 5) or 8, bool(parameter & 0x10)
        if pressed == (key in self._down) or not self._plausible(ticks / 1000, host_s):
            return None
        if pressed:
            self._down.add(key)
        else:
            self._down.discard(key)
        return KeyChange(self._keys[key], pressed, ticks / 1000, raw)


def xid_packet(key: str, pressed: bool, device_s: float, model: str = "rb-730") -> bytes:
    """The bytes a Cedrus box sends for a key (the emulator's side; inverse of `XidDecoder`)."""
    number = next(n for n, name in _XID_KEY_MAPS[model].items() if name == key)
    return XID_PACKET.pack(b"k", ((number & 7) << 5) | (0x10 if pressed else 0), round(device_s * 1000) & 0xFFFFFFFF)


# --- One byte of button bits ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ByteBox:
    """A box whose every byte is the state of its buttons. ``bits``: mask -> key; a byte with any other bit set is
    noise. ``active_low``: 0 means pressed. ``momentary``: only presses are sent, each byte is a press by itself."""

    baud: int
    bits: dict[int, str]
    start: bytes = b""
    stop: bytes = b""
    active_low: bool = False
    momentary: bool = False


BYTE_BOXES: dict[str, ByteBox] = {
    "forp": ByteBox(19200, {0x01: "1", 0x02: "2", 0x04: "3", 0x08: "4", 0x10: "trigger"}, momentary=True),
    "pst": ByteBox(19200, {1 << n: str(n + 1) for n in range(5)}, start=b"\xa0", stop=b"\x20"),
    "rb-820": ByteBox(115200, {1 << n: str(n + 1) for n in range(8)}),
}


BITS_A_BYTE = 10
"""On the line: a start bit, eight of data, a stop bit (8N1)."""


def byte_ns(baud: int) -> int:
    """How long one byte is on its way: a press was made so much before its byte is whole."""
    return round(BITS_A_BYTE * 1e9 / baud)


class ByteDecoder:
    """Edges of the button bits of a `ByteBox`; bytes with undefined bits change nothing."""

    def __init__(self, box: ByteBox) -> None:
        self._box = box
        self._known = sum(box.bits)
        self._state = 0
        self.malformed = 0

    def feed(self, data: bytes, host_s: float) -> list[KeyChange]:
        changes = []
        for value in data:
            state = value ^ 0xFF if self._box.active_low else value
            if state & ~self._known & 0xFF or (self._box.momentary and state == 0):
                self.malformed += 1
                continue
            changed = state if self._box.momentary else state ^ self._state
            for mask, key in self._box.bits.items():
                if changed & mask:
                    changes.append(KeyChange(key, bool(state & mask), None, bytes([value])))
            self._state = 0 if self._box.momentary else state
        return changes


# --- Text lines -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LineBox:
    """A box that sends lines. ``pattern`` has groups ``stamp``, ``key`` and optionally ``edge`` (``down`` lists the
    texts that mean pressed; no group: every line is a press); ``tick_s``: seconds of one unit of the stamp."""

    baud: int
    pattern: str
    tick_s: float
    down: tuple[str, ...] = ()
    keys: tuple[str, ...] = tuple("12345678")


LINE_BOXES: dict[str, LineBox] = {
    # <microseconds>:<event>, e.g. 1234567:1 (photodiode loggers send the same with their own event names)
    "lines": LineBox(115200, r"(?P<stamp>\d{1,16}):(?P<key>[A-Za-z0-9_]{1,12})(?P<edge>[+-]?)", 1e-6, ("", "+")),
    # Black Box ToolKit TPad: A P 1 123456 (letter C|M|T are its light, voice and TTL inputs: events, not keys)
    "tpad": LineBox(115200, r"A (?P<edge>[PR]) (?P<key>[0-9]) (?P<stamp>\d{1,12})", 1e-3, ("P",)),
}
LONGEST_LINE = 64


class LineDecoder:
    """Lines of a `LineBox`, ended by CR, LF or both. A line that does not match whole, is too long, names a key the box
    does not have, or whose stamp goes backwards or leaves the host's clock by more than ``tolerance_s`` is noise."""

    def __init__(self, box: LineBox, tolerance_s: float = 2.0) -> None:
        self._box = box
        self._pattern = re.compile(box.pattern.encode())
        self._tolerance_s = tolerance_s
        self._buffer = bytearray()
        self._last: tuple[float, float] | None = None  # (device s, host s) of the last good line
        self._rejected: tuple[float, float] | None = None  # the same of the last implausible line
        self.malformed = 0

    def feed(self, data: bytes, host_s: float) -> list[KeyChange]:
        changes = []
        self._buffer += data
        *lines, rest = re.split(rb"[\r\n]", bytes(self._buffer))
        self._buffer = bytearray(rest)
        for line in lines:
            change = self._line(line, host_s)
            if change is not None:
                changes.append(change)
            elif line:
                self.malformed += len(line)
        if len(self._buffer) > LONGEST_LINE:
            self.malformed += len(self._buffer) - LONGEST_LINE
            del self._buffer[:-LONGEST_LINE]
        return changes

    def _line(self, line: bytes, host_s: float) -> KeyChange | None:
        found = self._pattern.fullmatch(line)
        if found is None or len(line) > LONGEST_LINE:
            return None
        key = found["key"].decode()
        device_s = int(found["stamp"]) * self._box.tick_s
        if key not in self._box.keys or not self._plausible(device_s, host_s):
            return None
        self._last, self._rejected = (device_s, host_s), None
        pressed = "edge" not in self._pattern.groupindex or found["edge"].decode() in self._box.down
        return KeyChange(key, pressed, device_s, line)

    def _plausible(self, device_s: float, host_s: float) -> bool:
        if self._last is None:
            return True
        if _paces_agree(self._last, (device_s, host_s), self._tolerance_s):
            return True
        # A restarted box: this line and the last implausible one, some time apart, tell one and the same clock.
        before, self._rejected = self._rejected, (device_s, host_s)
        return before is not None and host_s - before[1] >= 0.2 and _paces_agree(before, (device_s, host_s), 0.1)


def _paces_agree(before: tuple[float, float], now: tuple[float, float], tolerance_s: float) -> bool:
    """Did device and host clock (device s, host s) advance by the same time, within a tolerance and 0.1 %?"""
    device_s, host_s = now[0] - before[0], now[1] - before[1]
    return abs(device_s - host_s) <= tolerance_s + 1e-3 * abs(host_s)


def decoder_for(kind: str, model: str = "rb-730") -> Decoder:
    """The decoder of a box kind: 'xid', or a name in BYTE_BOXES or LINE_BOXES. Raises KeyError for another."""
    if kind == "xid":
        return XidDecoder(model)
    if kind in BYTE_BOXES:
        return ByteDecoder(BYTE_BOXES[kind])
    return LineDecoder(LINE_BOXES[kind])


BOX_KINDS = ("xid", *BYTE_BOXES, *LINE_BOXES)
