"""Units of work: how a clip is divided among workers. The division follows from the request alone.

A technique with memory is one unit. A stateless one is divided by frames; and where one frame of many samples is long,
by blocks of `SAMPLE_BLOCK` samples too: averaged in float64 in the order of the blocks, whoever made them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError, problem

SAMPLE_BLOCK = 64
"""Samples a pixel of one block; part of what a stored frame is (raise ENGINE_VERSION with it)."""
UNIT_SAMPLES = 5_000_000
"""Primary rays of one unit, about: seconds to a minute on one core."""
_NAME = re.compile(r"frames-(\d{6})-(\d{6})(?:\.blocks-(\d{4})-(\d{4}))?")


@dataclass(frozen=True, order=True)
class Unit:
    """Frames [first, stop) of a clip; ``blocks`` (first, stop) of the sample blocks, None: all of them."""

    first: int
    stop: int
    blocks: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        """The name of the part that this unit makes."""
        frames = f"frames-{self.first:06d}-{self.stop:06d}"
        return frames if self.blocks is None else f"{frames}.blocks-{self.blocks[0]:04d}-{self.blocks[1]:04d}"

    @staticmethod
    def from_name(name: str) -> Unit:
        """The inverse of `name`; InputError where it is none."""
        found = _NAME.fullmatch(name)
        if found is None:
            raise InputError(problem("unit", "name", repr(name), "frames-000000-000012 or ...blocks-0000-0002"))
        first, stop, low, high = (None if group is None else int(group) for group in found.groups())
        assert first is not None
        assert stop is not None
        return Unit(first, stop, None if low is None or high is None else (low, high))


def block_sizes(spp: int) -> tuple[int, ...]:
    """Samples a pixel of each block: 64, 64, ..., the rest."""
    if spp < 1:
        raise InputError(problem("reference", "spp", spp, "at least 1"))
    whole, rest = divmod(spp, SAMPLE_BLOCK)
    return (SAMPLE_BLOCK,) * whole + ((rest,) if rest else ())


def twin_seed(seed: int) -> int:
    """The seed of an independent second picture, from which the error of a reference is measured."""
    return int(np.random.SeedSequence([seed, 1]).generate_state(1)[0])


def plan_units(request: ClipRequest, stateless: bool, spp: int | None) -> tuple[Unit, ...]:
    """The units of one clip in frame order. ``spp``: samples a pixel of a technique that averages, else None."""
    count = request.frame_count
    if count < 1:
        got = f"{request.duration_s} s at {request.rate_hz} Hz: no frame"
        raise InputError(problem(request.scene, "clip", got, "at least one frame"))
    if not stateless:
        return (Unit(0, count),)
    pixels = request.size_px[0] * request.size_px[1]
    frame_samples = pixels * (spp or 1)
    if frame_samples >= 2 * UNIT_SAMPLES and spp is not None and spp > SAMPLE_BLOCK:
        blocks = len(block_sizes(spp))
        chunk = max(1, round(UNIT_SAMPLES / (pixels * SAMPLE_BLOCK)))
        return tuple(
            Unit(k, k + 1, (low, min(low + chunk, blocks))) for k in range(count) for low in range(0, blocks, chunk)
        )
    chunk = max(1, round(UNIT_SAMPLES / frame_samples))
    return tuple(Unit(k, min(k + chunk, count)) for k in range(0, count, chunk))


def units_by_frames(units: Sequence[Unit]) -> dict[tuple[int, int], list[Unit]]:
    """(first, stop) -> the units that make these frames together, in order."""
    out: dict[tuple[int, int], list[Unit]] = {}
    for unit in sorted(units, key=lambda u: (u.first, u.blocks or (0, 0))):
        out.setdefault((unit.first, unit.stop), []).append(unit)
    return out


def average_blocks(blocks: Sequence[np.ndarray], sizes: Sequence[int]) -> np.ndarray:
    """The mean of block means (H, W, 3) float32, weighted by their samples: float64 inside, float32 out."""
    if len(blocks) == 1:
        return blocks[0]
    total = np.zeros(blocks[0].shape, np.float64)
    for block, size in zip(blocks, sizes, strict=True):
        total += block.astype(np.float64) * size
    return (total / sum(sizes)).astype(np.float32)
