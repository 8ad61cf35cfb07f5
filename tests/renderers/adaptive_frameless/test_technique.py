"""Adaptive and traditional frameless rendering of small scenes, and their extremes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from renderers.adaptive_frameless.overlay import tiling_over
from renderers.adaptive_frameless.technique import AdaptiveFrameless
from renderers.adaptive_frameless.traditional import TraditionalFrameless
from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.parameters import AdaptiveFrameless as Adaptive
from renderers.parameters import Reference
from renderers.parameters import TraditionalFrameless as Traditional
from renderers.reference import ReferenceRenderer
from stimuli.errors import InputError
from tests.renderers.scenes import SlidingCamera, noise_pixels, quad, scene_of, unlit, velocity_for

SIZE = (32, 24)
RATE = Fraction(60)


def wall(block: int = 32, camera=None, extra: tuple = ()):
    """A wall of random blocks at distance 2 (a pixel of a 24 px picture is 0.096 wide there)."""
    return scene_of(
        quad((-6, -6, -2), (12, 0, 0), (0, 12, 0), unlit(noise_pixels(3, block=block)), repeats=2.0),
        *extra,
        camera=camera,
    )


@pytest.fixture(scope="module")
def still():
    return Engine(wall())


def views(engine: Engine, count: int, size_px=SIZE, start_s: Fraction = Fraction(1)):
    camera = engine.scene.camera
    return [view_at(k, RATE, start_s, size_px, camera, cut=k == 0) for k in range(count)]


def run(engine: Engine, count: int, size_px=SIZE, **params):
    made = AdaptiveFrameless(engine, size_px, Adaptive(**params), 0, "total")
    return made, [np.array(made.render(view).color) for view in views(engine, count, size_px)]


def ideal(engine: Engine, index: int, size_px=SIZE) -> np.ndarray:
    made = ReferenceRenderer(engine, size_px, Reference(spp=64), 0, "total")
    return made.render(views(engine, index + 1, size_px)[index]).color


def rms(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((np.asarray(a, np.float64) - b) ** 2)))


def test_a_static_scene_sharpens_to_the_antialiased_picture(still: Engine) -> None:
    made, frames = run(still, 90, samples_per_s=20_000.0)
    wanted = ideal(still, 0)
    errors = [rms(frame, wanted) for frame in frames]
    assert errors[-1] < 0.6 * errors[0]  # the first fill is one sample a pixel: aliased
    assert errors[-1] < 0.06
    shown = made.show(views(still, 1)[0])
    assert shown["gradient.T"].max() < 1e-3
    assert shown["gradient.X"].max() > 0.05


@pytest.mark.parametrize("reproject", [True, False])
def test_a_sliding_picture_shows_no_stale_trail_when_reprojected(reproject: bool) -> None:
    camera = SlidingCamera(velocity_for((1.5, 0.0), 2.0, SIZE[1], 60.0))
    engine = Engine(wall(camera=camera))
    _, frames = run(engine, 60, samples_per_s=8000.0, reproject=reproject)
    error = rms(frames[-1], ideal(engine, 59))
    late = rms(ideal(engine, 58), ideal(engine, 59))
    assert (error < 0.6 * late) == reproject


def test_frames_are_at_their_own_time_without_delay() -> None:
    """Every sample carries the camera of its own time: without reprojection it shows the scene as it then was."""
    camera = SlidingCamera(velocity_for((2.0, 0.0), 2.0, SIZE[1], 60.0))
    engine = Engine(wall(block=128, camera=camera))
    made, _ = run(engine, 3, samples_per_s=30_000.0)
    b = made.sampler.buffers
    kept = int(b.number[8])
    times = b.stream_t[:kept]
    assert len(np.unique(times[SIZE[0] * SIZE[1] :])) > 100
    # a hit point on the wall and the place in the picture agree through the camera at the sample's own time
    state_scale, center = engine.space.scale, np.asarray(engine.space.center)
    world = b.stream_f[:kept, 3:6] / state_scale + center
    pose = camera.pose(times)
    own = world - pose[:, :3, 3]
    pixel = 2 * np.tan(camera.yfov_rad / 2) / SIZE[1]
    x = SIZE[0] / 2 + own[:, 0] / (-own[:, 2] * pixel)
    np.testing.assert_allclose(x, b.stream_f[:kept, 6], atol=2e-2)


def test_rays_are_six_a_visit_within_the_budget(still: Engine) -> None:
    made = AdaptiveFrameless(still, SIZE, Adaptive(samples_per_s=7200.0), 0, "stages")
    counts = [made.render(view) for view in views(still, 31)]
    assert counts[0].rays["primary"] == SIZE[0] * SIZE[1]
    assert all(frame.rays["primary"] % 6 == 0 for frame in counts[1:])
    assert sum(frame.rays["primary"] for frame in counts[1:]) == 7200 // 2
    assert 0 < sum(frame.rays["visibility"] for frame in counts[1:]) <= 5 * 600
    assert {"state", "control", "trace", "reconstruct", "total"} <= set(counts[-1].seconds)


def test_traditional_shows_each_pixel_once_in_every_round(still: Engine) -> None:
    pixels = SIZE[0] * SIZE[1]
    made = TraditionalFrameless(still, SIZE, Traditional(samples_per_s=pixels * 60 / 4), 0, "total")
    sheets = [made.render(view) for view in views(still, 5)]
    assert [frame.rays["primary"] for frame in sheets] == [pixels] + [pixels // 4] * 4
    camera = SlidingCamera(velocity_for((1.5, 0.0), 2.0, SIZE[1], 60.0))
    engine = Engine(wall(camera=camera))
    made = TraditionalFrameless(engine, SIZE, Traditional(samples_per_s=pixels * 60 / 4), 0, "total")
    frames = [np.array(made.render(view).color) for view in views(engine, 9)]
    for a, b in ((0, 1), (3, 4), (7, 8)):
        changed = (frames[a] != frames[b]).any(axis=2).mean()
        assert 0.05 < changed <= 0.25
    assert (frames[4] != frames[8]).any(axis=2).mean() > 0.5


def test_adaptive_is_ahead_of_traditional_at_the_same_rate() -> None:
    camera = SlidingCamera(velocity_for((1.5, 0.5), 2.0, SIZE[1], 60.0))
    engine = Engine(wall(camera=camera))
    _, frames = run(engine, 40, samples_per_s=6000.0)
    made = TraditionalFrameless(engine, SIZE, Traditional(samples_per_s=6000.0), 0, "total")
    old = [np.array(made.render(view).color) for view in views(engine, 40)]
    wanted = ideal(engine, 39)
    assert rms(frames[-1], wanted) < 0.5 * rms(old[-1], wanted)


def test_disocclusion_gets_samples_sooner_with_the_undersampling_and_occlusion_terms() -> None:
    """A board slides off a wall at once; what it uncovers is emptied by reprojection and must fill."""
    camera = SlidingCamera((0.8, 0.0, 0.0), from_s=1.0)
    board = quad((-0.5, -0.6, -1), (1.0, 0, 0), (0, 1.2, 0), unlit(color=(0.5, 0.5, 0.5)), "board")
    engine = Engine(wall(camera=camera, extra=(board,)))
    drawn = {}
    for name, weights in (("with", {"kappa": 0.5, "lambda_": 0.4}), ("without", {"kappa": 0.0, "lambda_": 0.0})):
        errors = []
        for seed in range(2):
            made = AdaptiveFrameless(engine, (48, 36), Adaptive(samples_per_s=12_000.0, **weights), seed, "total")
            places = []
            for view in views(engine, 40, (48, 36)):
                made.render(view)
                b = made.sampler.buffers
                age = float(view.t1) - b.stream_t[: int(b.number[8])]
                new = b.stream_f[: int(b.number[8])][age < 1 / 61]
                # the uncovered strip: right of the board's right edge, which the camera leaves behind to the left
                edge = 24 + (0.5 - 0.8 * (float(view.t1) - 1.0)) / (2 * np.tan(np.pi / 6) / 36)
                inside = (new[:, 6] > edge) & (new[:, 6] < edge + 4) & (np.abs(new[:, 7] - 18) < 18)
                places.append(inside.mean() if len(new) else 0.0)
            errors.append(np.mean(places[8:]))
        drawn[name] = np.mean(errors)
    assert drawn["with"] > 1.1 * drawn["without"]


def test_debug_pictures_have_the_pictures_size(still: Engine) -> None:
    made, frames = run(still, 4, samples_per_s=20_000.0)
    shown = made.show(views(still, 1)[0])
    assert set(shown) == {
        "tiling", "gradient.X", "gradient.Y", "gradient.T", "density", "samples", "occlusions", "age",
    }  # fmt: skip
    for name, picture in shown.items():
        assert picture.shape == (SIZE[1], SIZE[0]), name
        assert not np.isnan(picture).any(), name
    # the density over the whole picture is the budget
    assert shown["density"].sum() == pytest.approx(20_000.0, rel=1e-4)
    assert tiling_over(frames[-1], made.sampler.buffers, made.sampler.settings).max() == 1.0


@pytest.mark.parametrize("rate", [1e-3, 59.0, 1e6])
def test_tiny_and_huge_budgets_render(still: Engine, rate: float) -> None:
    _, frames = run(still, 4, samples_per_s=rate)
    assert all(np.isfinite(frame).all() for frame in frames)
    if rate < 100:
        np.testing.assert_allclose(frames[-1], frames[0], atol=1e-5)  # the first fill stands


def test_one_pixel_renders(still: Engine) -> None:
    _, frames = run(still, 12, (1, 1), samples_per_s=6000.0)
    assert all(np.isfinite(frame).all() and frame.max() > 0 for frame in frames)


def test_a_black_scene_stays_black() -> None:
    engine = Engine(scene_of())
    made, frames = run(engine, 20, samples_per_s=20_000.0)
    np.testing.assert_array_equal(frames[-1], 0.0)
    assert all(np.isfinite(picture).all() for picture in made.show(views(engine, 1)[0]).values())


def test_a_cut_forgets_and_resets_repeat(still: Engine) -> None:
    made = AdaptiveFrameless(still, SIZE, Adaptive(samples_per_s=20_000.0), 5, "total")
    some = views(still, 6)
    first = [np.array(made.render(view).color) for view in some]
    made.render(view_at(6, RATE, Fraction(1), SIZE, still.scene.camera, cut=True))
    assert made.sampler.buffers.number[8] == SIZE[0] * SIZE[1]
    made.reset(5)
    for view, wanted in zip(some, first, strict=True):
        np.testing.assert_array_equal(made.render(view).color, wanted)


def test_weights_above_one_are_refused(still: Engine) -> None:
    with pytest.raises(InputError, match="kappa"):
        AdaptiveFrameless(still, SIZE, Adaptive(kappa=0.7, lambda_=0.5), 0, "total")


def test_long_runs_neither_grow_nor_record_again(still: Engine) -> None:
    made = AdaptiveFrameless(still, SIZE, Adaptive(samples_per_s=30_000.0), 0, "total")
    sizes, recordings = [], []
    for view in views(still, 60):
        made.render(view)
        sizes.append(sum(array.nbytes for array in made.sampler.buffers))
        recordings.append(made._rays.recordings)
    assert len(set(sizes)) == 1
    assert recordings[-1] <= recordings[5] + 1
    assert recordings[-1] <= 4
