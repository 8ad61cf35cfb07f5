"""Observers who judge by the pictures find planted faults: shuffled pixels, missed refreshes, a wrong exposure.

A small study is rendered; `studyapp.picture_errors` gives a metric table from its play cache, `protocols.observer` the
answers of 15 participants. A fault is planted in one technique only. Asked: its win share falls by at least 10 points
(p < 0.01, paired over participants); with a null fault (one code value in a thousandth of the pixels) it does not.
``python -m tests.prove.picture_driven_observer`` writes evidence/picture_driven_observer.json.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from analysis import wilcoxon
from protocols.design import plan
from protocols.load import load_study
from protocols.observer import answer, draw_observer, trial_stream
from protocols.study import Study
from stimuli.clip import ClipStore
from stimuli.play_cache import PlayCache
from studyapp.cli import main
from studyapp.clips import resolve_clips
from studyapp.picture_errors import PictureErrors
from studyapp.seams import FrameSource
from studyapp.store_root import store_directory
from tests.evidence import write_evidence

PROTOCOL = """\
study: pictures
title: Observers who judge by the pictures
seed: 11
display: {refresh_hz: 240, size_px: [640, 240]}
defaults: {size_px: [64, 48], duration_s: 0.25, warm_up_s: 0.05}
scenes:
  tunnel: {scene: tunnel_geom, start_s: 1, path: turn, exposure: 1.0}
paths:
  # Turning by 48 degrees a second: a picture that comes late is at another place.
  turn:
    - {time_s: 0.75, position: [0.25, 0.2, 0], look_at: [-0.986, 0.200, -3.804]}
    - {time_s: 0.875, position: [0.25, 0.2, 0], look_at: [-0.582, 0.200, -3.913]}
    - {time_s: 1, position: [0.25, 0.2, 0], look_at: [-0.168, 0.200, -3.978]}
    - {time_s: 1.125, position: [0.25, 0.2, 0], look_at: [0.250, 0.200, -4.000]}
    - {time_s: 1.25, position: [0.25, 0.2, 0], look_at: [0.668, 0.200, -3.978]}
    - {time_s: 1.375, position: [0.25, 0.2, 0], look_at: [1.082, 0.200, -3.913]}
    - {time_s: 1.5, position: [0.25, 0.2, 0], look_at: [1.486, 0.200, -3.804]}
conditions:
  gold: {technique: reference, params: {spp: 9}}
  dense: {technique: temporally_dense}
  checkerboard: checkerboard
  half: {technique: vanilla, rate_hz: 120}
questions:
  closer: {kind: choice, text: Which is closer to the middle?}
blocks:
  - name: closest
    kind: side_by_side
    reference: gold
    compare: {of: [dense, checkerboard, half]}
    factors: {scene: [tunnel]}
    repetitions: 8
    questions: [closer]
participants: {target: 15}
observer:
  source: ours, as large as makes the three techniques alike but for their pictures
  sd: {condition: 0.3}
  pictures: {metric: METRIC, logits_per_unit: PER_UNIT}
"""
PER_UNIT = {"rmse": 400, "flip": 150}
FAULTY = "dense"
Frames = Callable[[np.ndarray], np.ndarray]


class Changed:
    """A FrameSource whose every frame goes through ``change``."""

    def __init__(self, source: FrameSource, change: Frames) -> None:
        self.size_px, self.rate_hz, self.frame_count = source.size_px, source.rate_hz, source.frame_count
        self._source, self._change = source, change

    def frame(self, index: int) -> np.ndarray:
        """The source's frame, changed."""
        return self._change(np.array(self._source.frame(index)))


def shuffled(codes: np.ndarray) -> np.ndarray:
    """The four pixels of every 2x2 block in another order, as a wrong order table would put them."""
    out = codes.copy()
    out[::2, ::2], out[::2, 1::2] = codes[1::2, 1::2], codes[::2, ::2]
    out[1::2, ::2], out[1::2, 1::2] = codes[::2, 1::2], codes[1::2, ::2]
    return out


def brighter(codes: np.ndarray) -> np.ndarray:
    """Exposure + 10 %: linear light times 1.1, encoded again."""
    value = codes[..., :3] / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4) * 1.1
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    out = codes.copy()
    out[..., :3] = np.round(255 * np.clip(encoded, 0, 1))
    return out


