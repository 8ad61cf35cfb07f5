"""`studyapp render` and `studyapp store` on a tiny protocol: from the file to frames that can be played."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from protocols.design import plan
from protocols.load import load_study
from stimuli.clip import ClipStore
from stimuli.encode import linear_from_srgb, table_from_samples
from stimuli.errors import InputError
from studyapp.cli import main
from studyapp.clips import (
    luminance_problems,
    measured_read_rate,
    memory_problems,
    resolve_clips,
    sources_for,
    store_problems,
    with_clips,
)
from studyapp.store_root import store_directory
from studyapp.stored_sources import StoredSources
from tests.stimuli.test_clip import DAMAGE, files_of

PROTOCOL = """
study: tiny
seed: 3
display: {refresh_hz: 240, size_px: [640, 480]}
defaults: {size_px: [16, 12], duration_s: 1/40, warm_up_s: 1/60}
scenes:
  tunnel: {scene: tunnel_geom, start_s: 2}
conditions:
  gold: {technique: reference, params: {spp: 4}}
  plain: {technique: vanilla}
  slow: {technique: vanilla, rate_hz: 120}
questions:
  closer: {kind: choice, text: Which one?}
blocks:
  - name: compare
    kind: side_by_side
    reference: gold
    compare: {of: [plain, slow]}
    factors: {scene: [tunnel]}
    questions: [closer]
