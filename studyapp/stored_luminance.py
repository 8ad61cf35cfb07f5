"""Luminance of compared clips that the store already holds, found without loading a scene: what `check` can say early.

`run` compares all clips of its trials (`studyapp.clips.luminance_problems`); `check` those that were made, whoever made
them, and says nothing of those that were not.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

from protocols.requests import ClipSpec, clip_spec, possible_trials
from protocols.study import Study
from stimuli.clip import Clip, ClipStore
from stimuli.clip_request import ClipRequest
from stimuli.errors import problem


def stored_luminance_problems(study: Study, store: ClipStore) -> list[str]:
    """One line for each set of compared conditions whose stored clips differ in mean displayed luminance by more than
    the protocol's limit."""
    limit = float(study.timing.luminance_limit)
    found = _newest(store)
    lines: dict[str, None] = {}
    for trial in possible_trials(study):
        means: dict[str, float] = {}
        for panel in trial.panels:
            clip = None if panel.live else found.get(_asked(clip_spec(study, trial, panel)))
            if clip is not None:
                means[panel.condition] = float(clip.manifest["luminance"]["mean"])
        if len(means) < 2:
            continue
        low, high = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        share = (means[high] - means[low]) / means[high] if means[high] > 0 else 0.0
        if share > limit:
            what = f"luminance of {low} and {high} in the store"
            where = f"block {trial.block}, scene {trial.scene}"
            lines[problem(where, what, f"{100 * share:.2f} % apart", f"at most {100 * limit:g} %")] = None
    return list(lines)


def _newest(store: ClipStore) -> Mapping[str, Clip]:
    """What was asked for -> the clip made last for it (an edited scene or another exposure leaves older ones)."""
    clips = sorted(store.published(), key=lambda clip: (clip.directory.stat().st_mtime_ns, clip.identity))
    return {_key(clip.request): clip for clip in clips}


def _asked(spec: ClipSpec) -> str:
    return _key(spec.request("", 1.0))


def _key(request: ClipRequest) -> str:
    """All that the protocol itself says of a clip: neither the scene's content nor the exposure settled from it, and
    no warm-up, which techniques without memory do without."""
    said = (
        request.scene, request.technique, dict(request.params), request.size_px, str(request.rate_hz),
        str(request.duration_s), request.path, request.animation, str(request.start_s), request.seed, request.lighting,
        request.geometry, request.gaze, request.loop,
    )  # fmt: skip
    return json.dumps(said, sort_keys=True)
