"""How far what was really shown is from the reference, for observers that judge by the pictures.

The frames come from the play cache, which frame stood at which refresh from the presenter's own rows: a missed refresh
holds the frame before it. The reference is what should have been there at that refresh: the reference panel's clip, or
(in trials without one) the study's clip of technique `reference` for the same scene, path and size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Literal

import numpy as np

from protocols.records import MAX_PANELS
from protocols.requests import ClipSpec, clip_spec
from protocols.study import Study
from protocols.trial import Trial
from renderers.metrics import INTEGRATED_REFRESHES, flicker, flip
from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError, problem
from studyapp.seams import FlipSink, FrameSource

Metric = Literal["rmse", "flip", "flicker"]
FLIP_WINDOWS = 4


class ShownFrames:
    """A FlipSink that forwards everything and remembers what stood on the display since the trial began."""

    def __init__(self, sink: FlipSink) -> None:
        self._sink = sink
        self._seen: list[tuple[np.ndarray, np.ndarray]] = []

    def put(self, row: np.ndarray) -> None:
        """(N,) FLIP_DTYPE rows."""
        if (row["source"] >= 0).any():
            self._seen.append((row["refresh"].copy(), row["source"].copy()))
        self._sink.put(row)

    def begin(self) -> None:
        """Forget: a new trial begins."""
        self._seen = []

    def shown(self, trial: Trial) -> dict[str, np.ndarray]:
        """slot -> the clip's frame at each refresh of its (last) showing; lost refreshes hold the frame before."""
        found: dict[str, np.ndarray] = {}
        for place, panel in enumerate(trial.panels[:MAX_PANELS]):
            for refresh, source in self._seen:
                here = source[:, place] >= 0
                if here.any():
                    found[panel.slot] = held_frames(refresh[here], source[here, place])
        return found


def held_frames(refresh: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """(n,) frame at each refresh from the first to the last of ``refresh`` (N,), rising; gaps hold the earlier one."""
    lengths = np.diff(refresh, append=refresh[-1] + 1)
    return np.repeat(frame, lengths)


class PictureErrors:
    """slot -> metric of what was shown. ``clip(identity)`` gives a stored clip's frames; ``requests``: the study's.

    Pictures are compared as display values in [0, 1] (`renderers.metrics`): ``rmse`` over all refreshes; ``flip`` of
    the means over four refreshes (a still eye's), at most four of them; ``flicker`` over all refreshes.
    """

    def __init__(
        self, study: Study, requests: Mapping[ClipSpec, ClipRequest], clip: Callable[[str], FrameSource], metric: Metric
    ) -> None:
        self._study, self._requests, self._clip, self._metric = study, requests, clip, metric
        self._rate = Fraction(study.display.refresh_hz)
        self._squares: dict[tuple[str, str, int, int], float] = {}
        self._known: dict[tuple[str, str, bytes], float] = {}

    def reference_of(self, trial: Trial) -> str:
        """The identity of the clip that ``trial`` is judged against. Raises InputError where the study has none."""
        for panel in trial.panels:
            if panel.role == "reference":
                return self._identity(clip_spec(self._study, trial, panel))
        shown = clip_spec(self._study, trial, trial.panels[0])
        wanted = ("scene", "source", "size_px", "duration_s", "start_s", "path", "path_keys", "lighting", "loop")
        for spec in self._requests:
            if spec.technique == "reference" and all(getattr(spec, k) == getattr(shown, k) for k in wanted):
                return self._identity(spec)
        where = f"block {trial.block}, scene {trial.scene}"
        raise InputError(problem(where, "reference to judge pictures by", "none", "a condition of technique reference"))

    def _identity(self, spec: ClipSpec) -> str:
        if spec not in self._requests:
            what = f"{spec.technique} in {spec.scene}"
            raise InputError(problem(what, "pictures", "a live or unknown clip", "a clip of the store"))
        return self._requests[spec].identity

    def planned(self, trial: Trial) -> dict[str, np.ndarray]:
        """`ShownFrames.shown` of a trial whose every refresh comes in time."""
        n = round(Fraction(str(trial.settings["duration_s"])) * self._rate)
        return {
            panel.slot: np.arange(n) * Fraction(panel.rate_hz).numerator
            // int(self._rate * Fraction(panel.rate_hz).denominator)
            for panel in trial.panels
        }  # fmt: skip

    def errors(self, trial: Trial, shown: Mapping[str, np.ndarray]) -> dict[str, float]:
        """slot -> error of every panel that is judged. ``shown``: slot -> (n,) frame at each refresh."""
        gold = self.reference_of(trial)
        found = {}
        for panel in trial.panels:
            if panel.role != "reference":
                clip = self._identity(clip_spec(self._study, trial, panel))
                frames = np.asarray(shown[panel.slot], np.int64)
                key = (clip, gold, frames.tobytes())
                if key not in self._known:
                    self._known[key] = self._error(clip, gold, frames)
                found[panel.slot] = self._known[key]
        return found

    def _error(self, clip: str, gold: str, frames: np.ndarray) -> float:
        right = self._clip(gold)
        due = [min(int(k * right.rate_hz / self._rate), right.frame_count - 1) for k in range(len(frames))]
        pairs = list(zip(frames.tolist(), due, strict=True))
        if self._metric == "rmse":
            return float(np.sqrt(np.mean([self._square(clip, gold, *pair) for pair in pairs])))
        if self._metric == "flicker":
            difference = [self._values(clip, a) - self._values(gold, b) for a, b in pairs]
            return flicker(np.array(difference))
        return self._flip(clip, gold, pairs)

    def _flip(self, clip: str, gold: str, pairs: Sequence[tuple[int, int]]) -> float:
        length = min(INTEGRATED_REFRESHES, len(pairs))
        starts = list(range(0, len(pairs) - length + 1, length))
        chosen = {
            starts[i] for i in np.linspace(0, len(starts) - 1, min(FLIP_WINDOWS, len(starts))).round().astype(int)
        }
        found = []
        for start in sorted(chosen):
            window = pairs[start : start + length]
            means = [
                np.mean([self._values(one, pair[k]) for pair in window], axis=0)
                for k, one in enumerate((clip, gold))
            ]  # fmt: skip
            found.append(flip(means[0], means[1], self._study.display.pixels_per_degree))
        return float(np.mean(found))

    def _square(self, clip: str, gold: str, frame: int, due: int) -> float:
        key = (clip, gold, frame, due)
        if key not in self._squares:
            difference = self._values(clip, frame) - self._values(gold, due)
            self._squares[key] = float(np.mean(difference * difference))
        return self._squares[key]

    def _values(self, clip: str, frame: int) -> np.ndarray:
        """(H, W, 3) display values in [0, 1]."""
        return np.asarray(self._clip(clip).frame(frame)[..., :3], np.float64) / 255.0


def judged(study: Study, trials: Sequence[Trial]) -> None:
    """InputError where some trial's pictures cannot be judged after they were shown: live panels, and answers given
    while the pictures run; or where the protocol's observer does not judge by pictures."""
    if study.observer.pictures is None:
        wanted = "pictures: {metric: rmse | flip | flicker, logits_per_unit: N}"
        raise InputError(problem(f"{study.study}: observer", "pictures", "nothing", wanted))
    for trial in trials:
        if any(panel.live for panel in trial.panels):
            raise InputError(problem(f"block {trial.block}", "pictures", "a live panel", "stored clips only"))
        if trial.panels and trial.settings.get("response") == "during":
            raise InputError(
                problem(f"block {trial.block}", "response", "during", "after, for picture-driven observers")
            )
