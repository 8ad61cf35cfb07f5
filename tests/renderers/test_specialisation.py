"""Kernels hold what a scene requires and nothing else; with everything in them, the picture is the same."""

from __future__ import annotations

from dataclasses import fields, replace
from fractions import Fraction

import numpy as np
import pytest

from renderers.backend import activate, dr
from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.frozen import frozen
from renderers.requirements import FEATURES, Requirements, reasons, requirements_of
from renderers.specialisation import PrimaryPass, measure_specialisation
from renderers.technique import View
from renderers.vanilla import frame_lanes
from stimuli import SCENES, load_scene
from stimuli.scene import Light, Part, Scene
from tests.renderers.scenes import noise_pixels, texture
from tests.renderers.scenes_by_hand import box, diffuse, pbr, quad, scene

LAMP = Light("point", (30.0, 30.0, 30.0), position=(1.0, 2.0, 4.0), name="lamp")


def wall(**values: object) -> Part:
    return quad((-3, -3, -1), (6, 0, 0), (0, 6, 0), diffuse((0.7, 0.6, 0.5), **values), "wall")


def kernel_of(subject: Scene) -> tuple[int, str]:
    """(operations, intermediate code) of the primary pass."""
    activate("auto")
    kernel = PrimaryPass(subject, requirements_of(subject), (8, 8), "auto")
    _, x, y = frame_lanes((8, 8))
    state = kernel.engine.state(view_of(subject))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(frozen(kernel.color)(64, state, x, y))
        largest = max((e for e in dr.kernel_history() if "ir" in e), key=lambda e: e["operation_count"])
    return largest["operation_count"], largest["ir"].read()


def view_of(subject: Scene) -> View:
    return view_at(0, Fraction(240), Fraction(0), (8, 8), subject.camera)


def test_a_mirror_adds_the_reflection_loop() -> None:
    plain = scene((wall(), box((0, 0, 0), (0.5, 0.5, 0.5), diffuse())), lights=(LAMP,))
    mirrored = scene((wall(), box((0, 0, 0), (0.5, 0.5, 0.5), diffuse(specular=(0.9,) * 3))), lights=(LAMP,))
    assert not requirements_of(plain).mirrors
    assert requirements_of(mirrored).mirrors
    assert not Engine(plain).follows_rays
    assert Engine(mirrored).follows_rays
    operations, code = kernel_of(plain)
    more, looped = kernel_of(mirrored)
    assert "mirrors and glass" not in code
    assert "mirrors and glass" in looped
    assert more > operations * 1.5


def test_without_the_last_texture_the_fetch_is_gone() -> None:
    image = texture(noise_pixels(1, 16))
    textured = scene((wall(baseColorTexture=image), box((0, 0, 0), (0.3, 0.3, 0.3), diffuse())), lights=(LAMP,))
    bare = scene((wall(), box((0, 0, 0), (0.3, 0.3, 0.3), diffuse())), lights=(LAMP,))
    assert requirements_of(textured).base_texture
    assert not requirements_of(bare).textures
    with_fetch, without = kernel_of(textured)[0], kernel_of(bare)[0]
    assert without < with_fetch * 0.8


def test_all_features_give_the_same_picture_and_cost_more() -> None:
    found = measure_specialisation(load_scene("tunnel_maps"), (64, 36), runs=1, features=("mirrors", "cutouts"))
    assert found.all_features.largest_difference <= 1e-6
    assert found.all_features.operations > 3 * found.own.operations
    for feature in ("mirrors", "cutouts"):
        assert found.kernels[feature].largest_difference <= 1e-6
        assert found.own.operations < found.kernels[feature].operations < found.all_features.operations


@pytest.mark.parametrize("name", ["toy_car", "mixed_reality_room"])
def test_all_features_give_the_same_picture_of_scenes_with_movers(name: str) -> None:
    found = measure_specialisation(load_scene(name), (32, 18), runs=1, features=())
    assert found.all_features.largest_difference <= 1e-5


def test_every_feature_has_a_reason_and_a_meaning() -> None:
    for name in SCENES:
        subject = load_scene(name)
        needs = requirements_of(subject)
        told = {reason.feature: reason for reason in reasons(subject)}
        assert list(told) == [f.name for f in fields(Requirements)]
        for feature, reason in told.items():
            assert reason.required == bool(getattr(needs, feature)) == bool(reason.because), (name, feature)
            assert reason.meaning
        assert len(told["movers"].because) == needs.movers
        assert len(told["lights"].because) == len(subject.lights)


def test_a_reason_names_what_needs_it() -> None:
    glowing = replace(diffuse(), name="neon", pbr=pbr(emissiveFactor=np.array([1.0, 0.5, 0.2])))
    subject = scene((wall(), quad((0, 0, 0), (1, 0, 0), (0, 1, 0), glowing)), lights=(LAMP,))
    told = {reason.feature: reason for reason in reasons(subject)}
    assert told["emissive"].because == ("material neon",)
    assert told["lights"].because == ("point light lamp",)
    assert told["static"].because == ("mesh wall", "mesh quad")


def test_all_features_leave_bodies_and_lights_as_they_are() -> None:
    own = requirements_of(load_scene("tunnel_maps"))
    full = Requirements.all(own)
    assert all(getattr(full, feature) for feature in FEATURES)
    assert (full.static, full.glass, full.movers, full.lights) == (own.static, own.glass, own.movers, own.lights)
