"""Production: the same bytes whoever made them; what dies is made again, what cannot be made is named."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

import renderers.units
from renderers.produce import only_producer, produce, units_of
from renderers.units import average_blocks, block_sizes
from stimuli.clip import ClipStore
from stimuli.clip_job import ClipJob
from stimuli.clip_parts import part_directory
from stimuli.errors import InputError
from tests.renderers.toy_renderer import picture
from tests.stimuli.test_clip import DAMAGE, damage_byte, files_of, request

TOY = "tests.renderers.toy_renderer:Toy"


@pytest.fixture
def store(tmp_path) -> ClipStore:
    return ClipStore(tmp_path / "store")


@pytest.fixture
def small_units(monkeypatch):
    """Units of about two frames, so that small clips are divided."""
    monkeypatch.setattr(renderers.units, "UNIT_SAMPLES", 2 * 12 * 8)


def jobs(tmp_path, count: int = 2, **changes) -> list[ClipJob]:
    return [ClipJob(request(seed=seed, **changes), str(tmp_path / "scene")) for seed in range(count)]


def all_files(store: ClipStore) -> dict[str, bytes]:
    return {f"{d.name}/{n}": b for d in store.clips.iterdir() for n, b in files_of(d).items()}


def test_clips_hold_the_renderers_frames(store, tmp_path):
    (job,) = jobs(tmp_path, 1)
    outcome = produce([job], store, bar=False, renderer=TOY)
    assert outcome.made == (job.request.identity,)
    clip = store.open_verified(job.request.identity)
    for k in range(6):
        np.testing.assert_array_equal(clip.frame(k).color, picture(0, k, 0, (12, 8)).astype(np.float16))
    assert clip.cost()["workers"] == 1
    assert not (store.root / "parts" / clip.identity).exists()


def test_two_workers_and_one_process_give_the_same_bytes(store, tmp_path, small_units):
    work = jobs(tmp_path)
    assert all(len(units_of(job.request)) == 3 for job in work)
    other = ClipStore(tmp_path / "other")
    one = produce(work, store, 1, bar=False, renderer=TOY)
    two = produce(work, other, 2, bar=False, renderer=TOY)
    assert sorted(one.made) == sorted(two.made)
    assert all_files(store) == all_files(other)
    assert list((other.root / "building").iterdir()) == []


def test_sample_ranges_merge_to_the_same_bytes_as_whole_frames(store, tmp_path, monkeypatch):
    work = [ClipJob(request(3, technique="reference", params={"spp": 200}), "")]
    sizes = block_sizes(200)
    assert len(units_of(work[0].request)) == 1
    produce(work, store, bar=False, renderer=TOY)
    monkeypatch.setattr(renderers.units, "UNIT_SAMPLES", 96 * 64)
    assert len(units_of(work[0].request)) == 12
    other = ClipStore(tmp_path / "other")
    produce(work, other, 2, bar=False, renderer=TOY)
    assert all_files(store) == all_files(other)
    clip = store.open(work[0].request.identity)
    wanted = average_blocks([picture(0, 2, b, (12, 8)) for b in range(4)], sizes)
    np.testing.assert_array_equal(clip.frame(2).color, wanted.astype(np.float16))
    assert clip.cost()["frames"][0]["rays"] == {"primary": 200}
    assert other.open(clip.identity).cost()["frames"][0]["rays"] == {"primary": 200}


def test_error_of_a_reference_is_in_the_manifest_and_right(store, tmp_path):
    job = ClipJob(request(3, technique="reference", params={"spp": 256}, size_px=(64, 64), exposure=0.05), "")
    produce([job], store, bar=False, renderer=TOY)
    facts = store.open(job.request.identity).manifest["frame_facts"]
    # four independent uniform blocks of variance 1/12; the display value's slope at the mean turns light into sRGB
    light = 0.05 * 0.5
    slope = 1.055 / 2.4 * light ** (1 / 2.4 - 1)
    assert facts["1"]["standard_error"] == pytest.approx(0.05 * (1 / 12 / 4) ** 0.5 * slope, rel=0.15)


def test_whole_clips_are_kept_and_not_made_twice(store, tmp_path):
    work = jobs(tmp_path)
    produce(work, store, bar=False, renderer=TOY)
    before = {path: path.stat().st_mtime_ns for path in store.clips.rglob("*.exr")}
    outcome = produce([*work, work[0]], store, 2, bar=False, renderer="no_such_module:Renderer")
    assert len(outcome.kept) == 2
    assert not outcome.made
    assert before == {path: path.stat().st_mtime_ns for path in store.clips.rglob("*.exr")}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_clips_are_made_again(store, tmp_path, kind):
    work = jobs(tmp_path)
    produce(work, store, bar=False, renderer=TOY)
    before = all_files(store)
    DAMAGE[kind][0](store.directory(work[1].request.identity))
    outcome = produce(work, store, bar=False, renderer=TOY)
    assert outcome.remade == (work[1].request.identity,)
    assert outcome.kept == (work[0].request.identity,)
    assert all_files(store) == before


def test_killed_workers_are_replaced_and_nothing_shows(store, tmp_path, small_units):
    work = jobs(tmp_path, 1)
    other = ClipStore(tmp_path / "other")
    produce(work, other, bar=False, renderer=TOY)
    outcome = produce(work, store, 2, bar=False, renderer="tests.renderers.toy_renderer:DiesOnce")
    assert len(list(tmp_path.glob("died-*"))) == 2
    assert not outcome.poisoned
    assert all_files(store) == all_files(other)


def test_poisoned_unit_is_named_with_a_command_that_shows_it_and_others_are_made(store, tmp_path, small_units):
    work = jobs(tmp_path)
    renderer = "tests.renderers.toy_renderer:FailsAtFrame3"
    for workers in (1, 2):
        outcome = produce(work, store, workers, bar=False, renderer=renderer)
        (bad,) = outcome.poisoned
        assert bad.identity == work[1].request.identity
        assert bad.unit.name == "frames-000002-000004"
        assert "the kernel of frame 3 is broken" in bad.reason
        assert store.has(work[0].request.identity)
        assert not store.has(work[1].request.identity)
    done = subprocess.run(
        [sys.executable, *shlex.split(bad.command)[1:]], capture_output=True, text=True, env=os.environ, check=False
    )
    assert done.returncode == 1
    assert "the kernel of frame 3 is broken" in done.stderr
    # mended, the same call goes on from what was finished
    kept = part_directory(store, work[1].request.identity, "frames-000000-000002").stat().st_mtime_ns
    assert kept
    assert produce(work, store, bar=False, renderer=TOY).made == (work[1].request.identity,)


def test_unit_that_kills_every_worker_is_given_up(store, tmp_path, small_units):
    outcome = produce(jobs(tmp_path), store, 2, bar=False, renderer="tests.renderers.toy_renderer:DiesAtFrame3")
    (bad,) = outcome.poisoned
    assert "3 times" in bad.reason
    assert "SIGKILL" in bad.reason
    assert len(outcome.made) == 1


def test_wrong_input_is_not_tried_again(store, tmp_path):
    for workers in (1, 2):
        outcome = produce(
            jobs(tmp_path, 1), store, workers, bar=False, renderer="tests.renderers.toy_renderer:RefusesTheScene"
        )
        assert [bad.reason for bad in outcome.poisoned] == ["toy: scene: got nonsense, wanted sense"]


def test_damaged_parts_are_made_again_on_resume(store, tmp_path, small_units):
    work = jobs(tmp_path)
    outcome = produce(work, store, bar=False, renderer="tests.renderers.toy_renderer:FailsAtFrame3")
    assert len(outcome.poisoned) == 1
    parts = store.root / "parts" / work[1].request.identity
    damage_byte(parts / "frames-000000-000002" / "000001.exr")
    (parts / "frames-000004-000006" / "part.json").write_text("{")
    produce(work, store, bar=False, renderer=TOY)
    other = ClipStore(tmp_path / "other")
    produce(work, other, bar=False, renderer=TOY)
    assert all_files(store) == all_files(other)


def test_killed_producer_leaves_nothing_that_shows_and_its_workers_end(store, tmp_path):
    from tests.prove.kill_workers import half_made, start, work

    client = start(store, 2, "")
    try:
        while len(list((store.root / "parts").glob("*/frames-*"))) < 3:
            time.sleep(0.02)
        children = psutil.Process(client.pid).children()
    finally:
        client.kill()
        client.wait()
    assert children
    assert half_made(store) == []
    _, alive = psutil.wait_procs(children, timeout=20)
    assert not alive
    produce(work(), store, bar=False, renderer=TOY)
    other = ClipStore(tmp_path / "other")
    produce(work(), other, bar=False, renderer=TOY)
    assert all_files(store) == all_files(other)
    assert list((store.root / "building").iterdir()) == []


def test_two_producers_at_once_are_refused(store, tmp_path):
    with only_producer(store), pytest.raises(InputError, match="one at a time"):
        produce(jobs(tmp_path), store, bar=False, renderer=TOY)
    produce(jobs(tmp_path), store, bar=False, renderer=TOY)
    with pytest.raises(InputError, match="workers"):
        produce(jobs(tmp_path), store, 0, bar=False, renderer=TOY)


def test_unit_command_refuses_what_was_never_begun(store, capsys):
    from renderers.render_unit import main

    assert main(["--store", str(store.root), "ab" * 32, "frames-000000-000001"]) == 2
    assert "wanted one that studyapp render has begun" in capsys.readouterr().err


def test_pictures_that_do_not_fit_are_refused_before_anything_is_made(tmp_path):
    store = ClipStore(tmp_path)
    jobs = [ClipJob(request(4, size_px=(60_000, 60_000), technique=name), "") for name in ("vanilla", "taa")]
    with pytest.raises(InputError, match=r"60000x60000, for which taa needs \d+ bytes") as caught:
        produce(jobs, store, bar=False, renderer=TOY)
    assert len(caught.value.problems) == 2
    assert not (tmp_path / "parts").exists()
