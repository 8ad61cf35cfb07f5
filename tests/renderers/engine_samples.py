"""What the engine's samples hold, field by field, for tests of small pictures."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.frozen import frozen
from renderers.vanilla import frame_lanes
from stimuli.scene import Scene
from tests.renderers.scenes_by_hand import diffuse, quad

WALL = quad((-3, -3, 0), (6, 0, 0), (0, 6, 0), diffuse((0.5, 0.25, 1.0)))
RATE = Fraction(240)


def sampled(
    subject: Scene, size_px: tuple[int, int] = (9, 7), t1: float = 0.0, rng: bool = False, **options: Any
) -> dict[str, np.ndarray]:
    """Every field of the samples of one small picture at t1, in scanline order."""
    in_sample = {k: options.pop(k) for k in ("light_samples", "want_motion") if k in options}
    engine = Engine(subject, **options)
    pixel, x, y = frame_lanes(size_px)
    state = engine.state(view_at(0, RATE, Fraction(t1), size_px, subject.camera))

    def kernel(state: Any, pixel: Any, x: Any, y: Any) -> Any:
        return engine.sample(state, engine.camera_ray(state, x, y), rng=pixel + 1 if rng else None, **in_sample)

    found = frozen(kernel)(size_px[0] * size_px[1], state, pixel, x, y)
    back = np.argsort(pixel.numpy())
    out = {}
    for name, value in [*vars(found).items(), *found.rays.items()]:
        if name not in ("rays", "shown"):
            array = value.numpy()
            array = np.broadcast_to(array, (*array.shape[:-1], back.size))
            out[name] = array[..., back].T
    return out


def middle(values: np.ndarray) -> np.ndarray:
    """The middle row of (N, ...) values."""
    return values[len(values) // 2]
