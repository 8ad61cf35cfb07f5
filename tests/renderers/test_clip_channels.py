"""Channels that clips may hold beside colour: right values, the same from every worker, asked for by name."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import OpenEXR
import pytest

import renderers.units
from protocols.load import load_study
from protocols.requests import clip_specs
from renderers.catalogue import CATALOGUE
from renderers.clip_channels import SceneChannels, samples_of
from renderers.clip_frames import technique_params, view_at
from renderers.clip_renderer import ClipRenderer, technique_class
from renderers.engine import Engine
from renderers.produce import produce
from renderers.units import Unit
from stimuli import load_scene
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob
from stimuli.errors import InputError
from stimuli.scene import Mover
from studyapp.cli import main
from tests.protocols.tiny import TEXT
from tests.renderers.scenes_by_hand import Drift, box, diffuse, look_at, quad, scene
from tests.renderers.test_clip_renderer import job

ALL = ["Z", "motion.X", "motion.Y", "samples"]
RATE = Fraction(240)


@pytest.fixture(scope="module")
def tunnel():
    return load_scene("tunnel_geom")


def test_depth_is_along_the_axis_and_motion_is_what_moved() -> None:
    wall = quad((-8, -8, -1), (16, 0, 0), (0, 16, 0), diffuse())
    front = Mover("front", (box((0, 0, 0), (0.5, 0.5, 0.25), diffuse()),), Drift((0, 0, 0.75), (2.4, 0, 0)))
    subject = scene((wall,), (front,), camera=look_at((0, 0, 5), (0, 0, 0), 90))
    size = (33, 33)
    view = view_at(0, RATE, Fraction(0), size, subject.camera)
    found = SceneChannels(Engine(subject), size).of(view)
    # The front face of the box is 4 in front of the eye, the wall 6, everywhere on it.
    assert found["Z"][16, 16] == pytest.approx(4, rel=1e-5)
    np.testing.assert_allclose(found["Z"][0], 6, rtol=1e-5)
    # 2.4 / 240 units a refresh at depth 4: 33 px are 8 units there.
    assert found["motion.X"][16, 16] == pytest.approx(0.01 * 33 / 8, rel=1e-3)
    assert abs(found["motion.Y"][16, 16]) < 1e-6
    assert (found["motion.X"][0] == 0).all()
    nothing = replace(subject, static=(), movers=())
    assert np.isinf(SceneChannels(Engine(nothing), (3, 2)).of(replace(view, size_px=(3, 2)))["Z"]).all()


@pytest.mark.parametrize("technique", sorted(CATALOGUE))
def test_samples_are_the_primary_rays_or_refused(technique: str, tunnel) -> None:
    size = (22, 17)
    params = technique_params(technique, {"spp": 3} if technique == "reference" else {})
    engine = Engine(tunnel)
    made = technique_class(technique)(engine, size, params, 0, "total")
    for k in range(6):
        view = view_at(k, RATE, Fraction(1), size, tunnel.camera, cut=k == 0)
        frame = made.render(view)
        if not CATALOGUE[technique].counts_samples:
            with pytest.raises(InputError, match="depth, motion; samples only of"):
                samples_of(made, frame, view, size)
            return
        counted = samples_of(made, frame, view, size)
        assert (counted.shape, counted.dtype) == ((17, 22), np.uint32)
        if technique == "temporally_dense":
            # A tile at an odd picture's edge may trace the same pixel for two of its four places.
            assert abs(int(counted.sum()) - frame.rays["primary"]) == 0
        elif technique != "foveated":  # which shades support pixels for each texel, some of them twice
            assert counted.sum() == frame.rays["primary"]
        assert counted.sum() > 0 or technique == "framed_low_rate"


def test_colours_are_the_same_with_and_without_channels(tunnel) -> None:
    for technique in ("temporally_dense", "checkerboard"):
        plain = ClipRenderer(None).frames(job(tunnel, technique), Unit(0, 4))
        rich = ClipRenderer(None).frames(job(tunnel, technique, extra={"channels": ALL}), Unit(0, 4))
        for one, other in zip(plain, rich, strict=True):
            np.testing.assert_array_equal(one.blocks[0], other.blocks[0])
            assert list(other.channels) == ALL
            assert one.cost.rays == other.cost.rays


def test_probes_are_not_asked_twice(tunnel) -> None:
    asked = job(tunnel, frames=3, lighting="probes")
    rich = ClipJob(replace(asked.request, extra={"channels": ["Z"]}), asked.scene_file)
    plain = list(ClipRenderer(None).frames(asked, Unit(0, 3)))
    for one, other in zip(plain, ClipRenderer(None).frames(rich, Unit(0, 3)), strict=True):
        np.testing.assert_array_equal(one.blocks[0], other.blocks[0])


def test_stored_channels_are_named_and_typed(tunnel, tmp_path, monkeypatch) -> None:
    """A reference made from sample blocks (two workers: see `test_clip_renderer`)."""
    monkeypatch.setattr(renderers.units, "UNIT_SAMPLES", 24 * 16)
    asked = job(tunnel, "reference", params={"spp": 130}, frames=2, extra={"channels": ALL})
    store = ClipStore(tmp_path)
    produce([asked], store, bar=False)
    clip = store.open_verified(asked.request.identity)
    assert clip.manifest["channels"] == ["B", "G", "R", *sorted(ALL)]
    with OpenEXR.File(str(clip.frame_path(1)), separate_channels=True) as file:
        types = {name: channel.pixels.dtype for name, channel in file.channels().items()}
    assert types == {
        "R": np.float16, "G": np.float16, "B": np.float16, "Z": np.float32, "motion.X": np.float16,
        "motion.Y": np.float16, "samples": np.uint32,
    }  # fmt: skip
    picture = clip.frame(1)
    assert (picture.channels["samples"] == 130).all()
    assert 0 < picture.channels["Z"].min() < np.median(picture.channels["Z"]) < 100
    assert np.abs(picture.channels["motion.X"]).max() > 0


STUDY = """
study: rich
display: {refresh_hz: 240, size_px: [640, 480]}
defaults: {size_px: [16, 12], duration_s: 1/120, warm_up_s: 0}
scenes: {tunnel: {scene: tunnel_geom, start_s: 1, exposure: 1.0}}
conditions: {gold: {technique: reference, params: {spp: 2}}, dense: temporally_dense, half: checkerboard}
questions: {closer: {kind: choice, text: Which one?}}
blocks:
  - {name: b, kind: side_by_side, reference: gold, compare: {of: [dense, half]}, questions: [closer]}
