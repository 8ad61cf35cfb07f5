"""A sampler without a scene: colours come from a function of place and time, so that every answer is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from renderers.adaptive_frameless import rays
from renderers.adaptive_frameless.buffers import Settings
from renderers.adaptive_frameless.sampler import Poses, Sampler
from renderers.adaptive_frameless.technique import sampler_settings
from renderers.parameters import AdaptiveFrameless

Shown = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""(x, y in pixels, absolute seconds) -> display luma in [0, 1]."""


def linear(shown: np.ndarray) -> np.ndarray:
    """Linear light that sRGB shows as ``shown``."""
    shown = np.asarray(shown, np.float64)
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def still_poses(size_px: tuple[int, int], t1_s: float, shift_px: float = 0.0, span_s: float = -1 / 60) -> Poses:
    """A camera that looks down -z at the plane z = -1, on which a pixel is one unit; it slides by ``shift_px``."""
    camera = np.zeros((2, 3, 4))
    camera[:, :, :3] = np.eye(3)
    camera[1, 0, 3] = -shift_px
    return Poses(
        camera, np.tile(np.eye(3, 4), (1, 2, 1, 1)), np.array([[-np.inf, np.inf]]),
        np.array([span_s, size_px[0] / 2, size_px[1] / 2, 1.0]), t1_s,
    )  # fmt: skip


def found_at(rows: np.ndarray, poses: Poses, shown: Shown, hidden: np.ndarray | None = None) -> np.ndarray:
    """What rays would find: grey of ``shown`` on the plane z = -1 under a camera that does not move."""
    found = np.zeros((len(rows), rays.OUT), np.float32)
    time_s = poses.t1_s + rows[:, 2].astype(np.float64)
    found[:, rays.LUMA] = shown(rows[:, 0], rows[:, 1], time_s)
    found[:, :3] = linear(found[:, rays.LUMA])[:, None]
    found[:, rays.LOCAL_X] = rows[:, 0] - poses.lens[1] + poses.camera[1, 0, 3]
    found[:, rays.LOCAL_Y] = poses.lens[2] - rows[:, 1]
    found[:, rays.LOCAL_Z] = -1.0
    found[:, rays.VISIBLE] = 1.0
    if hidden is not None:
        found[:, rays.VISIBLE] = ~hidden
    return found


class FakeRun:
    """A sampler fed by ``shown``. `run` advances by chunks of 25 visits at ``visits_per_s``."""

    def __init__(self, size_px: tuple[int, int], shown: Shown, seed: int = 0, **params: object) -> None:
        self.size_px, self.shown = size_px, shown
        self.params = AdaptiveFrameless(**params)  # type: ignore[arg-type]
        self.settings: Settings = sampler_settings(size_px, self.params, 1.0)
        self.sampler = Sampler(self.settings, 4 * size_px[0] * size_px[1], np.random.default_rng(seed))
        self.now_s = 0.0
        self.rows: list[np.ndarray] = []
        y, x = np.mgrid[0 : size_px[1], 0 : size_px[0]]
        grid = np.zeros((size_px[0] * size_px[1], rays.IN), np.float32)
        grid[:, 0], grid[:, 1] = x.ravel() + 0.5, y.ravel() + 0.5
        self.sampler.first_fill(0.0, found_at(grid, still_poses(size_px, 0.0), shown))

    def run(self, visits: int, visits_per_s: float = 1000.0, adjust: bool = True) -> None:
        """Take ``visits`` visits."""
        while visits > 0:
            count = min(25, visits)
            visits -= count
            end_s = self.now_s + count / visits_per_s
            times_s = -np.arange(count - 1, -1, -1) / visits_per_s
            poses = still_poses(self.size_px, end_s, span_s=-count / visits_per_s)
            chunk = self.sampler.plan(poses, times_s)
            self.sampler.take_in(poses, chunk, found_at(chunk.rows, poses, self.shown))
            if adjust:
                self.sampler.adjust(end_s)
            self.rows.append(chunk.rows)
            self.now_s = end_s
