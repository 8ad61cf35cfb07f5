"""Fuzz: a million random bytes to every decoder. Invented: a press that the bytes, read by an independent oracle, do
not hold. Recovery: a valid packet after each burst of noise is decoded."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass

import numpy as np

from studyapp.devices.decoders import BYTE_BOXES, LINE_BOXES, ByteDecoder, LineDecoder, XidDecoder, xid_packet
from tests.evidence import write_evidence


@dataclass(frozen=True)
class FuzzResult:
    """Noise bytes fed, presses that were invented, probes sent after noise and probes found."""

    decoder: str
    bytes_fed: int
    invented: int
    probes: int
    recovered: int


def _noise(n: int, rng: np.random.Generator, spice: bytes) -> bytes:
    """Random bytes, half of the bursts made mostly of the grammar's own characters."""
    if rng.random() < 0.5:
        return rng.integers(0, 256, n, np.uint8).tobytes()
    return rng.choice(np.frombuffer(spice, np.uint8), n).tobytes()


def fuzz_xid(n_bytes: int, rng: np.random.Generator) -> FuzzResult:
    """Noise at a Cedrus box whose timer was reset: no press but the probes may come out."""
    decoder = XidDecoder("rb-730")
    decoder.timer_reset(0.0)
    fed, invented, probes, recovered, host_s = 0, 0, 0, 0, 0.0
    while fed < n_bytes:
        burst = _noise(int(rng.integers(1, 200)), rng, b"k_e5\x10\x30\x50\x70\x00\x01\x02")
        host_s += 1.0
        # A run of zeros ends any packet that the noise may have begun.
        fed += len(burst) + 6
        key, edge = str(1 + probes % 8), True
        invented += len(decoder.feed(burst + bytes(6), host_s))
        for edge in (True, False):
            probe = xid_packet(key, edge, host_s)
            found = decoder.feed(probe, host_s)
            probes += 1
            recovered += [c.raw for c in found] == [probe]
            invented += sum(c.raw != probe for c in found)
    return FuzzResult("xid", fed, invented, probes, recovered)


def fuzz_byte_box(name: str, n_bytes: int, rng: np.random.Generator) -> FuzzResult:
    """Every byte against an oracle of set arithmetic on the table; probe: all up, then one key down."""
    box = BYTE_BOXES[name]
    decoder = ByteDecoder(box)
    down: set[str] = set()
    fed, invented, probes, recovered = 0, 0, 0, 0
    while fed < n_bytes:
        burst = _noise(int(rng.integers(1, 200)), rng, bytes(range(32)))
        fed += len(burst)
        expected: list[tuple[str, bool]] = []
        for value in burst:
            named = {key for mask, key in box.bits.items() if value & mask}
            undefined = value != sum(mask for mask in box.bits if value & mask)
            if undefined or (box.momentary and not named):
                continue
            if box.momentary:
                expected += [(key, True) for key in box.bits.values() if key in named]
            else:
                expected += [(key, key in named) for key in box.bits.values() if (key in named) != (key in down)]
                down = named
        got = [(c.key, c.pressed) for c in decoder.feed(burst, 0.0)]
        invented += got != expected
        decoder.feed(b"\0", 0.0)
        down = set()
        mask, key = list(box.bits.items())[probes % len(box.bits)]
        probes += 1
        recovered += [(c.key, c.pressed) for c in decoder.feed(bytes([mask]), 0.0)] == [(key, True)]
        decoder.feed(b"\0", 0.0)
    return FuzzResult(name, fed, invented, probes, recovered)


def fuzz_line_box(name: str, n_bytes: int, rng: np.random.Generator) -> FuzzResult:
    """Noise lines: whatever comes out must be a whole line of the noise by a hand-written reading of the grammar."""
    decoder = LineDecoder(LINE_BOXES[name])
    template = "{us}:{key}\n" if name == "lines" else "A P {key} {ms}\r\n"
    fed, invented, probes, recovered, host_s = 0, 0, 0, 0, 0.0
    decoder.feed(template.format(us=0, ms=0, key=1).encode(), 0.0)
    while fed < n_bytes:
        burst = _noise(int(rng.integers(1, 200)), rng, b"A PR0123456789:+-.e\r\n")
        fed += len(burst) + 1
        host_s += 1.0
        lines = set(re.split(rb"[\r\n]", burst))
        for change in decoder.feed(burst + b"\n", host_s):
            # A true line inside noise may be believed only if it is whole and its stamp is near the host's clock.
            near = change.device_s is not None and abs(change.device_s - host_s) < 2.1 + 1e-3 * host_s
            invented += not (near and any(line.endswith(change.raw) for line in lines))
        stamp = round(host_s * 1e6)
        probe = template.format(us=stamp, ms=stamp // 1000, key=1 + probes % 8).encode()
        probes += 1
        found = decoder.feed(probe, host_s)
        recovered += [(c.key, c.pressed) for c in found] == [(str(1 + (probes - 1) % 8), True)]
    return FuzzResult(name, fed, invented, probes, recovered)


def prove(n_bytes: int = 1_000_000) -> list[FuzzResult]:
    """All decoders, ``n_bytes`` each."""
    rng = np.random.default_rng(20_260_000)
    results = [fuzz_xid(n_bytes, rng)]
    results += [fuzz_byte_box(name, n_bytes, rng) for name in BYTE_BOXES]
    results += [fuzz_line_box(name, n_bytes, rng) for name in LINE_BOXES]
    return results


if __name__ == "__main__":
    found = prove()
    write_evidence("fuzz_decoders", found)
    print("\n".join(map(str, found)))
    sys.exit(any(r.invented or r.recovered != r.probes for r in found))