"""


def test_a_protocol_and_the_command_line_ask_for_channels(tmp_path, capsys) -> None:
    protocol = tmp_path / "rich.yaml"
    protocol.write_text(STUDY.replace("warm_up_s: 0", "warm_up_s: 0, channels: [depth, samples]"))
    assert main(["render", str(protocol)]) == 0
    store = ClipStore(tmp_path / ".clips")
    assert {tuple(clip.manifest["channels"]) for clip in store.published()} == {("B", "G", "R", "Z", "samples")}
    assert main(["store", "ls", "--store", str(store.root)]) == 0
    assert capsys.readouterr().out.count("rendered with Z samples") == 3
    # A condition of its own may have others; the flag asks for those of clips beside the protocol's own.
    protocol.write_text(STUDY.replace("half: checkerboard", "half: {technique: checkerboard, channels: [motion]}"))
    by_name = {spec.technique: spec.channels for spec in clip_specs(load_study(protocol))}
    assert by_name == {"reference": (), "temporally_dense": (), "checkerboard": ("motion.X", "motion.Y")}
    protocol.write_text(STUDY)
    assert main(["render", str(protocol), "--channels", "depth,motion"]) == 0
    rich = [clip for clip in store.published() if "motion.X" in clip.manifest["channels"]]
    assert len(rich) == 3
    assert main(["render", str(protocol)]) == 0
    assert "made 3" in capsys.readouterr().out
    for text in ("depth,speed", ","):
        assert main(["render", str(protocol), "--channels", text]) == 2
        assert "depth | motion | samples" in capsys.readouterr().err


def test_samples_of_a_technique_without_any_are_refused_at_the_desk(tmp_path) -> None:
    file = tmp_path / "s.yaml"
    text = TEXT.replace("dense: temporally_dense", "dense: framed_low_resolution")
    file.write_text(text + "defaults: {channels: [samples]}\n")
    with pytest.raises(InputError, match=r"s.yaml:7:3: conditions.dense: got channels: samples"):
        load_study(file)
    own = "dense: {technique: framed_low_resolution, channels: [depth]}"
    file.write_text(text.replace("dense: framed_low_resolution", own) + "defaults: {channels: [samples]}\n")
    assert load_study(file).conditions["dense"].channels == ["depth"]
