"""How many samples a reference needs: its standard error, in display values, at three frames of the clip.

The error is measured, not predicted: two references of independent seeds are rendered, and their RMS difference over
sqrt(2) is the standard error of either (display values in [0, 1], after exposure, before rounding).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from renderers.clip_renderer import ClipRenderer
from renderers.render_unit import standard_error
from renderers.units import Unit
from stimuli.clip_job import ClipJob
from stimuli.errors import InputError, problem

MOST_SPP = 65536


@dataclass(frozen=True)
class Convergence:
    """``spp``: the smallest power of two whose worst frame is within ``target`` (None: not even the most asked
    for, by the trend); ``errors``: spp -> measured error of the worst of the frames."""

    target: float
    spp: int | None
    errors: Mapping[int, float]


def reference_error(job: ClipJob, spp: int, renderer: ClipRenderer) -> float:
    """The largest standard error of the first, middle and last frame at ``spp`` samples a pixel."""
    count = job.request.frame_count
    asked = replace(job, request=replace(job.request, params={**job.request.params, "spp": spp}))
    errors = []
    for k in sorted({0, count // 2, count - 1}):
        for frame in renderer.frames(asked, Unit(k, k + 1)):
            found = standard_error(frame, job.request.exposure)
            assert found is not None, "the three frames are those that are rendered twice"
            errors.append(found)
    return max(errors)


def samples_for_error(
    job: ClipJob, target: float, renderer: ClipRenderer, first: int = 4, most: int = MOST_SPP
) -> Convergence:
    """Double the samples, up to ``most``, until the measured error is within ``target``.

    Stops early where the trend of the last doublings says that ``most`` would not do. InputError for a target that is
    not above 0.
    """
    if not (math.isfinite(target) and target > 0):
        raise InputError(problem("reference error", "target", target, "a number above 0 (display values in [0, 1])"))
    errors: dict[int, float] = {}
    spp = min(first, most)
    while spp <= most:
        errors[spp] = reference_error(job, spp, renderer)
        if errors[spp] <= target:
            return Convergence(target, spp, errors)
        # error falls with spp^-1/2 at worst (random), spp^-1 at best: what the next steps could reach
        if errors[spp] * spp / most > target:
            break
        spp *= 2
    return Convergence(target, None, errors)
