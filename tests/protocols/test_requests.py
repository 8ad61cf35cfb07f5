from __future__ import annotations

from dataclasses import replace

from protocols.check import size_problems, summarise, trial_seconds
from protocols.design import plan
from protocols.requests import clip_requests, clip_spec, clip_specs, with_clips
from tests.protocols.tiny import pairs, rating, tiny


def test_every_clip_of_every_participant_is_there_and_each_once() -> None:
    study = tiny(
        participants={"between": {"pace": {"slow": {"duration_s": 2}, "quick": {}}}},
        blocks=[
            pairs(compare={"of": ["full", "half", "dense"], "spread_over": ["scene"]}, practice=3,
                  practice_set={"duration_s": 1}, catch={"good": "gold", "bad": "half"}),
            rating(catch={"bad": "gold", "expect": [-3, 0]}),
        ],
    )  # fmt: skip
    specs = clip_specs(study)
    assert len(set(specs)) == len(specs)
    used = {clip_spec(study, t, p) for n in range(1, 13) for t in plan(study, n) for p in t.panels}
    assert used <= set(specs)
    assert used == set(specs)


def test_what_changes_pixels_changes_the_clip_and_what_does_not_does_not() -> None:
    study = tiny(blocks=[rating(repetitions=1)])
    (first, *_) = clip_specs(study)
    assert first.frame_count == 4 * 240
    words = tiny(
        blocks=[rating(repetitions=7)], title="other", questions={"clean": {"kind": "likert", "text": "Other?"}}
    )
    assert set(clip_specs(words)) == set(clip_specs(study))
    for over in ({"start_s": 1}, {"size_px": [64, 64]}, {"lighting": "ambient_occlusion"}, {"warm_up_s": 0.5}):
        assert not set(clip_specs(tiny(blocks=[rating(repetitions=1)], defaults=over))) & set(clip_specs(study))


def test_requests_take_hashes_and_exposures_from_the_caller() -> None:
    study = tiny(scenes={"a": {"scene": "bar", "exposure": 2.0}, "b": "bar"}, blocks=[rating(repetitions=1)])
    requests = clip_requests(study, {"a": "aa", "b": "bb"}, {"a": 1.0, "b": 0.5})
    assert {(r.scene_sha256, r.exposure) for r in requests.values()} == {("aa", 2.0), ("bb", 0.5)}
    trial = with_clips(study, next(t for t in plan(study, 1) if t.panels), requests)
    assert trial.panels[0].clip == requests[clip_spec(study, trial, trial.panels[0])].identity


def test_gaze_and_geometry_are_part_of_gaze_contingent_clips_only() -> None:
    study = tiny(
        display={"geometry": "screen", "width_m": 0.5, "size_px": [1000, 500], "distance_m": 0.5},
        defaults={"size_px": [200, 100], "fixation": "fixed"},
        conditions={"full": "vanilla", "fov": "foveated"},
        blocks=[rating(factors={"scene": ["a"], "condition": ["full", "fov"]})],
    )
    plain, gazed = clip_specs(study)
    assert (plain.geometry, plain.gaze) == (None, None)
    assert gazed.geometry == (0.1, 0.05, 0.5, 0.0, 0.0)
    assert gazed.gaze == (0.0, 0.0)


def test_a_path_of_keyframes_is_in_the_request() -> None:
    keys = [{"time_s": t, "position": [t, 0, 0], "look_at": [0, 0, -1]} for t in (0, 1)]
    study = tiny(paths={"round": keys}, defaults={"path": "round"}, blocks=[rating()])
    moved = tiny(
        paths={"round": [keys[0], {**keys[1], "position": [2, 0, 0]}]}, defaults={"path": "round"}, blocks=[rating()]
    )
    one, other = (clip_requests(s, {"a": "", "b": ""}, {"a": 1, "b": 1}) for s in (study, moved))
    assert not {r.identity for r in one.values()} & {r.identity for r in other.values()}


def test_the_summary_counts_bytes_minutes_and_refreshes() -> None:
    study = tiny(defaults={"size_px": [100, 50], "duration_s": 2, "iti_s": 0.5}, participants={"target": 4})
    summary = summarise(study)
    assert summary.upload_bytes == 3 * 100 * 50 * 4
    assert summary.trials == 6 + 12
    assert summary.minutes * 60 == 18 * (2 + 2 + 0.5)
    assert summary.frames == sum(spec.frame_count for spec in summary.clips) == 2 * (3 * 480 + 240)
    assert summary.play_bytes == summary.frames * 100 * 50 * 4
    assert summary.blocks[0].balance["first_minus_last_slot"] == (0, 0)


def test_two_intervals_take_twice_as_long() -> None:
    study = tiny(blocks=[pairs(kind="two_interval", reference=None, set={"interval_gap_s": 1, "duration_s": 3})])
    trial = plan(study, 1)[0]
    assert trial_seconds(study, trial) == 3 + 1 + 3 + 2 + 0.5
    assert trial_seconds(study, replace(trial, panels=())) == 15


def test_panels_that_do_not_fit_on_the_display_are_named() -> None:
    assert size_problems(tiny()) == []
    study = tiny(display={"size_px": [1500, 1080]})
    ((loc, *said),) = size_problems(study)
    assert loc == ("blocks", 0)
    assert said == ["block pairs: panels", "1568x512 px", "at most 1500x1080 px (display.size_px)"]


def test_every_technique_shows_the_moving_target_but_side_by_side() -> None:
    study = tiny(
        conditions={"gold": "reference", "fov": "foveated", "plain": "vanilla", "taa": "taa"},
        defaults={"fixation": "moving"},
        blocks=[
            rating(factors={"scene": ["a"], "condition": ["fov", "plain"]}),
            pairs(reference="gold", compare={"of": ["plain", "taa"]}, factors={"scene": ["a"]}),
        ],
    )
    gazes = {
        (trial.block, panel.condition): clip_spec(study, trial, panel).gaze
        for trial in plan(study, 1)
        for panel in trial.panels
    }
    assert gazes["rating", "fov"] == gazes["rating", "plain"] == "moving"
    assert {gaze for (block, _), gaze in gazes.items() if block == "pairs"} == {None}
