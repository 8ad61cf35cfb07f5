"""Every technique at every extreme of the table, in debug mode: nan and inf are trapped at each stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from renderers import TECHNIQUES, render_clip
from renderers.admission import BYTES_PER_PX, admit, bytes_needed
from renderers.catalogue import CATALOGUE
from renderers.clip_frames import technique_params, view_at
from renderers.engine import LARGEST, Engine
from renderers.technique import Frame
from renderers.tracer import Tracer
from renderers.trap import trapping
from stimuli.errors import InputError
from stimuli.scene import Mover
from tests.renderers.extreme_scenes import CONSTANT, TABLE, Extreme, ordinary
from tests.renderers.scenes_by_hand import Drift, box, diffuse

FRAMES = 3
CLOSED_LOOP = {"adaptive_frameless"}
"""Where each sample goes hangs on the last ones' rounding: pictures are compared in the mean."""
SMALL = {"reference": {"spp": 2}, "polar": {"width": 24, "height": 16}}
BY_NAME = {row.name: row for row in TABLE}
Build = Callable[[str], Engine]


@pytest.fixture(scope="module")
def engine_of() -> Build:
    """One engine a scene, for all techniques."""
    shared: dict[object, Engine] = {}

    def build(name: str) -> Engine:
        key = BY_NAME[name].make
        if key not in shared:
            shared[key] = Engine(key(), debug=True)
        return shared[key]

    return build


def shown(engine: Engine, technique: str, row: Extreme) -> list[Frame]:
    """The first frames, copied; nothing may be trapped on the way unless the row says that numbers overflow."""
    params = technique_params(technique, SMALL.get(technique, {}))
    frames = []
    with trapping() as trap:
        made = TECHNIQUES[technique](engine, row.size_px, params, 0, "stages")
        for k in range(FRAMES):
            view = view_at(k, row.rate_hz, row.start_s, row.size_px, engine.scene.camera, cut=k == 0)
            frame = made.render(view)
            assert frame.time_s == float(k / row.rate_hz)
            frame.color = np.array(frame.color)
            frames.append(frame)
    trapped = engine.trapped()
    if not row.overflows:
        assert trapped == {}
        assert trap.found == {}
    return frames


@pytest.fixture(scope="module")
def ordinary_picture(engine_of: Build) -> Callable[[str], np.ndarray]:
    """What each technique shows of the ordinary scene."""

    @lru_cache
    def picture(technique: str) -> np.ndarray:
        return shown(engine_of("ordinary"), technique, BY_NAME["ordinary"])[-1].color

    return picture


@pytest.mark.parametrize("technique", sorted(CATALOGUE))
@pytest.mark.parametrize("name", [row.name for row in TABLE])
def test_extreme(name: str, technique: str, engine_of: Build, ordinary_picture: Callable[[str], np.ndarray]) -> None:
    row = BY_NAME[name]
    frames = shown(engine_of(name), technique, row)
    for frame in frames:
        assert frame.color.shape == (row.size_px[1], row.size_px[0], 3)
        assert np.isfinite(frame.color).all()
        assert frame.color.min() >= 0
        assert frame.color.max() <= LARGEST
    last = frames[-1].color
    if row.wanted == "same":
        wanted = ordinary_picture(technique)
        if technique in CLOSED_LOOP:
            assert np.abs(last - wanted).mean() < 0.05 * wanted.mean()
            return
        apart = np.abs(last - wanted).max(2) > 2e-3 * wanted.max()
        assert apart.mean() < 0.03, f"{apart.sum()} of {apart.size} pixels differ"
    elif row.wanted == "black":
        assert last.max() == 0
    elif row.wanted == "constant":
        np.testing.assert_allclose(last, np.broadcast_to(np.float32(CONSTANT), last.shape), rtol=1e-5)
    elif row.wanted == "clamped":
        assert sum(frame.clamped for frame in frames) > 0
        assert last.max() == pytest.approx(LARGEST, rel=1e-3)
    elif row.wanted == "sane":
        assert last.max() > 0


def test_the_ordinary_scene_shows_something() -> None:
    engine = Engine(ordinary())
    picture = shown_plainly(engine, "vanilla", BY_NAME["ordinary"])
    assert picture.max() > 0.1
    assert len(np.unique(picture.round(3).reshape(-1, 3), axis=0)) > 50


def shown_plainly(engine: Engine, technique: str, row: Extreme) -> np.ndarray:
    """The last frame without debug mode."""
    made = TECHNIQUES[technique](engine, row.size_px, technique_params(technique, SMALL.get(technique, {})), 0, "total")
    views = [view_at(k, row.rate_hz, row.start_s, row.size_px, engine.scene.camera, cut=k == 0) for k in range(FRAMES)]
    return [np.array(made.render(view).color) for view in views][-1]


@pytest.mark.parametrize("technique", sorted(CATALOGUE))
def test_debug_mode_changes_no_pixel(technique: str, ordinary_picture: Callable[[str], np.ndarray]) -> None:
    plain = shown_plainly(Engine(ordinary()), technique, BY_NAME["ordinary"])
    np.testing.assert_array_equal(plain, ordinary_picture(technique))


def test_8k_is_refused_beforehand_where_it_does_not_fit() -> None:
    size_px = (7680, 4320)
    needed = bytes_needed("taa", size_px)
    assert needed > 7680 * 4320 * 12  # more than the picture itself
    admit("taa", size_px, available=needed)
    with pytest.raises(
        InputError, match=rf"7680x4320, for which taa needs {needed} bytes .* wanted what fits in the 1000"
    ):
        admit("taa", size_px, available=1000)


@pytest.mark.parametrize("technique", sorted(CATALOGUE))
def test_a_clip_that_cannot_fit_is_refused_before_anything_is_built(technique: str) -> None:
    with pytest.raises(InputError, match="size_px"):
        render_clip(ordinary(), technique, size_px=(1_000_000, 1_000_000))
    with pytest.raises(InputError, match="bytes"):
        render_clip(ordinary(), technique, size_px=(60_000, 60_000))


def test_every_technique_says_what_memory_it_takes() -> None:
    assert set(CATALOGUE) == set(BYTES_PER_PX)


def test_thousands_of_movers_are_all_there() -> None:
    """1000 drifting boxes and one by hand in front of them: the ray through it hits it."""
    subject = ordinary(movers=1000)
    front = Mover("front", (box((0, 0, 0), (0.2, 0.2, 0.2), diffuse()),), Drift((0.0, 0.0, 3.0), (0.0, 0.0, 0.0)))
    subject = replace(subject, movers=(*subject.movers, front))
    hits = Tracer(subject).trace(np.array([[0.0, 0.0, 5.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert hits.mover[0] == 1000
    assert hits.t[0] == pytest.approx(1.8, abs=1e-5)
