"""Light of every kind against closed forms, on the engine itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from renderers.engine import Engine
from stimuli.scene import Light, Material, StillCamera
from tests.renderers.engine_samples import WALL, sampled
from tests.renderers.scenes_by_hand import box, diffuse, look_at, pbr, quad, scene


def test_point_light_falls_off_with_the_square_and_the_cosine() -> None:
    light = Light("point", (8.0, 4.0, 2.0), (0.0, 0.0, 2.0))
    got = sampled(scene((WALL,), lights=(light,)))
    p = got["point"] * 0  # the wall's points in the world, from the depth
    p = np.array([[(x + 0.5 - 4.5), -(y + 0.5 - 3.5)] for y in range(7) for x in range(9)]) * (
        2 * 5 * np.tan(np.radians(20)) / 7
    )
    d2 = (p**2).sum(1) + 4
    expected = np.array([0.5, 0.25, 1.0]) / np.pi * np.array([8.0, 4.0, 2.0]) * (2 / np.sqrt(d2) / d2)[:, None]
    np.testing.assert_allclose(got["color"], expected, rtol=2e-5)
    np.testing.assert_allclose(got["z"], 5.0, rtol=1e-6)
    assert (got["shadow"] == 1).all()


def test_a_light_without_falloff_gives_the_classic_formula() -> None:
    light = Light("point", (0.5, 0.5, 0.5), (0.0, 0.0, 9.0), falloff="none")
    wall = replace(WALL, material=diffuse((0.5, 0.25, 1.0), specular=(0.0, 0.0, 0.0)))
    got = sampled(scene((wall,), lights=(light,)), (1, 1))
    np.testing.assert_allclose(got["color"][0], [0.25, 0.125, 0.5], rtol=1e-6)


def test_phong_highlight_at_the_mirror_angle_adds_the_specular_colour() -> None:
    light = Light("point", (1.0, 1.0, 1.0), (0.0, 0.0, 5.5), falloff="none")
    wall = replace(WALL, material=diffuse((0.2, 0.2, 0.2), specular=(0.01, 0.02, 0.025), shine=30.0))
    got = sampled(scene((wall,), lights=(light,)), (1, 1))
    np.testing.assert_allclose(got["color"][0], [0.21, 0.22, 0.225], rtol=1e-5)


def test_directional_light_and_its_shadow() -> None:
    light = Light("directional", (3.0, 3.0, 3.0), direction=(0.0, 0.0, -2.0))
    blocker = box((0, 0, 2), (0.2, 0.2, 0.1), diffuse())
    camera = look_at((4, 0, 5), (0, 0, 0), 30)
    got = sampled(scene((WALL, blocker), lights=(light,), camera=camera), (64, 64))
    wall = np.isclose(got["point_local"][:, 2], got["point_local"][:, 2].min(), atol=1e-5)
    world = Engine(scene((WALL, blocker), lights=(light,))).space.world_points(got["point"])
    shaded = wall & (np.abs(world[:, :2]) < 0.19).all(1)
    open_sky = wall & (np.abs(world[:, :2]) > 0.21).any(1)
    assert shaded.sum() > 5
    assert (got["color"][shaded] == 0).all()
    np.testing.assert_allclose(
        got["color"][open_sky], np.tile([0.5, 0.25, 1.0], (open_sky.sum(), 1)) * 3 / np.pi, rtol=1e-5
    )


def test_spot_light_is_full_inside_and_none_outside() -> None:
    light = Light("spot", (4.0, 4.0, 4.0), (0, 0, 2), (0, 0, -1), inner_rad=np.arctan(0.25), outer_rad=np.arctan(0.5))
    got = sampled(scene((WALL,), lights=(light,)), (65, 65))
    space = Engine(scene((WALL,), lights=(light,))).space
    radius = np.linalg.norm(space.world_points(got["point"])[:, :2], axis=1)
    plain = 4 / np.pi * 2 / (radius**2 + 4) ** 1.5
    np.testing.assert_allclose(got["color"][radius < 0.49, 2], plain[radius < 0.49], rtol=1e-4)
    assert (got["color"][radius > 1.01] == 0).all()
    between = (radius > 0.55) & (radius < 0.95)
    assert ((got["color"][between, 2] > 0) & (got["color"][between, 2] < plain[between])).all()


def rectangle_irradiance(height: float, half: float) -> float:
    """Irradiance per radiance from a square of 2 half at ``height`` above its middle, facing (form factor times pi)."""
    a = half / height
    return 4 * a / np.sqrt(1 + a * a) * np.arctan(a / np.sqrt(1 + a * a)) / 1.0


@pytest.mark.parametrize("rng", [False, True])
def test_area_light_gives_the_irradiance_of_its_rectangle(rng: bool) -> None:
    light = Light(
        "area", (2.0, 2.0, 2.0), direction=(0, 0, -1), corner=(-1, -1, 1.5), edge_u=(2, 0, 0), edge_v=(0, 2, 0)
    )
    camera = StillCamera(look_at((0, 0, 5), (0, 0, 0)).matrix, np.radians(0.2))
    got = sampled(scene((WALL,), lights=(light,), camera=camera), (8, 8), light_samples=256, rng=rng)
    expected = 0.5 / np.pi * 2 * rectangle_irradiance(1.5, 1.0)
    np.testing.assert_allclose(got["color"][:, 0].mean(), expected, rtol=3e-3)
    np.testing.assert_allclose(got["color"], got["surface"] + got["albedo"] * got["light"], rtol=1e-6)
    assert got["surface"].max() == 0  # everything that is sampled is in `light`
    assert (got["shadow"] == 256).all()


def test_area_light_shines_on_one_side_only() -> None:
    light = Light(
        "area", (2.0, 2.0, 2.0), direction=(0, 0, 1), corner=(-1, -1, 1.5), edge_u=(2, 0, 0), edge_v=(0, 2, 0)
    )
    assert (sampled(scene((WALL,), lights=(light,)), light_samples=4)["color"] == 0).all()


def test_penumbra_grows_linearly_as_the_blocker_covers_the_light() -> None:
    """A half-plane edge over a square light: the visible share of the light falls linearly across the penumbra."""
    light = Light(
        "area", (1.0, 1.0, 1.0), direction=(0, 0, -1), corner=(-0.1, -0.1, 40), edge_u=(0.2, 0, 0), edge_v=(0, 0.2, 0)
    )
    shade = quad((-9, -3, 20), (9, 0, 0), (0, 6, 0), diffuse())
    camera = look_at((1.0, 0, 5), (0, 0, 0), 4)
    got = sampled(scene((WALL, shade), lights=(light,), camera=camera), (65, 3), light_samples=256)
    x = Engine(scene((WALL, shade), lights=(light,))).space.world_points(got["point"])[:, 0]
    visible = np.clip((x + 0.1) / 0.2, 0, 1)
    share = got["light"][:, 0] / got["light"][:, 0].max()
    assert np.abs(share - visible).max() < 0.04  # 16 rows of cells, and the cosines differ a little


@pytest.mark.parametrize("radius", [0.05, 0.5])
def test_sphere_light_as_a_point_and_sampled_agree_far_away_and_with_the_solid_angle(radius: float) -> None:
    light = Light("sphere", (3.0, 3.0, 3.0), (0.0, 0.0, 2.0), radius=radius)
    ball = box((0, 0, 2.0), np.full(3, radius * 0.5), Material("lamp", pbr(), unlit=True))  # its own mesh, inside
    camera = StillCamera(look_at((3.0, 0, 4), (0, 0, 0)).matrix, np.radians(0.2))
    subject = scene((WALL, ball), lights=(light,), camera=camera)
    exact = 0.5 / np.pi * 3 * np.pi * (radius / 2) ** 2  # E = L pi sin^2 for a sphere straight above
    camera_light = sampled(subject, (4, 4), sphere_lights="sampled", light_samples=256)["color"][:, 0].mean()
    np.testing.assert_allclose(camera_light, exact, rtol=5e-3)
    np.testing.assert_allclose(sampled(subject, (4, 4))["color"][:, 0].mean(), exact, rtol=1e-3)
