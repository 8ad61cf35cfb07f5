"""What adaptive frameless rendering is for: no stale trails, quick disocclusions, less error at the same samples."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest

from renderers.adaptive_frameless.technique import AdaptiveFrameless
from renderers.catalogue import TECHNIQUES
from renderers.clip_frames import technique_params, view_at
from renderers.engine import Engine
from stimuli.encode import display_values
from stimuli.scene import Light, Mover
from tests.renderers.scenes import SlidingCamera, noise_pixels, quad, scene_of, unlit, velocity_for
from tests.renderers.scenes_by_hand import Drift, diffuse

SIZE, RATE = (48, 36), Fraction(60)
PIXEL = 2 * np.tan(np.pi / 6) / SIZE[1]
"""A pixel's size one unit ahead."""


def wall(camera=None, extra: tuple = (), movers: tuple = ()) -> Engine:
    """A wall of random blocks, 12 px each, at distance 2."""
    blocks = quad((-48, -48, -2), (96, 0, 0), (0, 96, 0), unlit(noise_pixels(3, block=32)), repeats=16.0)
    return Engine(scene_of(blocks, *extra, camera=camera, movers=movers))


def frames(engine: Engine, technique: str, count: int, seed: int = 0, **params) -> list[np.ndarray]:
    """Display values of ``count`` refreshes from second 1 on."""
    made = TECHNIQUES[technique](engine, SIZE, technique_params(technique, params), seed, "total")
    views = [view_at(k, RATE, Fraction(1), SIZE, engine.scene.camera, cut=k == 0) for k in range(count)]
    return [display_values(np.array(made.render(view).color), 1.0) for view in views]


def ideal(engine: Engine, ks) -> dict[int, np.ndarray]:
    made = TECHNIQUES["reference"](engine, SIZE, technique_params("reference", {"spp": 64}), 0, "total")
    views = {k: view_at(k, RATE, Fraction(1), SIZE, engine.scene.camera, cut=True) for k in ks}
    return {k: display_values(np.array(made.render(view).color), 1.0) for k, view in views.items()}


def rms(shown: list[np.ndarray], wanted: dict[int, np.ndarray], mask: dict[int, np.ndarray] | None = None) -> float:
    """Over the refreshes of ``wanted`` (and the pixels of ``mask``)."""
    squares = [((shown[k] - wanted[k]) ** 2)[... if mask is None else mask[k]] for k in wanted]
    return float(np.sqrt(np.mean(np.concatenate([values.ravel() for values in squares]))))


def columns(first_px: float, last_px: float) -> np.ndarray:
    """(H, W) bool: pixels whose centres lie between two places along x."""
    x = np.arange(SIZE[0]) + 0.5
    return np.broadcast_to((x > first_px) & (x < last_px), SIZE[::-1])


def test_a_moving_object_leaves_no_stale_trail() -> None:
    """A white bar crosses at 60 px/s; compared is where it was during the last third of a second, and is no more."""
    speed_px, step = 60.0, 2 * PIXEL
    bar = quad((-0.25, -2, 0), (0.5, 0, 0), (0, 4, 0), unlit(), "bar")
    track = Drift((-1.9 - speed_px * step, 0, -1.99), (speed_px * step, 0, 0))
    engine = wall(movers=(Mover("bar", (bar,), track),))
    wanted = ideal(engine, range(20, 50, 6))
    left_px = {k: 24 + (-0.25 - 1.9) / step + speed_px * k / 60 for k in wanted}
    trail = {k: columns(left - speed_px / 3, left - 1) for k, left in left_px.items()}
    adaptive, stay, traditional = (
        rms(frames(engine, technique, 50, samples_per_s=12_000.0, **params), wanted, trail)
        for technique, params in (
            ("adaptive_frameless", {}), ("adaptive_frameless", {"reproject_movers": False}),
            ("traditional_frameless", {}),
        )
    )  # fmt: skip
    assert adaptive < 0.1
    assert adaptive < 0.5 * stay < 0.5 * traditional


BOARD = quad((-0.3, -2, -1), (0.6, 0, 0), (0, 4, 0), unlit(color=(0.5, 0.5, 0.5)), "board")
SLIDE = velocity_for((-1.0, 0.0), 1.0, SIZE[1], 60.0)


def uncovered_px(k: int) -> tuple[float, float]:
    """The columns from which the board has moved away during the last quarter of a second: it moves a pixel a refresh
    to the left, the wall behind it half a pixel."""
    right = 24 + (0.3 - SLIDE[0] * k / 60) / PIXEL
    return right, right + 7.5


