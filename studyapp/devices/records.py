"""What device readers put into shared memory: presses, gaze samples, events and clock fits, as fixed-size records."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from protocols.records import GAZE_DTYPE
from studyapp.seams import Press
from studyapp.session_file import ClockFitRow, EventRow

RAW_BYTES = 32
TEXT_BYTES = 160

PRESS_RING_DTYPE = np.dtype(
    [
        ("device", "<i4"),
        ("key", "S16"),
        ("host_ns", "<i8"),
        ("mapped_ns", "<i8"),
        ("device_stamp", "<f8"),  # nan: the device has no clock
        ("raw_length", "<i4"),
        ("raw", "u1", (RAW_BYTES,)),
    ]
)
EVENT_RING_DTYPE = np.dtype(
    [
        ("t_ns", "<i8"),
        ("device", "<i4"),
        ("kind", "S16"),
        ("text", "S160"),  # JSON of the payload
        ("raw_length", "<i4"),
        ("raw", "u1", (RAW_BYTES,)),
    ]
)
GAZE_RING_DTYPE = np.dtype([("device", "<i4"), ("sample", GAZE_DTYPE)])
FIT_RING_DTYPE = np.dtype(
    [
        ("t_ns", "<i8"),
        ("device", "<i4"),
        ("offset_ns", "<f8"),
        ("drift_ppm", "<f8"),
        ("uncertainty_ns", "<f8"),
        ("n", "<i8"),
    ]
)


def press_record(device: int, press: Press) -> np.ndarray:
    """A `Press` as one PRESS_RING_DTYPE record; raw bytes beyond RAW_BYTES are cut."""
    record = np.zeros((), PRESS_RING_DTYPE)
    record["device"], record["key"] = device, press.key.encode()
    record["host_ns"], record["mapped_ns"] = press.host_ns, press.mapped_ns
    record["device_stamp"] = np.nan if press.device_stamp is None else press.device_stamp
    _set_raw(record, press.raw)
    return record


def press_from_record(record: np.ndarray, devices: Sequence[str]) -> Press:
    """The inverse of `press_record`."""
    stamp = float(record["device_stamp"])
    return Press(
        key=bytes(record["key"]).decode(),
        host_ns=int(record["host_ns"]),
        mapped_ns=int(record["mapped_ns"]),
        device=devices[int(record["device"])],
        device_stamp=None if np.isnan(stamp) else stamp,
        raw=_raw(record),
    )


def event_record(t_ns: int, device: int, kind: str, payload: dict[str, object], raw: bytes = b"") -> np.ndarray:
    """One EVENT_RING_DTYPE record; a payload whose JSON is longer than TEXT_BYTES becomes {"cut": its beginning}."""
    text = json.dumps(payload)
    if len(text.encode()) > TEXT_BYTES:
        text = json.dumps({"cut": text.encode("ascii", "replace")[:100].decode()})
    record = np.zeros((), EVENT_RING_DTYPE)
    record["t_ns"], record["device"], record["kind"], record["text"] = t_ns, device, kind.encode(), text.encode()
    _set_raw(record, raw)
    return record


def events_from_ring(records: np.ndarray, devices: Sequence[str]) -> list[EventRow]:
    """EVENT_RING_DTYPE records as rows of ``events``."""
    return [
        EventRow(
            int(record["t_ns"]),
            devices[int(record["device"])],
            bytes(record["kind"]).decode(),
            bytes(record["text"]).decode(),
            _raw(record) or None,
        )
        for record in records
    ]


def fits_from_ring(records: np.ndarray, devices: Sequence[str]) -> list[ClockFitRow]:
    """FIT_RING_DTYPE records as rows of ``clock_fits``."""
    return [
        ClockFitRow(
            int(record["t_ns"]),
            devices[int(record["device"])],
            float(record["offset_ns"]),
            float(record["drift_ppm"]),
            float(record["uncertainty_ns"]),
            int(record["n"]),
        )
        for record in records
    ]


def _set_raw(record: np.ndarray, raw: bytes) -> None:
    kept = raw[:RAW_BYTES]
    record["raw_length"] = len(kept)
    record["raw"][: len(kept)] = np.frombuffer(kept, np.uint8)


def _raw(record: np.ndarray) -> bytes:
    return bytes(record["raw"][: int(record["raw_length"])])
