"""Adaptive and traditional frameless rendering of small scenes, and their extremes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from renderers.adaptive_frameless import buffers as c
from renderers.adaptive_frameless.overlay import tile_borders
from renderers.adaptive_frameless.technique import AdaptiveFrameless
from renderers.adaptive_frameless.traditional import TraditionalFrameless
from renderers.backend import dr
from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.parameters import AdaptiveFrameless as Adaptive
from renderers.parameters import Reference
from renderers.parameters import TraditionalFrameless as Traditional
from renderers.reference import ReferenceRenderer
from stimuli.encode import display_values
from stimuli.errors import InputError
from tests.renderers.scenes import SlidingCamera, noise_pixels, quad, scene_of, unlit, velocity_for

SIZE = (32, 24)
RATE = Fraction(60)


def wall(block: int = 32, camera=None, extra: tuple = ()):
    """A wall of random blocks at distance 2 (a pixel of a 24 px picture is 0.096 wide there)."""
    return scene_of(
        quad((-48, -48, -2), (96, 0, 0), (0, 96, 0), unlit(noise_pixels(3, block=block)), repeats=16.0),
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


def test_a_static_scene_sharpens_to_the_antialiased_picture() -> None:
    # tilted white bars on black: edges that one sample a pixel shows as stairs
    bars = [quad((-3 + k, -2, -2), (0.4, 0.1, 0), (0.7, 4, 0), unlit(), f"bar {k}") for k in range(6)]
    engine = Engine(scene_of(*bars))
    made, frames = run(engine, 90, samples_per_s=20_000.0)
    wanted = ideal(engine, 0)
    errors = [rms(frame, wanted) for frame in frames]
    assert errors[-1] < 0.6 * errors[0]  # the first fill is one sample a pixel
    shown = made.show(views(engine, 1)[0])
    assert shown["gradient.T"].max() < 1e-3
    assert shown["gradient.X"].max() > 0.05


def test_a_sliding_picture_shows_no_stale_trail_when_reprojected() -> None:
    """At a sixth of the pixels a refresh it is nearer to what is there now than a whole picture a frame late, and far
    nearer than without reprojection. (60 % of the late picture's error needs two fifths of the pixels here: most of
    this small picture is edges.)"""
    engine = Engine(wall(camera=SlidingCamera(velocity_for((1.5, 0.0), 2.0, SIZE[1], 60.0))))
    at = range(39, 60, 4)
    shown = {k: display_values(ideal(engine, k), 1.0) for at_k in at for k in (at_k, at_k - 1)}
    wanted = np.array([shown[k] for k in at])
    late = rms(np.array([shown[k - 1] for k in at]), wanted)
    error = {}
    for reproject, share in ((True, 1 / 6), (False, 1 / 6), (True, 0.4)):
        _, frames = run(engine, 60, samples_per_s=share * SIZE[0] * SIZE[1] * 60, reproject=reproject)
        error[reproject, share] = rms(np.array([display_values(frames[k], 1.0) for k in at]), wanted)
    assert error[True, 1 / 6] < 0.85 * late
    assert error[True, 1 / 6] < 0.5 * error[False, 1 / 6]
    assert error[True, 0.4] < 0.7 * late


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


def test_debug_pictures_have_the_pictures_size(still: Engine) -> None:
    made, frames = run(still, 4, samples_per_s=20_000.0)
    shown = made.show(views(still, 1)[0])
    assert set(shown) == {
        "tiling", "gradients", "gradient.X", "gradient.Y", "gradient.T", "density", "samples", "occlusions", "age",
    }  # fmt: skip
    for name, picture in shown.items():
        assert picture.shape == (SIZE[1], SIZE[0], 3)[: 3 if name in ("tiling", "gradients") else 2], name
        assert not np.isnan(picture).any(), name
    # the density over the whole picture is the budget
    assert shown["density"].sum() == pytest.approx(20_000.0, rel=1e-4)
    border = tile_borders(made.sampler.buffers, made.sampler.settings)
    np.testing.assert_array_equal(shown["tiling"][border], 1.0)
    np.testing.assert_allclose(shown["tiling"][~border], display_values(frames[-1], 1.0)[~border])
    np.testing.assert_allclose(shown["gradients"].reshape(-1, 3).max(axis=0)[:2], 1.0)


@pytest.mark.parametrize("rate", [1e-3, 59.0, 1e6])
def test_tiny_and_huge_budgets_render(still: Engine, rate: float) -> None:
    _, frames = run(still, 4, samples_per_s=rate)
    assert all(np.isfinite(frame).all() for frame in frames)
    assert rms(frames[-1], ideal(still, 3)) < 0.045
    if rate < 100:
        # the first fill stands, under filters that hold four of its samples
        assert rms(frames[-1], frames[0]) < 0.035


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


@pytest.mark.parametrize(
    ("launches", "rate", "visits"),
    [
        (None, 60_000.0, [100, 66]),
        (None, 9000.0, [25]),
        (None, 12_000.0, [25, 8]),
        (None, 30_000.0, [50, 33]),
        (None, 100.0, []),
        (1, 60_000.0, [166]),
        (1, 100.0, []),
        (100, 12_000.0, [25, 8]),
    ],
)
def test_a_refresh_is_traced_in_so_many_launches_and_the_tiling_adjusted_after_each_chunk(
    still: Engine, launches: int | None, rate: float, visits: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = {} if launches is None else {"launches": launches}
    made = AdaptiveFrameless(still, SIZE, Adaptive(samples_per_s=rate, **chosen), 0, "total")
    first, second = views(still, 2)
    made.render(first)
    launched, trace = [], made._rays.trace
    monkeypatch.setattr(made._rays, "trace", lambda *told: launched.append(len(told[1]) // 6) or trace(*told))
    made.render(second)
    assert launched == visits
    assert made.sampler.buffers.number[c.CHUNKS] == sum(-(-count // 25) for count in visits)


def test_pictures_are_the_same_to_the_byte_on_any_number_of_threads() -> None:
    camera = SlidingCamera(velocity_for((1.5, 0.5), 2.0, SIZE[1], 60.0))
    engine = Engine(wall(camera=camera))
    before, pictures = dr.thread_count(), []
    try:
        for threads in (1, 2, 3):
            dr.set_thread_count(threads)
            pictures.append(run(engine, 8, samples_per_s=60_000.0)[1])
    finally:
        dr.set_thread_count(before)
    np.testing.assert_array_equal(pictures[0], pictures[1])
    np.testing.assert_array_equal(pictures[0], pictures[2])
