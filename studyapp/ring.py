"""A ring of fixed-size records in shared memory: one process puts, one other takes, neither ever waits.

The memory is an anonymous `multiprocessing` RawArray: it vanishes with the last process that maps it, and
kill -9 leaves nothing behind. Counters are 64-bit and only ever written by one side; the record is stored before the
counter that publishes it (x86-64 and the interpreter's locks keep that order; a counter is one aligned 8-byte store).
"""

from __future__ import annotations

import signal
from multiprocessing import get_context
from multiprocessing.sharedctypes import RawArray
from typing import Any

import numpy as np

_WRITTEN, _READ, _LOST, _COUNTERS = 0, 8, 16, 24  # one cache line each, in int64


class RecordRing:
    """Records of ``dtype`` from one producer process to one consumer process.

    ``put`` never blocks: into a full ring the new record is dropped and counted in `lost`, which a session reports.
    Pickles only while a process is being spawned (pass it in ``Process(args=...)``).
    """

    def __init__(self, dtype: np.dtype[Any], capacity: int, memory: Any = None) -> None:
        self.dtype = np.dtype(dtype)
        self.capacity = int(capacity)
        if self.capacity < 1:
            raise ValueError(f"ring capacity: got {capacity}, wanted at least 1")
        size = _COUNTERS * 8 + self.capacity * self.dtype.itemsize
        self._memory = RawArray("B", size) if memory is None else memory
        flat = np.frombuffer(self._memory, dtype=np.uint8)
        self._counters = flat[: _COUNTERS * 8].view(np.int64)
        self._slots = flat[_COUNTERS * 8 :].view(self.dtype)

    def __reduce__(self) -> tuple[Any, ...]:
        return RecordRing, (self.dtype, self.capacity, self._memory)

    @property
    def lost(self) -> int:
        """Records dropped because the consumer was a whole ring behind."""
        return int(self._counters[_LOST])

    @property
    def written(self) -> int:
        """Records ever put."""
        return int(self._counters[_WRITTEN])

    def __len__(self) -> int:
        """Records put and not yet taken."""
        return int(self._counters[_WRITTEN] - self._counters[_READ])

    def put(self, record: Any) -> bool:
        """Copy one record in; False (and counted) where there is no room."""
        written = int(self._counters[_WRITTEN])
        if written - int(self._counters[_READ]) >= self.capacity:
            self._counters[_LOST] += 1
            return False
        self._slots[written % self.capacity] = record
        self._counters[_WRITTEN] = written + 1
        return True

    def put_many(self, records: np.ndarray) -> int:
        """Copy an array of records in, in order; returns how many had room (the rest is counted in `lost`)."""
        written = int(self._counters[_WRITTEN])
        room = self.capacity - (written - int(self._counters[_READ]))
        n = min(room, len(records))
        start = written % self.capacity
        first = min(n, self.capacity - start)
        self._slots[start : start + first] = records[:first]
        self._slots[: n - first] = records[first:n]
        self._counters[_WRITTEN] = written + n
        self._counters[_LOST] += len(records) - n
        return n

    def take(self) -> np.ndarray:
        """A copy of everything put since the last call, oldest first; empty array where there is nothing."""
        written, read = int(self._counters[_WRITTEN]), int(self._counters[_READ])
        n = written - read
        start = read % self.capacity
        first = min(n, self.capacity - start)
        out = np.empty(n, self.dtype)
        out[:first] = self._slots[start : start + first]
        out[first:] = self._slots[: n - first]
        self._counters[_READ] = written
        return out


def leave_interrupts_to_the_session() -> None:
    """In a child process: Ctrl-C is the session's to handle; a child ends when the session closes its pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def spawn_context() -> Any:
    """The only way processes are started here: `spawn` (no forked GPU contexts, locks or file descriptors)."""
    return get_context("spawn")
