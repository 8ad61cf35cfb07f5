"""Recorded kernels replay what they would compute anew: pictures of few pixels, one support texel, gaze in and out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import renderers.foveated.technique as module
from renderers.backend import dr
from tests.renderers.foveated.test_technique import NO_MARKS, SIZE, made, view, wall
from tests.renderers.scenes import SlidingCamera

AWAY = (-170.0, 10.0)
GAZES = [AWAY, AWAY, AWAY, (4.0, -3.0), AWAY, (-30.0, 10.0), (30.0, 20.0), AWAY]


def computed_anew(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """What `frozen` is used for, without a recording."""

    def call(lanes: int, *arguments: Any) -> Any:
        if lanes == 0:
            return None
        found = kernel(*arguments)
        dr.eval(found)
        dr.sync_thread()
        return found

    return call


def pictures(size_px: tuple[int, int], **params: object) -> list[tuple[np.ndarray, int]]:
    scene = wall(SlidingCamera((0.4, 0.1, -0.2)))
    technique = made(scene, size_px, p_min=0.0, **NO_MARKS, **params)
    frames = [technique.render(view(scene, k, size_px, gaze=gaze)) for k, gaze in enumerate(GAZES)]
    return [(frame.color.copy(), frame.rays["primary"]) for frame in frames]


@pytest.mark.parametrize(
    ("size_px", "divisor"),
    [((7, 3), 4.6), ((31, 21), 16.0), ((60, 45), 64.0), ((26, 7), 6.0), ((1, 1), 4.6), ((1, 9), 4.6), (SIZE, 4.6)],
)
def test_frames_are_those_of_kernels_that_are_not_recorded(
    size_px: tuple[int, int], divisor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where nothing but the support image is traced, a picture of one texel has one lane, and then more again."""
    found = pictures(size_px, support_divisor=divisor)
    monkeypatch.setattr(module, "frozen", computed_anew)
    wanted = pictures(size_px, support_divisor=divisor)
    for (color, rays), (other, same) in zip(found, wanted, strict=True):
        assert rays == same
        np.testing.assert_array_equal(color, other)
    assert len({rays for _, rays in found}) > (1 if size_px[0] > 1 else 0)
