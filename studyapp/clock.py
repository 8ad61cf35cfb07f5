"""The only reader of session time: monotonic nanoseconds, the same clock in every process of this machine."""

from __future__ import annotations

import time
from datetime import UTC, datetime


def now_ns() -> int:
    """Nanoseconds on the machine's monotonic clock (CLOCK_MONOTONIC; comparable between processes)."""
    return time.monotonic_ns()


def wall_clock_utc() -> str:
    """Date and time of day for headers only, ISO 8601 in UTC; never used to measure."""
    return datetime.now(UTC).isoformat(timespec="seconds")
