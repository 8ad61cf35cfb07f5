"""Stored clips with the real engine: warm-up, loops, sample ranges, camera keys, and the same bytes from any worker."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import renderers.units
from renderers import render_clip
from renderers.clip_renderer import ClipRenderer, gaze_of, keyed_camera, path_seed, view_of, warm_up_frames
from renderers.loops import closed_loop
from renderers.produce import produce, units_of
from renderers.units import Unit
from stimuli import load_scene
from stimuli.camera_path import camera_path
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob
from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError
from stimuli.scene import Mover, StillCamera, StillTrack
from tests.renderers.test_produce import all_files


@pytest.fixture(scope="module")
def scene():
    return load_scene("tunnel_geom")


def job(scene, technique="vanilla", frames=4, **changes) -> ClipJob:
    params = {"spp": 8} if technique == "reference" else {}
    asked = ClipRequest(
        scene="tunnel", scene_sha256=scene.sha256, technique=technique, params=params, size_px=(24, 16), rate_hz="240",
        duration_s=str(Fraction(frames, 240)), start_s="1", warm_up_s="0", exposure=0.5,
    )  # fmt: skip
    return ClipJob(replace(asked, **changes), "tunnel_geom")


@pytest.mark.parametrize("technique", ["vanilla", "reference"])
def test_stored_frames_are_those_of_render_clip(scene, tmp_path, technique):
    asked = job(scene, technique)
    store = ClipStore(tmp_path)
    produce([asked], store, bar=False)
    clip = store.open_verified(asked.request.identity)
    frames = render_clip(
        scene, technique, (24, 16), 240, "1/60", params=dict(asked.request.params), start_s=1.0, exposure=0.5
    )
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(clip.frame(k).color, frame.color.astype(np.float16))
        assert clip.cost()["frames"][k]["rays"] == dict(frame.rays)


def test_divided_clips_from_two_workers_are_byte_identical(scene, tmp_path, monkeypatch):
    extra = {"channels": ["Z", "motion.X", "motion.Y", "samples"]}
    work = [job(scene, "vanilla", extra=extra), job(scene, "reference", params={"spp": 130}, frames=2, extra=extra)]
    one, two = ClipStore(tmp_path / "one"), ClipStore(tmp_path / "two")
    produce(work, one, bar=False)
    monkeypatch.setattr(renderers.units, "UNIT_SAMPLES", 24 * 16)
    assert [len(units_of(asked.request)) for asked in work] == [4, 6]
    outcome = produce(work, two, 2, bar=False)
    assert not outcome.poisoned
    assert all_files(one) == all_files(two)


def test_frames_do_not_depend_on_what_a_worker_did_before(scene):
    asked = job(scene, "vanilla", 6)
    renderer = ClipRenderer(None)
    whole = [frame.blocks[0] for frame in renderer.frames(asked, Unit(0, 6))]
    list(renderer.frames(job(scene, "reference", 2), Unit(0, 2)))
    part = [frame.blocks[0] for frame in renderer.frames(asked, Unit(3, 6))]
    for a, b in zip(whole[3:], part, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("before", [(0.0, 0.0), "moving"])
def test_the_fixation_target_is_in_the_clips_that_ask_for_it_alone(scene, before):
    """One worker, a clip after another of the same scene and path: fixed after moving, moving after fixed."""
    size = {"size_px": (320, 240)}
    renderer = ClipRenderer(None)
    fixed, moving = (job(scene, "foveated", 2, gaze=gaze, **size) for gaze in ((0.0, 0.0), "moving"))
    later = job(scene, "foveated", 2, gaze="moving", start_s="2", **size)  # the scene is nearest at another place
    small = job(scene, "foveated", 2, gaze="moving", params={"configuration": "small"}, **size)
    assert len({path_seed(asked.request) for asked in (moving, later, small)}) == 2
    list(renderer.frames(job(scene, "foveated", 2, gaze=before, **size), Unit(0, 2)))
    for asked in (fixed, moving, fixed, later, small, moving):
        frame = next(iter(renderer.frames(asked, Unit(0, 2)))).blocks[0]
        alone = next(iter(ClipRenderer(None).frames(asked, Unit(0, 2)))).blocks[0]
        np.testing.assert_array_equal(frame, alone)
        green = (frame[..., 1] > 0.7) & (frame[..., 0] < 0.1)
        assert green.any() == (asked is not fixed)


def test_measured_error_of_the_reference_is_that_of_independent_references(scene, tmp_path):
    asked = job(scene, "reference", 1, params={"spp": 16})
    store = ClipStore(tmp_path)
    produce([asked], store, bar=False)
    stated = store.open(asked.request.identity).manifest["frame_facts"]["0"]["standard_error"]
    from stimuli.encode import display_values

    frames = [
        next(iter(render_clip(scene, "reference", (24, 16), 240, "1/240", {"spp": spp}, seed, 1.0, exposure=0.5)))
        for spp, seed in ((16, 0), (1024, 77))
    ]
    values = [display_values(frame.color, 0.5) for frame in frames]
    actual = float(np.sqrt(np.mean((values[0] - values[1]) ** 2)))
    assert stated == pytest.approx(actual, rel=0.3)


def test_warm_up_comes_before_frame_0_and_its_frames_are_not_stored(scene):
    request = job(scene, warm_up_s="1/40").request
    assert warm_up_frames(request) == 6
    view = view_of(request, scene, scene.camera, -6, 6, True)
    assert view.index == 0
    assert view.t1 == 1 - Fraction(6, 240)
    assert view_of(request, scene, scene.camera, 0, 6, False).t1 == 1
    assert view_of(request, scene, scene.camera, 0, 6, False).index == 6


def test_closed_loop_repeats_and_its_first_frame_follows_the_last(scene):
    request = job(scene, frames=960, loop="closed", path="sway", start_s="1", warm_up_s="1").request
    looped, camera = closed_loop(scene, camera_path(scene, "sway"), request)
    assert warm_up_frames(request) == 960
    times = np.array([1.0, 5.0, -3.0, 1.7, 5.7])
    poses = camera.pose(times)
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-9)
    np.testing.assert_allclose(poses[0], poses[2], atol=1e-9)
    np.testing.assert_allclose(poses[3], poses[4], atol=1e-9)
    assert len(looped.movers) == len(scene.movers)


def test_loop_that_does_not_close_is_refused(scene):
    request = job(scene, frames=100, loop="closed", path="sway").request
    with pytest.raises(InputError, match="closed loop: got camera is elsewhere"):
        closed_loop(scene, camera_path(scene, "sway"), request)


def test_other_scene_than_requested_is_refused(scene):
    with pytest.raises(InputError, match="as requested"):
        list(ClipRenderer(None).frames(job(scene, scene_sha256="00" * 32), Unit(0, 1)))


def test_protocol_keys_move_the_camera(scene):
    keys = [
        {"time_s": "0", "position": [0, 0, 0], "look_at": [0, 0, -1], "yfov_deg": 40},
        {"time_s": "1", "position": [2, 0, 0], "look_at": [2, 0, -1], "yfov_deg": None},
    ]
    camera = keyed_camera(scene, json.dumps(keys))
    assert np.degrees(camera.yfov_rad) == pytest.approx(40)
    np.testing.assert_allclose(camera.pose(np.array([1.0]))[0][:3, 3], [2, 0, 0], atol=1e-9)


def test_moving_gaze_is_the_direction_of_the_scenes_target(scene):
    matrix = np.eye(4)
    matrix[:3, 3] = [1.0, 1.0, -1.0]
    camera = StillCamera(np.eye(4), np.pi / 2)
    with_target = replace(scene, movers=(Mover("fixation target", (), StillTrack(matrix)),))
    request = job(scene, gaze="moving").request
    assert gaze_of(request, with_target, camera, Fraction(0)) == pytest.approx(
        (45.0, np.degrees(np.arctan2(1, np.sqrt(2))))
    )
    # on a screen: half height 0.2 m at 1 m, the target stands at its upper right corner
    flat = replace(request, geometry=(0.4, 0.4, 1.0, 0.0, 0.0))
    assert gaze_of(flat, with_target, camera, Fraction(0)) == pytest.approx(
        (np.degrees(np.arctan(0.2)), np.degrees(np.arctan2(0.2, np.hypot(1, 0.2))))
    )
    with pytest.raises(InputError, match="no mover called target"):
        gaze_of(request, scene, camera, Fraction(0))
    assert gaze_of(replace(request, gaze=None), scene, camera, Fraction(0)) is None


def test_channels_that_a_technique_lacks_are_refused(scene):
    for technique, name in (("polar", "samples"), ("vanilla", "albedo.R"), ("reference", "class")):
        with pytest.raises(InputError, match=f"{technique}: channels: got {name}"):
            list(ClipRenderer(None).frames(job(scene, technique, extra={"channels": [name]}), Unit(0, 1)))


def test_technique_from_outside_the_tree_is_rendered_as_one_unit(scene, tmp_path):
    outside = job(scene, "renderers.vanilla:Vanilla", warm_up_s="0")
    assert units_of(outside.request) == (Unit(0, 4),)
    renderer = ClipRenderer(None)
    theirs = [frame.blocks[0] for frame in renderer.frames(outside, Unit(0, 4))]
    ours = [frame.blocks[0] for frame in renderer.frames(job(scene), Unit(0, 4))]
    np.testing.assert_array_equal(theirs, ours)
    for name, text in (("no.such:Class", "can be imported"), ("renderers.vanilla:Nothing", "can be imported")):
        with pytest.raises(InputError, match=text):
            list(ClipRenderer(None).frames(job(scene, name), Unit(0, 1)))
    with pytest.raises(InputError, match="own Params"):
        list(ClipRenderer(None).frames(job(scene, "renderers.vanilla:Vanilla", params={"spp": 3}), Unit(0, 1)))