"""


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """A protocol and the store that `studyapp render` filled for it."""
    folder = tmp_path_factory.mktemp("tiny")
    (folder / "tiny.yaml").write_text(PROTOCOL)
    assert main(["render", str(folder / "tiny.yaml")]) == 0
    return folder / "tiny.yaml"


@pytest.fixture
def copied(rendered, tmp_path):
    """The same, to be damaged."""
    shutil.copytree(rendered.parent, tmp_path / "copy")
    return tmp_path / "copy" / "tiny.yaml"


def store_of(protocol) -> ClipStore:
    return ClipStore(store_directory(protocol))


def test_rendered_clips_are_those_of_the_plans_trials(rendered):
    study, store = load_study(rendered), store_of(rendered)
    clips = resolve_clips(study, rendered, store)
    assert store_problems(clips, store) == []
    (trial,) = [with_clips(study, trial, clips) for trial in plan(study, 1) if trial.panels]
    sources = sources_for(trial, store)
    assert {source.frame_count for source in sources.values()} == {6, 3}
    assert all(source.size_px == (16, 12) for source in sources.values())
    by_rate = {source.rate_hz: source for source in sources.values() if source.rate_hz == 120}
    assert len(by_rate) == 1
    # the slow clip's frame 1 is the moment of the fast one's frame 2
    slow = by_rate[120]
    plain = sources[next(panel.slot for panel in trial.panels if panel.condition == "plain")]
    np.testing.assert_array_equal(slow.frame(1), plain.frame(2))
    assert (plain.frame(0) != plain.frame(5)).any()
    assert luminance_problems(study, trial, store) == []
    assert memory_problems(list(sources.values())) == []
    (line,) = memory_problems(list(sources.values()), available_bytes=1000)
    assert "free memory" in line


def test_clips_too_large_for_memory_play_from_a_disk_that_is_twice_as_fast(rendered, monkeypatch):
    study, store = load_study(rendered), store_of(rendered)
    clips = resolve_clips(study, rendered, store)
    (trial,) = [with_clips(study, trial, clips) for trial in plan(study, 1) if trial.panels]
    needed = 16 * 12 * 4 * (240 + 240 + 120)  # bytes a second of the three panels
    monkeypatch.setattr("studyapp.clips.memory_problems", lambda sources: ["does not fit"])
    monkeypatch.setattr("studyapp.clips.measured_read_rate", lambda path, size: 2.0 * needed)
    assert len(sources_for(trial, store)) == 3
    monkeypatch.setattr("studyapp.clips.measured_read_rate", lambda path, size: 1.9 * needed)
    with pytest.raises(InputError, match="does not fit"):
        sources_for(trial, store)


def test_check_compares_the_luminance_of_what_was_made(copied, capsys):
    assert main(["check", str(copied)]) == 0
    strict = copied.with_name("strict.yaml")
    strict.write_text(PROTOCOL + "timing: {luminance_limit: 0}\n")
    assert main(["check", str(strict)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "block compare, scene tunnel: luminance of" in line
    # Clips of other pictures are no part of it, nor is a store that is not there.
    strict.write_text(strict.read_text().replace("[16, 12]", "[16, 14]"))
    assert main(["check", str(strict)]) == 0
    assert main(["check", str(copied), "--store", str(copied.parent / "nowhere")]) == 0
    assert not (copied.parent / "nowhere").exists()


def test_a_measured_display_gets_codes_for_its_own_light(copied):
    study = load_study(copied)
    table = table_from_samples([0, 255], [0.0, 80.0])
    plain, measured = (StoredSources(study, copied, None, given) for given in (None, table))
    (trial,) = [trial for trial in plain.planned(plan(study, 1)) if trial.panels]
    codes, asked = (sources(trial)[trial.panels[0].slot].frame(2)[..., :3] for sources in (plain, measured))
    light = 255 * linear_from_srgb(codes / 255)
    # Between two sRGB codes there are at most 255 * 2.3 / 255 = 2.3 linear ones.
    np.testing.assert_allclose(asked, light, atol=1.7)
    assert np.abs(asked.astype(int) - codes).max() > 20


def test_clips_beyond_four_fifths_of_memory_tell_the_presenter_the_disks_rate(rendered, monkeypatch):
    sources = StoredSources(load_study(rendered), rendered, None)
    (trial,) = [trial for trial in sources.planned(plan(load_study(rendered), 1)) if trial.panels]
    sources(trial)
    assert sources.disk_bytes_s is None
    monkeypatch.setattr("studyapp.stored_sources.free_memory_bytes", lambda: 12_000)
    sources(trial)
    assert sources.disk_bytes_s is not None
    assert sources.disk_bytes_s > 1e6


def test_read_rate_is_measured(tmp_path):
    (tmp_path / "file").write_bytes(bytes(1 << 20))
    assert 1e6 < measured_read_rate(tmp_path / "file", 1 << 28) < 1e12


def test_exposure_is_the_references_and_kept(rendered):
    store = store_of(rendered)
    (kept,) = (store.root / "exposure").iterdir()
    exposure = json.loads(kept.read_text())["exposure"]
    assert 8 * np.log2(exposure) == pytest.approx(round(8 * np.log2(exposure)))
    assert {clip.request.exposure for clip in store.published()} == {exposure}
    kept.write_text("junk")
    clips = resolve_clips(load_study(rendered), rendered, store)
    assert {request.exposure for request in clips.requests.values()} == {exposure}


def test_second_render_makes_nothing(rendered, capsys):
    before = {p: p.stat().st_mtime_ns for p in store_of(rendered).clips.rglob("*")}
    assert main(["render", str(rendered)]) == 0
    assert "made 0, made again 0 damaged, 3 were there" in capsys.readouterr().out
    assert before == {p: p.stat().st_mtime_ns for p in store_of(rendered).clips.rglob("*")}


@pytest.mark.parametrize("kind", ["a bit turned over", "a file cut short", "two frames swapped", "a foreign file"])
def test_damage_is_found_by_verify_refused_by_run_and_remade_by_render(copied, kind, capsys):
    store = store_of(copied)
    study = load_study(copied)
    clip = max(store.published(), key=lambda c: c.frame_count)
    before = files_of(clip.directory)
    harm, name = DAMAGE[kind]
    harm(clip.directory)
    assert main(["store", "verify", "--store", str(store.root)]) == 1
    assert name in capsys.readouterr().out
    clips = resolve_clips(study, copied, store)
    assert store_problems(clips, store)
    shutil.rmtree(store.root / "play", ignore_errors=True)  # a cache made before the damage would still be right
    (trial,) = [with_clips(study, trial, clips) for trial in plan(study, 1) if trial.panels]
    if any(panel.clip == clip.identity for panel in trial.panels):
        with pytest.raises(InputError):
            sources_for(trial, store)
    assert main(["render", str(copied)]) == 0
    assert "made again 1" in capsys.readouterr().out
    assert files_of(clip.directory) == before
    assert main(["store", "verify", "--store", str(store.root)]) == 0


def test_listing_tells_every_clip(rendered, capsys):
    root = str(store_of(rendered).root)
    assert main(["store", "ls", "--store", root]) == 0
    out = capsys.readouterr().out
    assert "3 clips, 15 frames" in out
    assert main(["store", "ls", "--json", "--store", root]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert sorted(row["request"]["technique"] for row in rows) == ["reference", "vanilla", "vanilla"]
    assert main(["store", "verify", "--quick", "--store", root]) == 0


def test_gc_drops_only_what_no_kept_protocol_needs(copied, capsys):
    store = store_of(copied)
    other = copied.with_name("other.yaml")
    other.write_text(PROTOCOL.replace("rate_hz: 120", "rate_hz: 60"))
    (store.root / "play").mkdir(exist_ok=True)
    (store.root / "play" / "orphan.rgba").write_bytes(b"")
    assert main(["store", "gc", "--store", str(store.root), "--keep", str(other), "--dry-run"]) == 0
    assert "would go: 1 clips, 1 play caches" in capsys.readouterr().out
    assert len(store.identities()) == 3
    assert main(["store", "gc", "--store", str(store.root), "--keep", str(other)]) == 0
    assert len(store.identities()) == 2
    assert not (store.root / "play" / "orphan.rgba").exists()
    assert main(["store", "gc", "--store", str(store.root)]) == 0
    assert len(store.identities()) == 2


def test_imported_clips_are_played_like_any_other(copied, tmp_path, capsys):
    text = PROTOCOL.replace("slow: {technique: vanilla, rate_hz: 120}", "slow: {technique: 'imported:theirs'}")
    copied.write_text(text)
    study, store = load_study(copied), store_of(copied)
    with pytest.raises(InputError, match="imported:theirs: imported clip: got none in the store"):
        resolve_clips(study, copied, store)
    (tmp_path / "frames").mkdir()
    for k in range(6):
        Image.fromarray(np.full((12, 16, 3), 40 * k, np.uint8)).save(tmp_path / "frames" / f"{k}.png")
    bring = ["store", "import", str(tmp_path / "frames"), "--rate", "240", "--technique", "theirs", "--scene", "tunnel"]
    assert main([*bring, "--transfer", "srgb", "--store", str(store.root)]) == 0
    assert "technique: imported:theirs" in capsys.readouterr().out
    clips = resolve_clips(study, copied, store)
    (trial,) = [with_clips(study, trial, clips) for trial in plan(study, 1) if trial.panels]
    slot = next(panel.slot for panel in trial.panels if panel.condition == "slow")
    assert sources_for(trial, store)[slot].frame(3)[0, 0].tolist() == [120, 120, 120, 255]
    assert any("apart" in line for line in luminance_problems(study, trial, store))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["render", "nowhere.yaml"], "nowhere.yaml"),
        (["render", "demo", "--workers", "0"], "at least 1"),
        (["store", "ls", "--store", "/nonexistent/store"], "clip store"),
        (
            [
                "store",
                "import",
                "/nonexistent",
                "--rate",
                "240",
                "--technique",
                "a",
                "--scene",
                "b",
                "--transfer",
                "srgb",
            ],
            "nothing there",
        ),
    ],
)
def test_wrong_input_ends_with_one_line_and_2(arguments, text, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert text in error
    assert "Traceback" not in error


def test_scene_that_is_nowhere_is_named_and_one_that_stands_in_is_said(tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text(PROTOCOL.replace("scene: tunnel_geom", "scene: lost.glb"))
    with pytest.raises(InputError, match=r"lost\.glb"):
        resolve_clips(load_study(file), file, store_of(file))
    file.write_text(PROTOCOL.replace("scene: tunnel_geom", "scene: lost.glb, instead: tunnel_geom"))
    assert "tunnel_geom stands in" in resolve_clips(load_study(file), file, store_of(file)).notes[0]


def test_store_is_the_option_the_environment_or_beside_the_protocol(tmp_path, monkeypatch):
    monkeypatch.delenv("STUDYAPP_STORE", raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deep").mkdir()
    file = tmp_path / "deep" / "p.yaml"
    file.write_text(PROTOCOL)
    assert store_directory(file) == tmp_path / "deep" / ".clips"
    assert store_directory("demo") == tmp_path / ".clips"
    monkeypatch.setenv("STUDYAPP_STORE", str(tmp_path / "env"))
    assert store_directory(file) == tmp_path / "env"
    assert store_directory(file, str(tmp_path / "given")) == tmp_path / "given"


def test_a_stated_error_decides_the_samples_of_the_reference(tmp_path, capsys, monkeypatch):
    protocol = tmp_path / "tiny.yaml"
    protocol.write_text(PROTOCOL.replace("params: {spp: 4}}", "params: {spp: 256}, reference_error: 0.03}"))
    assert main(["render", str(protocol)]) == 0
    store = store_of(protocol)
    (gold,) = [clip for clip in store.published() if clip.request.technique == "reference"]
    spp = gold.request.params["spp"]
    assert 4 <= spp < 256
    errors = [facts["standard_error"] for facts in gold.manifest["frame_facts"].values()]
    assert 0.03 / 4 < max(errors) <= 0.03
    # Settled once: a run, or the same command again, measures nothing.
    monkeypatch.setattr("renderers.convergence.reference_error", lambda *given: 1 / 0)
    assert main(["render", str(protocol)]) == 0
    assert "3 were there" in capsys.readouterr().out
    monkeypatch.undo()
    (kept,) = (store.root / "convergence").iterdir()
    kept.write_text("{}")
    assert resolve_clips(load_study(protocol), protocol, store)
    protocol.write_text(PROTOCOL.replace("params: {spp: 4}}", "params: {spp: 4}, reference_error: 1.0e-9}"))
    assert main(["render", str(protocol)]) == 2
    assert "scene tunnel: reference error: got 0.0" in capsys.readouterr().err
    protocol.write_text(PROTOCOL.replace("{technique: vanilla}", "{technique: vanilla, reference_error: 0.1}"))
    assert main(["check", str(protocol)]) == 2
    assert "conditions.plain.reference_error: got in a condition of vanilla" in capsys.readouterr().err
