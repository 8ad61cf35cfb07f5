"""The clip store: what is published is whole, what is damaged is found, what is left over is cleared."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from stimuli.clip import ClipStore, estimate_disk, request_from_dict, write_json
from stimuli.clip_parts import DamagedPart, FrameCost, PartWriter, assemble, has_part, part_directory
from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError

SIZE = (12, 8)


def request(frames: int = 6, seed: int = 0, **changes) -> ClipRequest:
    whole = ClipRequest(
        scene="toy", scene_sha256="ab" * 32, technique="vanilla", params={"spp": 1}, size_px=SIZE, rate_hz="240",
        duration_s=f"{frames}/240", seed=seed,
    )  # fmt: skip
    return replace(whole, **changes)


def color(asked: ClipRequest, index: int) -> np.ndarray:
    """A picture that follows from the request's seed and the frame's index alone."""
    width, height = asked.size_px
    return np.random.default_rng([asked.seed, index]).random((height, width, 3)).astype(np.float32) * 1.5


def write_part(store: ClipStore, asked: ClipRequest, first: int, stop: int) -> str:
    writer = PartWriter(store, asked, first)
    for index in range(first, stop):
        writer.add(
            color(asked, index), {"Z": np.full((8, 12), index, np.float32)}, FrameCost({"total": 0.1}, {"primary": 96})
        )
    name = f"frames-{first}-{stop}"
    writer.publish(name)
    return name


def make(store: ClipStore, asked: ClipRequest, cuts: tuple[int, ...] = ()):
    edges = [0, *cuts, asked.frame_count]
    names = [write_part(store, asked, a, b) for a, b in pairwise(edges)]
    return assemble(store, asked, names)


@pytest.fixture
def store(tmp_path) -> ClipStore:
    return ClipStore(tmp_path / "store")


def files_of(directory) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir() if path.name != "cost.json"}


def test_clip_holds_what_was_written(store):
    asked = request()
    clip = make(store, asked, (2, 3))
    assert clip.identity == asked.identity == store.open(asked.identity).identity
    assert clip.request == asked
    for index in range(6):
        picture = clip.frame(index)
        np.testing.assert_array_equal(picture.color, color(asked, index).astype(np.float16))
        assert picture.channels["Z"][0, 0] == index
        assert picture.attributes["frame"] == index
        assert picture.attributes["technique"] == "vanilla"
    assert clip.manifest["channels"] == ["B", "G", "R", "Z"]
    assert [frame["rays"] for frame in clip.cost()["frames"]] == [{"primary": 96}] * 6
    assert store.problems_of(asked.identity) == []
    with pytest.raises(IndexError):
        clip.frame_path(6)


def test_bytes_do_not_depend_on_how_the_clip_was_divided(store, tmp_path):
    other = ClipStore(tmp_path / "other")
    whole, divided = make(store, request()), make(other, request(), (1, 4))
    assert files_of(whole.directory) == files_of(divided.directory)


def test_luminance_is_that_of_the_stored_pixels(store):
    asked = request(exposure=0.8)
    light = make(store, asked, (5,)).manifest["luminance"]
    stored = np.stack([color(asked, i).astype(np.float16).astype(np.float64) for i in range(6)]) * 0.8
    shown = np.clip(stored, 0, 1) @ [0.2126, 0.7152, 0.0722]
    assert light["mean"] == pytest.approx(shown.mean(), rel=1e-6)
    assert light["clipped_share"] == pytest.approx((stored > 1).any(axis=-1).mean())
    for p, value in light["percentiles"].items():
        assert value == pytest.approx(np.percentile(shown, float(p), method="inverted_cdf"), abs=2e-5)
    means = shown.reshape(6, -1).mean(axis=1)
    assert (light["frame_mean_low"], light["frame_mean_high"]) == pytest.approx((means.min(), means.max()), rel=1e-6)


def test_identity_depends_on_pixels_only_and_survives_json():
    asked = request(geometry=(0.5, 0.3, 0.7), gaze=(1.0, 2.0), extra={"order": "bowtie"})
    assert replace(asked, scene="another label").identity == asked.identity
    assert request_from_dict(json.loads(json.dumps(asked.__dict__))).identity == asked.identity
    changes = {"seed": 1, "exposure": 1.5, "warm_up_s": "2", "loop": "closed", "params": {"spp": 2}, "rate_hz": "120"}
    seen = {replace(asked, **{name: value}).identity for name, value in changes.items()}
    assert len(seen | {asked.identity}) == len(changes) + 1


def damage_byte(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


def swap(a, b):
    keep = a.read_bytes()
    a.write_bytes(b.read_bytes())
    b.write_bytes(keep)


DAMAGE = {
    "a bit turned over": (lambda d: damage_byte(d / "000003.exr"), "000003.exr"),
    "a file cut short": (lambda d: (d / "000002.exr").write_bytes((d / "000002.exr").read_bytes()[:-7]), "000002.exr"),
    "an empty file": (lambda d: (d / "000002.exr").write_bytes(b""), "000002.exr"),
    "a file lost": (lambda d: (d / "000005.exr").unlink(), "000005.exr"),
    "two frames swapped": (lambda d: swap(d / "000000.exr", d / "000001.exr"), "000000.exr"),
    "a foreign file": (lambda d: (d / "notes.txt").write_text("hello"), "notes.txt"),
    "a frame too many": (lambda d: shutil.copy(d / "000000.exr", d / "000006.exr"), "000006.exr"),
    "a directory in a frame's place": (
        lambda d: ((d / "000004.exr").unlink(), (d / "000004.exr").mkdir()), "000004.exr"),
    "manifest not JSON": (lambda d: (d / "manifest.json").write_text("{"), "manifest"),
    "manifest of another type": (lambda d: (d / "manifest.json").write_text("[]"), "manifest"),
    "manifest edited": (lambda d: edit(d, lambda m: m["luminance"].update(mean=0.5)), "changed since publication"),
    "request edited": (lambda d: edit(d, lambda m: m["request"].update(seed=9)), "identity"),
    "manifest lost": (lambda d: (d / "manifest.json").unlink(), "nothing"),
}  # fmt: skip


def edit(directory, change):
    data = json.loads((directory / "manifest.json").read_text())
    change(data)
    write_json(directory / "manifest.json", data)


@pytest.mark.parametrize("kind", DAMAGE)
def test_damage_is_found_refused_and_remade(store, kind):
    asked, (harm, name) = request(), DAMAGE[kind]
    before = files_of(make(store, asked).directory)
    harm(store.directory(asked.identity))
    problems = store.problems_of(asked.identity)
    assert any(name in line for line in problems), problems
    assert all("\n" not in line for line in problems)
    with pytest.raises(InputError):
        store.open_verified(asked.identity)
    make(store, asked)  # publishing anew replaces what is damaged
    assert store.problems_of(asked.identity) == []
    assert files_of(store.directory(asked.identity)) == before


def test_clips_whose_places_were_swapped_are_found(store):
    a, b = make(store, request(seed=1)), make(store, request(seed=2))
    os.rename(a.directory, store.root / "x")
    os.rename(b.directory, a.directory)
    os.rename(store.root / "x", b.directory)
    assert all("identity" in store.problems_of(clip.identity)[0] for clip in (a, b))


def test_what_is_no_clip_is_named(store):
    make(store, request())
    (store.clips / "stray").mkdir()
    (store.clips / "file").write_text("")
    assert [path.name for path in store.foreign()] == ["file", "stray"]


def test_lost_cost_is_no_damage(store):
    clip = make(store, request())
    (clip.directory / "cost.json").unlink()
    assert store.problems_of(clip.identity) == []
    assert clip.cost() == {}


def test_second_publication_of_a_whole_clip_changes_nothing(store):
    first = make(store, request())
    inode = first.frame_path(0).stat().st_ino
    make(store, request())
    assert first.frame_path(0).stat().st_ino == inode
    assert list((store.root / "building").iterdir()) == []


def test_half_made_clip_is_never_seen(store):
    asked = request()
    write_part(store, asked, 0, 3)
    writer = PartWriter(store, asked, 3)
    writer.add(color(asked, 3), {"Z": np.zeros((8, 12), np.float32)})
    assert not store.has(asked.identity)
    assert list(store.published()) == []
    with pytest.raises(InputError, match="wanted a rendered or imported clip"):
        store.open(asked.identity)
    with pytest.raises(InputError, match="frames: got 3, wanted 6"):
        assemble(store, asked, ["frames-0-3"])


def test_damaged_part_is_named_and_not_joined(store):
    asked = request()
    names = [write_part(store, asked, 0, 3), write_part(store, asked, 3, 6)]
    damage_byte(part_directory(store, asked.identity, names[1]) / "000004.exr")
    with pytest.raises(DamagedPart, match="frames-3-6"):
        assemble(store, asked, names)
    assert not store.has(asked.identity)
    assert has_part(store, asked.identity, names[0])


def test_wrong_frames_are_refused(store):
    writer = PartWriter(store, request())
    with pytest.raises(InputError, match="frame shape"):
        writer.add(np.zeros((12, 8, 3), np.float32))
    writer.add(color(request(), 0))
    with pytest.raises(InputError, match="channels"):
        writer.add(color(request(), 1), {"Z": np.zeros((8, 12), np.float32)})


def test_what_dead_processes_left_is_cleared_and_what_living_ones_make_is_not(store):
    mine = store.new_building()
    code = f"from stimuli.clip import ClipStore; ClipStore({str(store.root)!r}).new_building()"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert len(list((store.root / "building").iterdir())) == 2
    assert store.clear_abandoned() == 1
    assert list((store.root / "building").iterdir()) == [mine]


def test_store_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "f").write_text("")
    with pytest.raises(InputError, match="wanted a directory"):
        ClipStore(tmp_path / "f")


def test_disk_estimate_counts_each_clip_once_and_bounds_the_store(store):
    requests = [request(), request(), request(seed=1, extra={"channels": ["Z", "motion.X", "samples"]})]
    estimate = estimate_disk(requests)
    assert (estimate.clips, estimate.frames) == (2, 12)
    assert estimate.exr_bytes == 6 * 96 * 6 + 6 * 96 * (6 + 4 + 2 + 4)
    assert estimate.play_bytes == 12 * 96 * 4


def test_manifest_with_names_outside_the_clip_is_refused(store):
    clip = make(store, request())
    edit(clip.directory, lambda m: m["files"][0].update(name="../../../etc/passwd"))
    with pytest.raises(InputError):
        store.open(clip.identity)
