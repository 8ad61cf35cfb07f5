"""What the presenter sees of its devices in every refresh: is each there, and where does the eye look."""

from __future__ import annotations

from multiprocessing.sharedctypes import RawArray
from typing import Any

import numpy as np

from studyapp.clock import now_ns

OPENING, ALIVE, GONE = 0, 1, 2
_SAMPLE = np.dtype([("x_dva", "<f8"), ("y_dva", "<f8"), ("mapped_ns", "<i8"), ("valid", "<i8")])
_SLOT = np.dtype(
    [
        ("state", "<i8"),
        ("changed_ns", "<i8"),
        ("written", "<i8"),  # samples so far; the newest lies in samples[written % 2], the other may be half written
        ("samples", _SAMPLE, (2,)),
        ("reason", "S120"),
    ]
)


class StatusBoard:
    """One slot a device in shared memory: is it there, since when, and its newest gaze sample. One writer."""

    def __init__(self, n_devices: int, memory: Any = None) -> None:
        self._n = n_devices
        self._memory = RawArray("B", 8 + n_devices * _SLOT.itemsize) if memory is None else memory
        flat = np.frombuffer(self._memory, np.uint8)
        self._beat = flat[:8].view(np.int64)
        self._slots = flat[8:].view(_SLOT)

    def __reduce__(self) -> tuple[Any, ...]:
        return StatusBoard, (self._n, self._memory)

    def beat(self) -> None:
        """The reader is running."""
        self._beat[0] = now_ns()

    def age_s(self) -> float:
        """Seconds since the last beat."""
        return (now_ns() - int(self._beat[0])) * 1e-9

    def mark(self, device: int, state: int, reason: str = "") -> None:
        """A device came, or went, and why."""
        slot = self._slots[device]
        slot["reason"] = reason.encode("ascii", "replace")[:120]
        slot["changed_ns"] = now_ns()
        slot["state"] = state

    def state(self, device: int) -> int:
        """OPENING, ALIVE or GONE."""
        return int(self._slots[device]["state"])

    def reason(self, device: int) -> str:
        """How it showed that the device was gone."""
        return bytes(self._slots[device]["reason"]).decode()

    def look(self, device: int, sample: np.ndarray) -> None:
        """Publish the newest GAZE_DTYPE sample; a writer that is stopped half way leaves the one before it standing."""
        slot = self._slots[device]
        written = int(slot["written"]) + 1
        slot["samples"][written % 2] = (sample["x_dva"], sample["y_dva"], sample["mapped_ns"], sample["valid"])
        slot["written"] = written

    def newest(self, device: int) -> tuple[float, float, int, bool] | None:
        """(x_dva, y_dva, mapped_ns, valid) of the newest whole sample, None before the first."""
        slot = self._slots[device]
        while written := int(slot["written"]):
            x_dva, y_dva, mapped_ns, valid = slot["samples"][written % 2].item()
            if int(slot["written"]) == written:
                return x_dva, y_dva, mapped_ns, bool(valid)
        return None