def test_disocclusion_is_filled_sooner_than_by_traditional_frameless() -> None:
    engine = wall(camera=SlidingCamera(SLIDE), extra=(BOARD,))
    wanted = ideal(engine, range(12, 36, 4))
    strip = {k: columns(*uncovered_px(k)) for k in wanted}
    adaptive, traditional, seldom = (
        rms(frames(engine, technique, 36, samples_per_s=12_000.0, **params), wanted, strip)
        for technique, params in (
            ("adaptive_frameless", {}), ("traditional_frameless", {}), ("framed_low_rate", {"delay_frames": 1}),
        )
    )  # fmt: skip
    assert adaptive < 0.7 * traditional
    assert adaptive < 0.7 * seldom


def test_disocclusion_gets_more_samples_with_the_terms_of_undersampling_and_occlusion() -> None:
    engine = wall(camera=SlidingCamera(SLIDE), extra=(BOARD,))
    share = {}
    for name, weights in (("with", {"kappa": 0.4, "lambda_": 0.4}), ("without", {"kappa": 0.0, "lambda_": 0.0})):
        found = []
        for seed in range(3):
            params = technique_params("adaptive_frameless", {"samples_per_s": 12_000.0, **weights})
            made = AdaptiveFrameless(engine, SIZE, params, seed, "total")
            for k in range(36):
                view = view_at(k, RATE, Fraction(1), SIZE, engine.scene.camera, cut=k == 0)
                made.render(view)
                b = made.sampler.buffers
                x_px = b.stream_f[:, 6][b.stream_t > float(view.t0)]
                left, right = uncovered_px(k)
                if k >= 12:
                    found.append(((x_px > left) & (x_px < right)).mean())
        share[name] = float(np.mean(found))
    assert share["with"] > 1.25 * share["without"]


@pytest.mark.parametrize("motion_px", [0.25, 1.0])
def test_adaptive_has_the_least_error_at_the_same_samples_on_a_moving_wall(motion_px: float) -> None:
    engine = wall(camera=SlidingCamera(velocity_for((motion_px, 0.0), 2.0, SIZE[1], 60.0)))
    wanted = ideal(engine, range(30, 60, 8))
    budget = 0.1 * SIZE[0] * SIZE[1] * 60  # a tenth of the pixels a refresh, as 400k at 256x256
    error = {
        technique: rms(frames(engine, technique, 60, samples_per_s=budget, **params), wanted)
        for technique, params in (
            ("adaptive_frameless", {}), ("traditional_frameless", {}), ("framed_low_rate", {"delay_frames": 1}),
            ("framed_low_resolution", {"delay_frames": 1}),
        )
    }  # fmt: skip
    print(motion_px, error)
    assert min(error, key=error.__getitem__) == "adaptive_frameless"
    assert error["adaptive_frameless"] < 0.7 * error["traditional_frameless"]


@dataclass(frozen=True)
class Strobe:
    """A light's track: where it belongs in every even ``period_s``, far behind the wall in every odd one."""

    period_s: float
    until_s: float

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        time_s = np.atleast_1d(np.asarray(time_s, float))
        away = (np.floor(time_s / self.period_s) % 2 == 1) & (time_s < self.until_s)
        poses = np.tile(np.eye(4), (time_s.size, 1, 1))
        poses[away, 2, 3] = -100.0
        return poses


def test_a_strobing_scene_is_followed_and_comes_to_rest() -> None:
    """The lamp is gone in every other tenth of a second; then it stays, and so does the picture."""
    wall_part = quad((-4, -4, -2), (8, 0, 0), (0, 8, 0), diffuse((0.7, 0.5, 0.4)), "wall")
    lamp = Light("point", (10.0, 10.0, 10.0), position=(0.5, 0.5, 0.0), track=Strobe(0.1, 2.0))
    engine = Engine(scene_of(wall_part, lights=(lamp,)))
    strobing = range(10, 60, 3)
    wanted = ideal(engine, [*strobing, 99])
    shown, old = (
        frames(engine, technique, 100, samples_per_s=12_000.0)
        for technique in ("adaptive_frameless", "traditional_frameless")
    )
    during = {k: wanted[k] for k in strobing}
    assert all(np.isfinite(picture).all() for picture in shown)
    assert rms(shown, during) < 0.9 * rms(old, during)
    assert rms(shown, {99: wanted[99]}) < 0.01
