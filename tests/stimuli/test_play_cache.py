"""The play cache: the encoder's own codes, mapped, checked, made again where damaged."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from stimuli.clip import ClipStore
from stimuli.encode import DisplayTable, encode
from stimuli.errors import InputError
from stimuli.play_cache import HEADER_BYTES, PlayCache, PlayedClip
from tests.stimuli.test_clip import color, make, request


@pytest.fixture
def store(tmp_path) -> ClipStore:
    return ClipStore(tmp_path / "store")


def test_frames_are_the_live_encoders_codes(store):
    asked = request(exposure=0.7, rate_hz="60000/1001", duration_s="1001/10000")
    source = PlayCache(store).played(make(store, asked))
    assert (source.size_px, source.rate_hz, source.frame_count) == ((12, 8), Fraction(60000, 1001), 6)
    for index in range(6):
        np.testing.assert_array_equal(source.frame(index), encode(color(asked, index), 0.7))
    frame = source.frame(3)
    assert frame.flags.c_contiguous
    assert not frame.flags.writeable
    source.touch()
    for outside in (-1, 6):
        with pytest.raises(IndexError):
            source.frame(outside)


def test_second_use_reads_the_same_file(store):
    clip = make(store, request())
    first = PlayCache(store).played(clip).path.stat()
    assert PlayCache(store).played(clip).path.stat().st_mtime_ns == first.st_mtime_ns
    assert len(list((store.root / "play").iterdir())) == 1


def test_another_display_table_is_another_file(store):
    clip = make(store, request())
    linear = DisplayTable(tuple(np.linspace(0, 100, 256)))
    a, b = PlayCache(store).played(clip), PlayCache(store, linear).played(clip)
    assert a.path != b.path
    np.testing.assert_array_equal(b.frame(0), encode(color(clip.request, 0), 1.0, "none", linear))


@pytest.mark.parametrize("harm", ["bit", "cut", "header", "empty", "foreign", "swapped"])
def test_damage_is_found_and_made_good_from_the_clip(store, harm):
    clip = make(store, request())
    cache = PlayCache(store)
    path = cache.played(clip).path
    whole = path.read_bytes()
    if harm == "swapped":
        other = cache.played(make(store, request(seed=5))).path
        path.write_bytes(other.read_bytes())
    else:
        flipped = bytearray(whole)
        flipped[HEADER_BYTES + 100] ^= 4
        path.write_bytes(
            {"bit": flipped, "cut": whole[:-1], "header": b"{" + whole[1:], "empty": b"", "foreign": b"PNG"}[harm]
        )
    cache.played(clip)
    assert path.read_bytes() == whole


def test_damage_is_named(store):
    source = PlayCache(store).played(make(store, request()))
    assert source.problems() == []
    data = bytearray(source.path.read_bytes())
    data[-5] ^= 1
    source.path.write_bytes(data)
    assert "sha256" in PlayedClip(source.path).problems()[0]
    source.path.write_bytes(data[:-1])
    with pytest.raises(InputError, match="bytes"):
        PlayedClip(source.path)


def test_unused_caches_are_those_without_a_clip(store):
    cache = PlayCache(store)
    kept, gone = make(store, request()), make(store, request(seed=1))
    cache.played(kept)
    orphan = cache.played(gone).path
    store.discard(gone.identity)
    (store.root / "play" / "junk.rgba").write_bytes(b"junk")
    assert set(cache.unused()) == {orphan, store.root / "play" / "junk.rgba"}


def test_interrupted_writing_leaves_nothing_that_looks_whole(store, monkeypatch):
    clip = make(store, request())
    broken = replace(clip, manifest={**clip.manifest, "files": clip.manifest["files"] + [{"name": "000099.exr"}]})
    with pytest.raises(InputError):
        PlayCache(store).played(broken)
    assert list((store.root / "play").iterdir()) == []