def harmless(codes: np.ndarray) -> np.ndarray:
    """One code value more in every thousandth pixel: nothing that anyone could see."""
    flat = codes.reshape(-1, 4).copy()
    flat[::1000, :3] = np.minimum(flat[::1000, :3], 254) + 1
    return flat.reshape(codes.shape)


def missed(frames: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """``share`` of the refreshes are lost: the frame before stays, all that follow come later (policy hold)."""
    lost = rng.random(len(frames)) < share
    lost[0] = False
    return frames[np.arange(len(frames)) - np.cumsum(lost)]


def rendered(folder: Path, metric: str, size: str = "[64, 48]") -> Path:
    """The protocol with its clips in ``folder``/.clips (rendered where they are not there yet)."""
    protocol = folder / "pictures.yaml"
    protocol.write_text(
        PROTOCOL.replace("[64, 48]", size).replace("METRIC", metric).replace("PER_UNIT", str(PER_UNIT[metric]))
    )
    with redirect_stdout(sys.stderr):
        if main(["render", str(protocol)]):
            raise RuntimeError("the clips were not rendered")
    return protocol


def win_shares(study: Study, table: PictureErrors, lost: float, participants: int, seed: int) -> np.ndarray:
    """(participants,) share of its trials that `FAULTY` wins. ``lost``: share of its refreshes that are missed."""
    shares = []
    for number in range(1, participants + 1):
        observer = draw_observer(study, number, seed)
        wins, count = 0, 0
        for trial in plan(study, number):
            slot = next((panel.slot for panel in trial.panels if panel.condition == FAULTY), None)
            if slot is None:
                continue
            shown = table.planned(trial)
            if lost:
                rng = np.random.default_rng([seed, number, trial.index])
                shown = {**shown, slot: missed(shown[slot], lost, rng)}
            rng = trial_stream(seed, number, trial)
            (given,) = answer(trial, observer, rng, table.errors(trial, shown))
            wins, count = wins + (given.chosen == FAULTY), count + 1
        shares.append(wins / count)
    return np.array(shares)


def tables(protocol: Path) -> tuple[Study, Mapping[str, PictureErrors]]:
    """The study, and the metric's table for each fault in the pictures ('' none)."""
    study, store = load_study(protocol), ClipStore(store_directory(protocol))
    clips, cache = resolve_clips(study, protocol, store), PlayCache(store)
    faulty = {request.identity for spec, request in clips.requests.items() if spec.technique == "temporally_dense"}
    assert study.observer.pictures is not None
    metric = study.observer.pictures.metric
    played: dict[str, FrameSource] = {}

    def table(change: Frames | None) -> PictureErrors:
        def clip(identity: str) -> FrameSource:
            source = played.setdefault(identity, cache.played(store.open(identity)))
            changed: FrameSource = source
            if change is not None and identity in faulty:
                changed = Changed(source, change)
            return changed

        return PictureErrors(study, clips.requests, clip, metric)

    changes = {"": None, "shuffled pixels": shuffled, "exposure + 10 %": brighter, "null": harmless}
    return study, {name: table(change) for name, change in changes.items()}


def prove(
    folder: Path, metrics: tuple[str, ...] = ("rmse", "flip"), participants: int = 15, size: str = "[64, 48]"
) -> dict[str, Any]:
    """The evidence: for each metric and fault, win share with and without it, and p."""
    out: dict[str, Any] = {"participants": participants, "faults": []}
    for metric in metrics:
        study, by_fault = tables(rendered(folder, metric, size))
        whole = win_shares(study, by_fault[""], 0.0, participants, 1)
        asked = [(name, table, 0.0) for name, table in by_fault.items() if name]
        asked.append(("5 % missed refreshes", by_fault[""], 0.05))
        rows = {}
        for name, table, lost in asked:
            after = win_shares(study, table, lost, participants, 1)
            drop, p = float(np.mean(whole - after)), float(wilcoxon(whole, after)["p"].iloc[0])
            # No participant answered otherwise: there is nothing to test, and no difference.
            p = p if np.isfinite(p) else 1.0
            rows[name] = {"before": float(whole.mean()), "after": float(after.mean()), "points": 100 * drop, "p": p}
            found = drop >= 0.10 and p < 0.01
            if found != (name != "null"):
                out["faults"].append(f"{metric}, {name}: {100 * drop:.1f} points, p = {p:.4f}")
        out[metric] = rows
    return out


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        evidence = prove(Path(made))
    write_evidence("picture_driven_observer", evidence)
    print(json.dumps(evidence, indent=1))
    sys.exit(1 if evidence["faults"] else 0)
