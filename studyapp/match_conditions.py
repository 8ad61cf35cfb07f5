"""Solving the knobs of a protocol's ``match`` by measurement: renderings of its scenes, at a small size where that says
the same."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocols.match import Knob, Match, Matched
from protocols.match_lock import MatchLock, SolvedKnob, asked_sha256
from protocols.study import Study
from renderers.technique import ViewGeometry
from stimuli.errors import InputError, problem
from studyapp.commands.check import find_scene

if TYPE_CHECKING:  # the ray engine is loaded when something is measured
    from renderers.engine import Engine
    from renderers.tradeoff import Conditions, Gold
    from stimuli.scene import CameraPath

COLUMN = {
    "rays_per_s": "rays_per_s", "samples_per_s": "primary_per_s", "ms_on_machine": "ms_per_content_frame",
    "rmse": "rmse", "psnr": "psnr_db", "flip": "flip_still", "flicker": "flicker",
}  # fmt: skip
"""Measure of a match -> column of `renderers.tradeoff.measure_setting`."""
PER_AREA = ("rays_per_s", "samples_per_s")
MAX_STEPS = 14
SMALL_PX = 128
Value = float | int | str | bool


def turned(
    low: float, high: float, whole: bool, measure: Callable[[float], float], target: float, tolerance: float
) -> tuple[float, float]:
    """(value, what it measures): the value in [low, high] at which ``measure`` meets ``target``, by bisection (on the
    logarithm where low > 0), for a measure that rises or falls throughout. Where neither end lies beyond the target, or
    no value meets it, the nearest that was measured."""
    by_ratio = low > 0

    def place(share: float) -> float:
        value = low * (high / low) ** share if by_ratio else low + (high - low) * share
        return float(round(value)) if whole else value

    tried: dict[float, float] = {}

    def at(share: float) -> float:
        value = place(share)
        if value not in tried:
            tried[value] = measure(value)
        return tried[value]

    def nearest() -> tuple[float, float]:
        return min(tried.items(), key=lambda pair: abs(pair[1] - target))

    first, last = at(0.0), at(1.0)
    if (first - target) * (last - target) > 0:
        return nearest()
    a, b, rises = 0.0, 1.0, last > first
    for _ in range(MAX_STEPS):
        if abs(nearest()[1] - target) <= tolerance * abs(target) / 4:
            break
        middle = (a + b) / 2
        if place(middle) in (place(a), place(b)):
            break
        if (at(middle) < target) == rises:
            a = middle
        else:
            b = middle
    return nearest()


def picked(values: Sequence[Value], measure: Callable[[Value], float], target: float) -> tuple[Value, float]:
    """(value, what it measures): the one of ``values`` whose measure is nearest the target."""
    measured = [(value, measure(value)) for value in values]
    return min(measured, key=lambda pair: abs(pair[1] - target))


@dataclass
class Bench:
    """The scenes of a study, ready to be measured at ``size_px`` over ``frames`` refreshes. ``area``: how many times
    the protocol's own panel is larger; budgets in samples a second are divided by it."""

    study: Study
    size_px: tuple[int, int]
    frames: int
    area: float
    rigs: list[tuple[Engine, CameraPath, Gold, Conditions]]
    known: dict[str, dict[str, Any]] = field(default_factory=dict)
    progress: Callable[[str], None] = lambda said: None

    def measure(self, condition: str, params: Mapping[str, Any], measure: str) -> float:
        """What ``condition`` with ``params`` has of a match's measure at the protocol's own size: the mean over scenes.

        Raises InputError for techniques from outside the tree.
        """
        from renderers.tradeoff import Setting, measure_setting

        stated = self.study.all_conditions()[condition]
        if stated.external:
            raise InputError(problem(f"match: {condition}", "technique", stated.technique, "one of the catalogue"))
        base = self.study.base_settings(None).get("rate_hz")
        rate = Fraction(stated.rate_hz or base or self.study.display.refresh_hz)
        small = dict(params)
        if small.get("samples_per_s") is not None:
            small["samples_per_s"] = float(small["samples_per_s"]) / self.area
        total = 0.0
        for place, (engine, camera, gold, conditions) in enumerate(self.rigs):
            setting = Setting(stated.technique, small, rate)
            key = f"{place} {setting.label}"
            if key not in self.known:
                self.progress(f"{condition} in {engine.scene.name}: {setting.label}")
                self.known[key] = measure_setting(engine, camera, setting, gold, conditions)
            total += float(self.known[key][COLUMN[measure]])
        return total / len(self.rigs) * (self.area if measure in PER_AREA else 1.0)


