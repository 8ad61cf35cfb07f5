"""The plain call: when it renders, what it yields, what it refuses."""

from __future__ import annotations

import sys
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from renderers import TECHNIQUES, render_clip
from renderers.clip_frames import scene_exposure, view_at
from renderers.engine import Engine
from stimuli.errors import InputError
from stimuli.scene import Light, Mover
from tests.renderers.scenes_by_hand import Drift, box, crowd, diffuse, quad, scene

SUBJECT = scene(
    (quad((-3, -3, -1), (6, 0, 0), (0, 6, 0), diffuse((0.7, 0.6, 0.5))),), crowd(3),
    (Light("area", (3.0, 3.0, 3.0), direction=(0, 0, -1), corner=(-1, -1, 3), edge_u=(2, 0, 0), edge_v=(0, 2, 0)),),
)  # fmt: skip


def clip(technique: str = "vanilla", **options: Any) -> list[Any]:
    values: dict[str, Any] = {"size_px": (33, 17), "rate_hz": 240, "duration_s": 3 / 240, **options}
    return list(render_clip(SUBJECT, technique, **values))


@pytest.mark.parametrize("technique", ["vanilla", "reference"])
def test_frames_have_exact_times_shapes_and_counts(technique: str) -> None:
    params = {"spp": 3} if technique == "reference" else {}
    frames = clip(technique, rate_hz="60000/1001", duration_s=Fraction(3 * 1001, 60000), params=params)
    assert [f.time_s for f in frames] == [float(k * Fraction(1001, 60000)) for k in range(3)]
    for frame in frames:
        assert frame.color.shape == (17, 33, 3)
        assert frame.color.dtype == np.float32
        assert frame.rays["primary"] == 33 * 17 * (3 if technique == "reference" else 1)
        assert 0 < frame.rays["shadow"] <= frame.rays["primary"]
        assert frame.seconds["total"] > 0
        assert frame.clamped == 0


def test_frames_are_copies_and_the_same_seed_gives_the_same_bytes() -> None:
    first, again, other = clip(), clip(), clip(seed=1)
    for a, b, c in zip(first, again, other, strict=True):
        assert a.color.tobytes() == b.color.tobytes()
        assert a.color.tobytes() != c.color.tobytes()
    assert first[0].color.tobytes() != first[1].color.tobytes()


def test_reset_starts_anew() -> None:
    engine = Engine(SUBJECT)
    made = TECHNIQUES["vanilla"](engine, (9, 9), TECHNIQUES["vanilla"].Params(), 5, "total")
    views = [view_at(k, Fraction(240), Fraction(0), (9, 9), SUBJECT.camera) for k in range(2)]
    before = [made.render(view).color.copy() for view in views]
    made.reset(5)
    for view, color in zip(views, before, strict=True):
        np.testing.assert_array_equal(made.render(view).color, color)


def test_stages_change_no_pixel() -> None:
    for a, b in zip(clip(), clip(measure="stages"), strict=True):
        assert a.color.tobytes() == b.color.tobytes()
        assert {"state", "trace", "total"} <= set(b.seconds)


def test_a_delayed_picture_is_that_of_a_refresh_ago() -> None:
    mover = Mover("box", (box((0, 0, 0), (0.5, 0.5, 0.5), diffuse()),), Drift((0, 0, 0), (30.0, 0, 0)))
    subject = scene(movers=(mover,), lights=(Light("directional", (3.0,) * 3),))
    options = {"size_px": (32, 32), "rate_hz": 240, "duration_s": 4 / 240}
    now = list(render_clip(subject, "vanilla", **options))
    late = list(render_clip(subject, "vanilla", params={"delay_frames": 1}, **options))
    for k in range(1, 4):
        np.testing.assert_array_equal(late[k].color, now[k - 1].color)
        assert (late[k].color != now[k].color).any()


def test_the_reference_converges_to_the_area_of_a_pixel() -> None:
    """A bright half-plane whose edge cuts pixels: their mean is the covered share."""
    glow = diffuse((1.0, 1.0, 1.0), ambient=(1.0, 1.0, 1.0))
    subject = scene((quad((-9, -9, 0), (9.1, 0, 0), (0, 18, 0), glow),), ambient=(1.0, 1.0, 1.0))
    frame = next(render_clip(subject, "reference", (16, 16), 240, 1 / 240, params={"spp": 256}))
    edge_px = 8 + 0.1 * 16 / (2 * np.tan(np.radians(20)) * 5)
    expected = np.clip(edge_px - np.arange(16), 0, 1)
    np.testing.assert_allclose(frame.color[..., 0], np.tile(expected, (16, 1)), atol=0.01)


def test_light_samples_are_counted() -> None:
    frame = clip(params={"light_samples": 16})[0]
    assert 8 * frame.rays["primary"] < frame.rays["shadow"] <= 16 * frame.rays["primary"]


def test_nothing_is_rendered_before_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    built = []
    module = sys.modules["renderers.clip_frames"]  # the package's attribute of this name is the function
    monkeypatch.setattr(module, "Engine", lambda *a, **k: built.append(1) or Engine(*a, **k))
    frames = render_clip(SUBJECT, "vanilla", (8, 8), 240, 1.0)
    assert not built
    next(frames)
    assert built == [1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"technique": "magic"}, r"technique: unknown technique: got 'magic', wanted .*reference.*vanilla"),
        ({"size_px": (0, 5)}, "size_px: got 0x5, wanted at least 1x1"),
        ({"rate_hz": 0}, "rate_hz"),
        ({"rate_hz": float("nan")}, "rate_hz"),
        ({"duration_s": -1}, "duration_s"),
        ({"params": {"spp": 3}}, "spp"),
        ({"params": {"delay_frames": -1}}, "delay_frames"),
        ({"exposure": 0.0}, "exposure"),
        ({"measure": "all"}, "measure"),
        ({"lighting": "moon"}, "lighting"),
    ],
)
def test_wrong_input_is_said_in_one_line(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        clip(**options)
    assert all("\n" not in line for line in caught.value.problems)


def test_no_frames_and_one_pixel() -> None:
    assert clip(duration_s=0) == []
    assert clip(size_px=(1, 1))[0].color.shape == (1, 1, 3)


def test_exposure_is_the_scenes_own_or_made_from_a_reference() -> None:
    engine = Engine(SUBJECT)
    found = scene_exposure(engine, SUBJECT.camera, Fraction(0))
    assert found > 0
    assert np.log2(found) * 8 == pytest.approx(round(np.log2(found) * 8))
