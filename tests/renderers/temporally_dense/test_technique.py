"""Every element of the temporally dense paper that needs real rays (the table of the technique's notes)."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.parameters import TemporallyDense as Params
from renderers.parameters import Vanilla as VanillaParams
from renderers.temporally_dense.pixel_order import STATIC_JITTER
from renderers.temporally_dense.technique import TemporallyDense
from renderers.vanilla import Vanilla
from stimuli.scene import Mover, StillCamera
from tests.renderers.scenes import SlidingCamera, mirror, noise_pixels, quad, scene_of, unlit, velocity_for

RATE = Fraction(240)
WALL = quad((-8, -8, -4), (16, 0, 0), (0, 16, 0), unlit(noise_pixels(1, 256, 2)), "wall")
STILL = StillCamera(np.eye(4), np.pi / 3)


def views(count, size, camera, first=0, cuts=(0,)):
    return [view_at(k, RATE, Fraction(1), size, camera, cut=k in cuts) for k in range(first, first + count)]


def render(scene, camera, size, count, params=None, seed=0, cuts=(0,)):
    technique = TemporallyDense(Engine(scene), size, params or Params(), seed, "total")
    return [
        (technique, np.array(frame.color), dict(frame.rays))
        for frame in map(technique.render, views(count, size, camera, cuts=cuts))
    ]


@pytest.mark.parametrize("size", [(16, 8), (15, 8), (16, 9), (15, 9), (1, 1)])
def test_exactly_one_ray_a_tile_and_frame(size) -> None:
    technique = TemporallyDense(Engine(scene_of(WALL)), size, Params(), 0, "total")
    for view in views(5, size, STILL):
        assert technique.render(view).rays["primary"] == -(-size[0] // 2) * -(-size[1] // 2)


def test_orders_change_only_every_four_frames() -> None:
    camera = SlidingCamera(velocity_for((1.3, 0.9), 4, 32, 240))
    technique = TemporallyDense(Engine(scene_of(WALL)), (32, 32), Params(order="random"), 5, "total")
    orders = []
    for view in views(12, (32, 32), camera):
        technique.render(view)
        orders.append(technique.show(view)["segmentation"].copy())
    for n in range(12):
        same = np.array_equal(orders[n], orders[n // 4 * 4])
        assert same, n
    assert not np.array_equal(orders[0], orders[4])
    assert not np.array_equal(orders[4], orders[8])


def test_a_static_scene_converges_to_the_four_times_supersampled_picture_and_stays() -> None:
    size = (20, 14)
    engine = Engine(scene_of(WALL))
    oracle = np.zeros((size[1], size[0], 3), np.float32)
    total = np.zeros_like(oracle)
    for at_x, at_y in STATIC_JITTER:
        shifted = Vanilla(engine, size, VanillaParams(), 0, "total")
        shifted._x, shifted._y = shifted._x + (at_x - 0.5), shifted._y + (at_y - 0.5)
        total = total + np.array(shifted.render(view_at(0, RATE, Fraction(1), size, STILL, cut=True)).color)
    oracle = total / np.float32(4)
    technique = TemporallyDense(engine, size, Params(), 0, "total")
    frames = [np.array(technique.render(view).color) for view in views(44, size, STILL)]
    np.testing.assert_allclose(frames[20], oracle, atol=1e-6)
    for frame in frames[20:]:
        np.testing.assert_array_equal(frame, frames[20])


def test_dynamic_pixels_are_traced_at_their_centres() -> None:
    size = (24, 16)
    camera = SlidingCamera(velocity_for((2.6, 0.0), 4, 16, 240))
    engine = Engine(scene_of(WALL))
    vanilla = Vanilla(engine, size, VanillaParams(), 0, "total")
    technique = TemporallyDense(engine, size, Params(), 0, "total")
    for view in views(9, size, camera):
        frame = np.array(technique.render(view).color)
        new = technique.show(view)["class"] >= 2
        truth = np.array(vanilla.render(view).color)
        assert truth.std() > 0.01
        np.testing.assert_array_equal(frame[new], truth[new])


def test_a_whole_pixel_motion_is_reprojected_without_loss_in_the_bowtie_order() -> None:
    size = (48, 48)
    camera = SlidingCamera(velocity_for((1.0, 0.0), 4, 48, 240))
    engine = Engine(scene_of(quad((-8, -8, -4), (16, 0, 0), (0, 16, 0), unlit(noise_pixels(1, 64, 8)), "wall")))
    vanilla = Vanilla(engine, size, VanillaParams(), 0, "total")

    def error(order: str) -> float:
        technique = TemporallyDense(engine, size, Params(order=order), 0, "total")
        total = 0.0
        for n, view in enumerate(views(24, size, camera)):
            frame = np.array(technique.render(view).color)
            if n >= 8:
                total += float(np.mean((frame - np.array(vanilla.render(view).color)) ** 2))
        return total

    assert 0 < error("bowtie") < error("hourglass")


def test_the_camera_starting_and_stopping_leaves_no_stale_sample() -> None:
    size = (24, 16)
    engine = Engine(scene_of(WALL))
    camera = SlidingCamera(velocity_for((1.5, 0.5), 4, 16, 240), from_s=1 + 20 / 240, to_s=1 + 40 / 240)
    technique = TemporallyDense(engine, size, Params(), 0, "total")
    frames = [np.array(technique.render(view).color) for view in views(84, size, camera)]
    again = TemporallyDense(engine, size, Params(), 0, "total")
    end = StillCamera(camera.pose(np.array([9.0]))[0], camera.yfov_rad)
    rested = [np.array(again.render(view).color) for view in views(84, size, end)]
    np.testing.assert_array_equal(frames[83], rested[83])  # converged to the picture from the new place


def test_a_cut_forgets_the_picture_before() -> None:
    size = (16, 16)
    engine = Engine(scene_of(WALL))
    camera = SlidingCamera(velocity_for((0.7, 0.0), 4, 16, 240))
    technique = TemporallyDense(engine, size, Params(), 3, "total")
    with_cut = [np.array(technique.render(view).color) for view in views(12, size, camera, cuts=(0, 6))]
    fresh = TemporallyDense(engine, size, Params(), 3, "total")
    restarted = [np.array(fresh.render(view).color) for view in views(6, size, camera, first=6, cuts=(6,))]
    for a, b in zip(with_cut[6:], restarted, strict=True):
        np.testing.assert_array_equal(a, b)


def test_reflected_motion_beats_surface_motion_on_a_textured_mirror() -> None:
    size = (40, 40)
    # a mirror ahead shows a textured wall behind the camera, twice as far away
    behind = quad((-40, -40, 4), (80, 0, 0), (0, 80, 0), unlit(noise_pixels(4, 256, 4)), "behind")
    scene = scene_of(quad((-40, -40, -4), (80, 0, 0), (0, 80, 0), mirror(), "mirror"), behind)
    camera = SlidingCamera(velocity_for((3.0, 0.0), 12, 40, 240))
    engine = Engine(scene)
    vanilla = Vanilla(engine, size, VanillaParams(), 0, "total")

    def error(reflected: bool) -> float:
        technique = TemporallyDense(engine, size, Params(reflected_motion=reflected), 0, "total")
        total = 0.0
        for n, view in enumerate(views(20, size, camera)):
            frame = np.array(technique.render(view).color)
            if n >= 8:
                total += float(np.mean((frame - np.array(vanilla.render(view).color)) ** 2))
        return total

    assert 0 < error(True) < 0.8 * error(False)


def test_only_tiles_near_a_mover_are_dynamic() -> None:
    size = (32, 32)
    box = quad((-0.3, -0.3, -2), (0.6, 0, 0), (0, 0.6, 0), unlit(color=(1, 0, 0)), "box")

    class Track:
        def pose(self, time_s):
            poses = np.tile(np.eye(4), (np.size(time_s), 1, 1))
            poses[:, 0, 3] = 2.0 * (np.atleast_1d(time_s) - 1.0)
            return poses

    technique = TemporallyDense(
        Engine(scene_of(WALL, movers=(Mover("box", (box,), Track()),))), size, Params(), 0, "total"
    )
    for view in views(6, size, STILL):
        technique.render(view)
    classes = technique.show(view)["class"] % 2
    assert classes[14:18, 14:18].all()  # on the mover
    assert not classes[:6].any()  # far above it
    assert not classes[:, :4].any()


def test_the_adaptive_order_pays_where_the_paper_says() -> None:
    from tests.prove.temporally_dense_orders import measure

    found = measure((0.0, 12.0, 45.0), (1,), 48, 8, 2)  # a fraction of `make prove`
    mean = {angle: {order: np.mean(values) for order, values in orders.items()} for angle, orders in found.items()}
    assert mean[0.0]["adaptive"] < min(mean[0.0][order] for order in ("hourglass", "bowtie", "random"))
    assert mean[12.0]["adaptive"] < mean[12.0]["random"]
    assert mean[45.0]["adaptive"] == mean[45.0]["random"]


class TurningCamera:
    """Turns about the vertical axis by ``degrees_per_s``."""

    yfov_rad = np.pi / 3
    name = "turning"

    def __init__(self, degrees_per_s: float) -> None:
        self.degrees_per_s = degrees_per_s

    def pose(self, time_s):
        angle = np.radians(self.degrees_per_s) * (np.atleast_1d(np.asarray(time_s, float)) - 1.0)
        poses = np.tile(np.eye(4), (len(angle), 1, 1))
        poses[:, 0, 0], poses[:, 0, 2] = np.cos(angle), np.sin(angle)
        poses[:, 2, 0], poses[:, 2, 2] = -np.sin(angle), np.cos(angle)
        return poses


def test_a_turning_camera_is_reprojected_better_than_the_mosaic() -> None:
    size = (40, 32)
    engine = Engine(scene_of(quad((-20, -20, -4), (40, 0, 0), (0, 40, 0), unlit(noise_pixels(6, 256, 4)), "wall")))
    camera = TurningCamera(120.0)  # about 0.4 px a frame
    vanilla = Vanilla(engine, size, VanillaParams(), 0, "total")

    def error(reproject: bool) -> float:
        technique = TemporallyDense(engine, size, Params(reproject=reproject), 0, "total")
        total = 0.0
        for n, view in enumerate(views(20, size, camera)):
            frame = np.array(technique.render(view).color)
            if n >= 8:
                total += float(np.mean((frame - np.array(vanilla.render(view).color)) ** 2))
        return total

    assert 0 < error(True) < 0.8 * error(False)
