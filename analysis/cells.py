"""A long table as one mean per participant and cell: the participant is the unit of inference.

Values are shifted by the first of them and scaled by a power of two before anything is summed, so that a large
common offset or an extreme unit costs no digits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.results import ROUNDING, coded, numbers, require_columns


@dataclass(frozen=True)
class Cells:
    """``values[i, c]``: shifted and scaled mean of participant i in cell c (cells in C order of ``levels``).

    The mean in the data's unit is ``offset + scale * values``. ``rounding`` is what one value of this scale may owe to
    the rounding of the data; ``groups[i]`` are the codes of the participant in each between factor.
    """

    subjects: list[Any]
    levels: list[list[Any]]
    values: np.ndarray
    groups: np.ndarray
    group_levels: list[list[Any]]
    offset: float
    scale: float
    rounding: float
    dropped: dict[Any, str]
    notes: list[str]
    repetitions: int


def shift_and_scale(values: np.ndarray) -> tuple[np.ndarray, float, float, float]:
    """(values - offset) / scale with the first finite value as offset and a power of two as scale; and the rounding."""
    finite = np.isfinite(values)
    if not finite.any():
        return values, 0.0, 1.0, 0.0
    offset = float(values[finite][0])
    largest_raw = float(np.max(np.abs(values[finite])))
    with np.errstate(over="ignore"):
        shifted = values - offset
        largest = float(np.max(np.abs(shifted[finite])))
    if not np.isfinite(largest):
        # A range beyond the double's: no shift, only a scale.
        offset, largest, shifted = 0.0, largest_raw, values
    # A subnormal range keeps the smallest normal scale.
    exponent = min(max(math.frexp(largest)[1], -1021), 1023)
    scale = math.ldexp(1.0, exponent) if largest > 0 else 1.0
    return shifted / scale, offset, scale, ROUNDING * (largest_raw / scale)


def label_of(levels: Sequence[Any]) -> str:
    """A cell's name in a message."""
    return ", ".join(map(str, levels))


def cell_means(where: str, table: pd.DataFrame, dv: str, within: list[str], subject: str, between: list[str]) -> Cells:
    """Average repetitions; leave out, by name and with the reason, participants who lack a cell."""
    require_columns(where, table, [dv, *within, subject, *between])
    y = numbers(where, table, dv)
    factor = [coded(table, name) for name in within]
    group = [coded(table, name) for name in between]
    person, subjects = coded(table, subject)
    known: np.ndarray = person >= 0
    for codes, _ in factor + group:
        known &= codes >= 0
    notes: list[str] = []
    if not known.all():
        notes.append(f"{int((~known).sum())} rows without a subject or factor level were left out")
    shape = [len(levels) for _, levels in factor]
    levels = [found for _, found in factor]
    n, width = len(subjects), int(np.prod(shape)) if shape else 1
    use = known & np.isfinite(y)
    y, offset, scale, rounding = shift_and_scale(np.where(use, y, np.nan))
    # Mean of every participant's every cell.
    cell = np.zeros(len(y), dtype=np.int64)
    for (codes, _), size in zip(factor, shape, strict=True):
        cell = cell * size + codes
    index = person[use] * width + cell[use]
    count = np.bincount(index, minlength=n * width).reshape(n, width)
    total = np.bincount(index, weights=y[use], minlength=n * width).reshape(n, width)
    with np.errstate(invalid="ignore", divide="ignore"):
        values = total / count
    complete = np.asarray((count > 0).all(axis=1)) if width else np.zeros(n, dtype=bool)
    dropped: dict[Any, str] = {}
    for i in np.flatnonzero(~complete):
        empty = np.flatnonzero(count[i] == 0)
        place = np.unravel_index(int(empty[0]), shape) if shape and len(empty) else ()
        name = label_of([f"{w}={lv[j]}" for w, lv, j in zip(within, levels, place, strict=False)]) or dv
        more = f" and {len(empty) - 1} more" if len(empty) > 1 else ""
        dropped[subjects[i]] = f"no valid {dv!r} in {name}{more}: left out"
    missing = np.bincount(person[known & ~use], minlength=n) if n else np.zeros(0, dtype=int)
    for i in np.flatnonzero((missing > 0) & complete):
        notes.append(f"{subjects[i]}: {int(missing[i])} missing {dv!r}; cell means are over the rest")
    groups = np.zeros((n, len(group)), dtype=np.int64)
    for j, (codes, _) in enumerate(group):
        lowest, highest = np.full(n, np.iinfo(np.int64).max), np.full(n, -1)
        np.minimum.at(lowest, person[use], codes[use])
        np.maximum.at(highest, person[use], codes[use])
        groups[:, j] = np.maximum(highest, 0)
        for i in np.flatnonzero(complete & (lowest != highest)):
            complete[i] = False
            dropped[subjects[i]] = f"is in more than one level of {between[j]!r}: left out"
    keep = np.flatnonzero(complete)
    return Cells(
        subjects=[subjects[i] for i in keep],
        levels=levels,
        values=values[keep],
        groups=groups[keep],
        group_levels=[found for _, found in group],
        offset=offset,
        scale=scale,
        rounding=rounding,
        dropped=dropped,
        notes=notes,
        repetitions=int(count.max()) if count.size else 0,
    )
