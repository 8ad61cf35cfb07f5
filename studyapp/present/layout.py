"""Where the pictures of a trial stand on the display: rectangles in pixels, origin top left, y down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from protocols.conditions import Mirror
from protocols.trial import Trial
from stimuli.errors import InputError, problem

SLOT_ORDER = ("left", "upper_left", "first", "centre", "second", "upper_right", "lower_left", "lower_right", "right")
"""Reading order of slot names; others follow in the order given."""
IN_SEQUENCE = ("first", "second")
"""Slots that share the centre, one after the other."""


@dataclass(frozen=True)
class PanelRect:
    """One panel: slot, top-left corner and size in pixels, and whether its picture is flipped left to right."""

    slot: str
    x_px: int
    y_px: int
    width_px: int
    height_px: int
    flipped: bool = False


def place_panels(
    sizes_px: Mapping[str, tuple[int, int]],
    display_px: tuple[int, int],
    gap_px: int = 0,
    mirror: Mirror = "none",
) -> tuple[PanelRect, ...]:
    """Rectangles of one to four panels, centred, one picture pixel to one display pixel.

    Panels stand in a row; four that do not fit in a row stand in two. ``first`` and ``second`` share the centre.
    ``mirror``: ``sides`` reverses the order of each row; ``pictures`` flips the pictures left of the middle (a
    butterfly comparison, equal image places meet at the seam). Raises InputError where they do not fit.
    """
    slots = sorted(sizes_px, key=lambda slot: SLOT_ORDER.index(slot) if slot in SLOT_ORDER else len(SLOT_ORDER))
    if not 1 <= len(slots) <= 4:
        raise InputError(problem("layout", "panels", len(slots), "one to four"))
    if all(slot in IN_SEQUENCE for slot in slots):
        rects = tuple(_row([slot], sizes_px, display_px, 0)[0] for slot in slots)
    else:
        turn = -1 if mirror == "sides" else 1
        rects = _row(slots[::turn], sizes_px, display_px, gap_px)
        if len(slots) == 4 and not _fits(rects, display_px):
            rects = _two_rows([*slots[:2][::turn], *slots[2:][::turn]], sizes_px, display_px, gap_px)
    if not _fits(rects, display_px):
        wanted = f"at most {display_px[0]}x{display_px[1]} with gaps of {gap_px}"
        got = ", ".join(f"{rect.slot} {rect.width_px}x{rect.height_px}" for rect in rects)
        raise InputError(problem("layout", "panels do not fit the display", got, wanted))
    if mirror == "pictures":
        # A panel in the middle may stand half a pixel to the left of it.
        middle = display_px[0] / 2 - 1
        rects = tuple(
            PanelRect(r.slot, r.x_px, r.y_px, r.width_px, r.height_px, r.x_px + r.width_px / 2 < middle) for r in rects
        )
    return rects


def trial_rects(trial: Trial, display_px: tuple[int, int]) -> dict[str, PanelRect]:
    """Slot -> rectangle of each panel of a planned trial, by its own size, gap and mirror."""
    width, height = (int(side) for side in trial.settings["size_px"])
    sizes = {panel.slot: (width, height) for panel in trial.panels}
    gap_px, mirror = int(trial.settings.get("gap_px", 0)), trial.settings.get("mirror", "none")
    return {rect.slot: rect for rect in place_panels(sizes, display_px, gap_px, mirror)}


def _row(
    slots: Sequence[str], sizes_px: Mapping[str, tuple[int, int]], display_px: tuple[int, int], gap_px: int
) -> tuple[PanelRect, ...]:
    """A row centred on the display."""
    total = sum(sizes_px[slot][0] for slot in slots) + gap_px * (len(slots) - 1)
    x = (display_px[0] - total) // 2
    rects = []
    for slot in slots:
        width, height = sizes_px[slot]
        rects.append(PanelRect(slot, x, (display_px[1] - height) // 2, width, height))
        x += width + gap_px
    return tuple(rects)


def _two_rows(
    slots: Sequence[str], sizes_px: Mapping[str, tuple[int, int]], display_px: tuple[int, int], gap_px: int
) -> tuple[PanelRect, ...]:
    upper, lower = _row(slots[:2], sizes_px, display_px, gap_px), _row(slots[2:], sizes_px, display_px, gap_px)
    middle = display_px[1] // 2
    rects = [PanelRect(r.slot, r.x_px, middle - gap_px // 2 - r.height_px, r.width_px, r.height_px) for r in upper]
    rects += [PanelRect(r.slot, r.x_px, middle + (gap_px + 1) // 2, r.width_px, r.height_px) for r in lower]
    return tuple(rects)


def _fits(rects: Sequence[PanelRect], display_px: tuple[int, int]) -> bool:
    return all(
        r.x_px >= 0 and r.y_px >= 0 and r.x_px + r.width_px <= display_px[0] and r.y_px + r.height_px <= display_px[1]
        for r in rects
    )
