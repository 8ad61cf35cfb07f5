"""Random numbers of a lane: a hash of its seed and a counter. No state, so that order and lane count do not matter."""

from __future__ import annotations

from typing import Any

from renderers.backend import mi


def mixed(value: Any) -> Any:
    """A UInt32 in which every bit depends on every bit of ``value`` (PCG output hash, Jarzynski and Olano 2020)."""
    state = value * mi.UInt32(747796405) + mi.UInt32(2891336453)
    word = ((state >> ((state >> 28) + 4)) ^ state) * mi.UInt32(277803737)
    return (word >> 22) ^ word


def combined(seed: Any, counter: Any) -> Any:
    """A UInt32 for the ``counter``-th use of ``seed``."""
    return mixed(seed ^ mixed(mi.UInt32(counter) + mi.UInt32(0x9E3779B9)))


def uniform(seed: Any, counter: Any) -> Any:
    """A Float in [0, 1) for the ``counter``-th use of ``seed`` (UInt32)."""
    return mi.Float(combined(seed, counter) >> 8) * (1.0 / (1 << 24))
