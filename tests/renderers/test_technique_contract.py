"""What every technique of the catalogue keeps to; external techniques are held to the same suite."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from renderers import TECHNIQUES, render_clip
from renderers.catalogue import CATALOGUE
from stimuli import SCENES, load_scene
from stimuli.errors import InputError

SIZE = (22, 17)  # odd, and no multiple of a tile
NAMES = sorted(CATALOGUE)


@pytest.fixture(scope="module")
def scene():
    return load_scene("toy_car")


def clip(scene, name, **options):
    settings = {"size_px": SIZE, "rate_hz": 240, "duration_s": 6 / 240, "params": {}, "seed": 3, **options}
    return list(render_clip(scene, name, **settings))


def test_the_names_are_those_that_are_documented() -> None:
    documented = {
        "reference", "vanilla", "taa", "temporally_dense", "foveated", "polar", "adaptive_frameless",
        "traditional_frameless", "checkerboard", "framed_low_resolution", "framed_low_rate",
    }  # fmt: skip
    assert set(CATALOGUE) <= documented
    assert {"reference", "vanilla"} <= set(CATALOGUE)


@pytest.mark.parametrize("name", NAMES)
def test_the_class_is_what_the_entry_says(name: str) -> None:
    technique = TECHNIQUES[name]
    assert technique.name == name
    assert technique.Params is CATALOGUE[name].params
    defaults = technique.Params().model_dump()
    assert set(CATALOGUE[name].knobs) <= set(defaults)
    for knob, values in CATALOGUE[name].knobs.items():
        for value in values:
            technique.Params(**{knob: value})


@pytest.mark.parametrize("name", NAMES)
def test_frames_are_finite_linear_pictures_with_exact_times(scene, name: str) -> None:
    frames = clip(scene, name)
    assert len(frames) == 6
    for k, frame in enumerate(frames):
        assert frame.color.shape == (SIZE[1], SIZE[0], 3)
        assert frame.color.dtype == np.float32
        assert np.isfinite(frame.color).all()
        assert frame.color.min() >= 0
        assert frame.color.max() <= 65504
        assert frame.time_s == float(Fraction(k, 240))
        assert all(isinstance(n, int) and n >= 0 for n in dict(frame.rays).values())
        assert frame.rays["primary"] >= 0
        assert frame.seconds["total"] >= 0
    assert sum(frame.seconds["total"] for frame in frames) > 0
    assert max(frame.color.max() for frame in frames) > 0


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_bytes(scene, name: str) -> None:
    first, second = clip(scene, name), clip(scene, name)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.color, b.color)
        assert dict(a.rays) == dict(b.rays)


@pytest.mark.parametrize("name", NAMES)
def test_measuring_stages_changes_no_pixel(scene, name: str) -> None:
    total, stages = clip(scene, name), clip(scene, name, measure="stages")
    for a, b in zip(total, stages, strict=True):
        np.testing.assert_array_equal(a.color, b.color)
    assert len(stages[-1].seconds) > 1


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size_px", [(1, 1), (1, 7), (9, 1)])
def test_the_smallest_pictures_render(scene, name: str, size_px: tuple[int, int]) -> None:
    for frame in clip(scene, name, size_px=size_px, duration_s=3 / 240):
        assert frame.color.shape == (size_px[1], size_px[0], 3)
        assert np.isfinite(frame.color).all()


@pytest.mark.parametrize("name", NAMES)
def test_an_unknown_parameter_is_one_clear_line(scene, name: str) -> None:
    with pytest.raises(InputError) as caught:
        clip(scene, name, params={"no_such_knob": 1})
    assert "no_such_knob" in str(caught.value)
    assert "Traceback" not in str(caught.value)


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_rendered_before_it_is_asked_for(scene, name: str) -> None:
    frames = render_clip(scene, name, size_px=SIZE, rate_hz=240, duration_s=3600.0)
    assert next(frames).time_s == 0.0


def test_a_zero_size_an_unknown_technique_and_a_bad_rate_are_refused(scene) -> None:
    for options in ({"size_px": (0, 8)}, {"rate_hz": 0}, {"duration_s": -1.0}):
        with pytest.raises(InputError):
            clip(scene, "vanilla", **options)
    with pytest.raises(InputError, match="vanilla"):
        clip(scene, "vanila")


def test_every_procedural_scene_renders(scene) -> None:
    for name in SCENES:
        (frame,) = render_clip(load_scene(name), "vanilla", size_px=(32, 24), rate_hz=240, duration_s=1 / 240)
        assert frame.color.max() > 0, name