def bench_of(study: Study, protocol_folder: Path, size_px: tuple[int, int] | None, frames: int, spp: int) -> Bench:
    """Load the scenes and render their gold standards. ``size_px`` None: the protocol's panel, made at most 128 px wide
    unless milliseconds are matched. Raises InputError where a scene is nowhere, or milliseconds are asked of another
    size than the protocol's."""
    from renderers.clip_renderer import keyed_camera
    from renderers.engine import Engine
    from renderers.tradeoff import Conditions, gold_standard
    from stimuli.camera_path import camera_path
    from stimuli.load import load_scene

    settings = study.base_settings(None)
    own = (int(settings["size_px"][0]), int(settings["size_px"][1]))
    timed = any(match.cost == "ms_on_machine" for match in study.match)
    size = size_px or (own if timed else small_size(own))
    if timed and size != own:
        got, wanted = f"{size[0]}x{size[1]}", f"{own[0]}x{own[1]}, since ms_on_machine is matched"
        raise InputError(problem("--size", "picture size", got, wanted))
    geometry = None
    if study.display.geometry == "screen":
        geometry = ViewGeometry(*study.display.panel_m(own), study.display.distance_m)
    rigs = []
    for name in study.scenes:
        stated, here = study.scenes[name], study.base_settings(name)
        found = find_scene(stated.scene, protocol_folder) or stated.instead
        if found is None:
            raise InputError(problem(f"scene {name}", "source", repr(stated.scene), "a scene that is there"))
        scene = load_scene(str(found), animation=here.get("animation"))
        path = str(here["path"])
        conditions = Conditions(
            size_px=size, rate_hz=Fraction(study.display.refresh_hz), frames=frames, warm_up_frames=frames,
            start_s=Fraction(str(here["start_s"])) + 1, seed=study.seed % 2**32, reference_spp=spp,
            lighting=str(here["lighting"]), geometry=geometry,
        )  # fmt: skip
        engine = Engine(scene, lighting=conditions.lighting)  # type: ignore[arg-type]
        keys = study.paths.get(path)
        camera = camera_path(scene, path) if keys is None else keyed_camera(scene, keys.as_json())
        rigs.append((engine, camera, gold_standard(engine, camera, conditions, lambda n: None), conditions))
    return Bench(study, size, frames, own[0] * own[1] / (size[0] * size[1]), rigs)


def small_size(own: tuple[int, int]) -> tuple[int, int]:
    """``own`` at most `SMALL_PX` wide or high, of the same shape, even numbers."""
    factor = min(1.0, SMALL_PX / max(own))
    return (max(2, round(own[0] * factor / 2) * 2), max(2, round(own[1] * factor / 2) * 2))


def solve(study: Study, bench: Bench) -> MatchLock:
    """Turn every knob of every match in their order; measure what mismatch remains."""
    params = {name: dict(condition.params) for name, condition in study.all_conditions().items()}
    knobs: list[SolvedKnob] = []
    found: list[list[Matched]] = []
    for match in study.match:
        measure = str(match.cost or match.quality)
        target = match.target if match.to is None else bench.measure(match.to, params[match.to], measure)
        assert target is not None
        for knob in match.knobs:
            value = _solved(bench, match, knob, params[knob.condition], measure, float(target))
            params[knob.condition][knob.parameter] = value
            knobs.append(SolvedKnob(condition=knob.condition, parameter=knob.parameter, value=value))
        rows = []
        for name in match.conditions:
            value_now = bench.measure(name, params[name], measure)
            off = value_now / target - 1 if target else math.copysign(math.inf, value_now)
            rows.append(
                Matched(condition=name, value=value_now, target=float(target), mismatch=off,
                        matched=abs(off) <= match.tolerance)
            )  # fmt: skip
        found.append(rows)
    return MatchLock(
        study=study.study, asked_sha256=asked_sha256(study), machine=f"{platform.machine()}, {os.cpu_count()} cores",
        size_px=list(bench.size_px), frames=bench.frames, scenes=list(study.scenes), knobs=knobs, found=found,
    )  # fmt: skip


def _solved(bench: Bench, match: Match, knob: Knob, params: Mapping[str, Any], measure: str, target: float) -> Value:
    def at(value: Value) -> float:
        return bench.measure(knob.condition, {**params, knob.parameter: value}, measure)

    if knob.values is not None:
        return picked(knob.values, at, target)[0]
    assert knob.low is not None
    assert knob.high is not None

    def at_number(value: float) -> float:
        return at(int(value) if knob.whole else value)

    value, _ = turned(knob.low, knob.high, knob.whole, at_number, target, match.tolerance)
    return int(value) if knob.whole else value


def told(lock: MatchLock, study: Study) -> list[str]:
    """The lock in lines for a terminal."""
    lines = [f"{knob.condition}: {knob.parameter} = {_short(knob.value)}" for knob in lock.knobs]
    for match, rows in zip(study.match, lock.found, strict=True):
        lines.append(f"{match.cost or match.quality} (tolerance {match.tolerance:.0%}):")
        for row in rows:
            said = "" if row.matched else "   NOT MATCHED"
            lines.append(f"  {row.condition:<24} {row.value:>14.6g}  {row.mismatch:>+8.2%} of {row.target:.6g}{said}")
    return lines


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
