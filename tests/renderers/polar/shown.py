"""A scene through `Polar`, frame by frame, and poses as functions of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.parameters import Polar as Parameters
from renderers.polar.technique import Polar
from renderers.technique import Frame
from renderers.vanilla import Vanilla
from stimuli.scene import Scene
from tests.renderers.scenes import noise_pixels, scene_of, unlit
from tests.renderers.scenes import quad as textured_quad

RATE = Fraction(60)
WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Path:
    """A camera or track whose pose is any function of time."""

    at: Callable[[float], np.ndarray]
    yfov_rad: float = np.pi / 3
    name: str = "path"

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        return np.stack([self.at(float(t)) for t in np.atleast_1d(time_s)])


def shift(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def turn(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])


def polar(scene: Scene, size_px: tuple[int, int], **params: object) -> Polar:
    return Polar(Engine(scene), size_px, Parameters(**params), 0, "total")


def show(technique: Polar | Vanilla, k: int = 0, gaze: tuple[float, float] | None = None, **more: object) -> Frame:
    scene = technique.engine.scene
    view = view_at(k, RATE, Fraction(0), technique.size_px, scene.camera, gaze)
    return technique.render(replace(view, **more))


def wall_of_noise(block: int = 4) -> Scene:
    """A wall that fills the field, of random colours."""
    return scene_of(textured_quad((-4, -3, -3), (8, 0, 0), (0, 6, 0), unlit(64 + noise_pixels(3, 256, block) // 2)))
