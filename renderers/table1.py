"""Table 1 and Fig. 8 of Dayal et al. 2005 anew: five methods at equal samples a second on the BART kitchen.

Error is the RMS difference of display values (x 255) to the gold standard at the same refresh, without delay; framed
methods are one of their own frames late (double buffering). The paper's unit is not known, so both are compared as
ratios to full resolution at 60 Hz. The paper's 'Interactive' recording is not public: ours is a seeded synthetic path.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from renderers.catalogue import TECHNIQUES
from renderers.clip_frames import technique_params, view_at
from renderers.engine import Engine
from renderers.text_table import aligned
from stimuli.camera_path import camera_path_sha256
from stimuli.encode import display_values
from stimuli.scene import CameraPath

ANIMATIONS = {"interactive": "interactive", "bart": "file", "toycar": "toycar"}
"""The paper's animations -> names of camera paths; 'interactive' is synthetic."""
METHODS = ("framed_low_resolution", "framed_low_rate", "traditional_frameless", "adaptive_frameless")
FULL = "full resolution, 60 Hz"
PAPER: Mapping[str, Mapping[str, Mapping[int, float]]] = {
    "interactive": {
        "framed_low_resolution": {100_000: 92.7, 400_000: 71.8, 800_000: 60.9},
        "framed_low_rate": {100_000: 110.0, 400_000: 72.6, 800_000: 60.4},
        "traditional_frameless": {100_000: 80.8, 400_000: 48.8, 800_000: 39.3},
        "adaptive_frameless": {100_000: 34.4, 400_000: 24.1, 800_000: 23.6},
        FULL: {0: 28.0},
    },
    "bart": {
        "framed_low_resolution": {400_000: 112.0, 800_000: 100.0},
        "framed_low_rate": {400_000: 127.0, 800_000: 112.0},
        "traditional_frameless": {400_000: 92.3, 800_000: 74.8},
        "adaptive_frameless": {400_000: 50.1, 800_000: 51.9},
        FULL: {0: 30.7},
    },
    "toycar": {
        "framed_low_resolution": {400_000: 47.0, 800_000: 42.8},
        "framed_low_rate": {400_000: 43.8, 800_000: 38.9},
        "traditional_frameless": {400_000: 35.3, 800_000: 32.5},
        "adaptive_frameless": {400_000: 20.4, 800_000: 18.5},
        FULL: {0: 29.4},
    },
}
"""RMS errors of the paper's Table 1, by animation, method and samples a second (0: does not apply)."""
TARGETS = {
    ("interactive", 400_000): 1.0,
    ("toycar", 400_000): 1.0,
    ("bart", 400_000): 1.6,
    ("interactive", 100_000): 1.25,
}
"""What `adaptive_frameless` is to reach: error over that of full resolution at 60 Hz, at most."""


@dataclass(frozen=True)
class Conditions:
    """``compared`` refreshes, evenly spread over ``duration_s`` after ``warm_up_s``; every refresh is rendered."""

    size_px: tuple[int, int] = (256, 256)
    rate_hz: Fraction = Fraction(60)
    start_s: Fraction = Fraction(0)
    duration_s: Fraction = Fraction(20)
    warm_up_s: Fraction = Fraction(1)
    compared: int = 100
    reference_spp: int = 64
    seed: int = 0

    @property
    def refreshes(self) -> tuple[int, ...]:
        """Numbers of the compared refreshes."""
        first, last = math.ceil(self.warm_up_s * self.rate_hz), math.floor(self.duration_s * self.rate_hz) - 1
        return tuple(sorted({round(float(k)) for k in np.linspace(min(first, last), last, self.compared)}))


@dataclass(frozen=True)
class Method:
    """One line of the table: a technique with its parameters; ``samples_per_s`` 0 is full resolution every refresh."""

    label: str
    technique: str
    samples_per_s: int
    params: Mapping[str, Any]


def methods(budgets: Iterable[float]) -> list[Method]:
    """All lines: four methods at each budget, and full resolution; framed ones are a frame late."""
    found = [Method(FULL, "vanilla", 0, {"delay_frames": 1})]
    for budget in budgets:
        for name in METHODS:
            late = {"delay_frames": 1} if name.startswith("framed") else {}
            found.append(Method(name, name, round(budget), {"samples_per_s": float(budget), **late}))
    return found


def gold_standard(
    engine: Engine, camera: CameraPath, c: Conditions, progress: Callable[[int], object]
) -> dict[int, np.ndarray]:
    """Display values of the ideal renderer at the compared refreshes, as 16-bit fixed point (H, W, 3)."""
    params = technique_params("reference", {"spp": c.reference_spp})
    ideal = TECHNIQUES["reference"](engine, c.size_px, params, c.seed, "total")
    gold = {}
    for k in c.refreshes:
        view = view_at(k, c.rate_hz, c.start_s, c.size_px, camera, exposure=1.0, cut=k == 0)
        gold[k] = np.round(display_values(ideal.render(view).color, 1.0) * 65535).astype(np.uint16)
        progress(1)
    return gold


def measure(
    engine: Engine, camera: CameraPath, method: Method, gold: Mapping[int, np.ndarray], c: Conditions,
    progress: Callable[[int], object],
) -> dict[str, Any]:  # fmt: skip
    """Errors of one line at each compared refresh, its primary rays a second, and its cost."""
    params = technique_params(method.technique, method.params)
    made = TECHNIQUES[method.technique](engine, c.size_px, params, c.seed, "total")
    stateless = method.technique in ("vanilla", "framed_low_resolution")
    errors: list[float] = []
    primary, seconds, rendered = 0, 0.0, 0
    for k in c.refreshes if stateless else range(c.refreshes[-1] + 1):
        view = view_at(k, c.rate_hz, c.start_s, c.size_px, camera, exposure=1.0, cut=k == 0)
        frame = made.render(view)
        if k > 0:
            primary, seconds, rendered = primary + frame.rays["primary"], seconds + frame.seconds["total"], rendered + 1
        if k in gold:
            difference = display_values(frame.color, 1.0) - gold[k] / 65535.0
            errors.append(float(np.sqrt(np.mean(difference**2))) * 255)
            progress(1)
    return {
        "label": method.label,
        "samples_per_s": method.samples_per_s,
        "rms": float(np.sqrt(np.mean(np.square(errors)))),
        "errors": errors,
        "primary_per_s": primary / max(rendered, 1) * float(c.rate_hz),
        "ms_per_refresh": seconds / max(rendered, 1) * 1e3,
    }


def key(scene_sha256: str, animation: str, method: Method, c: Conditions, version: int) -> str:
    """The identity of a line's measurement."""
    path = camera_path_sha256(ANIMATIONS[animation])
    told = [scene_sha256, animation, path, method.technique, dict(method.params), repr(c), version]
    told.append(technique_params(method.technique, method.params).model_dump())
    return hashlib.sha256(json.dumps(told, sort_keys=True, default=str).encode()).hexdigest()


def with_ratios(animation: str, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows with ``ratio`` to full resolution at 60 Hz, the paper's number and ratio (None where it has none), the
    target, and whether the line is ahead of all others of its budget."""
    full = next(row["rms"] for row in rows if row["label"] == FULL)
    paper = PAPER[animation]
    out = []
    for row in rows:
        told = paper[row["label"]].get(row["samples_per_s"])
        equal = [other["rms"] for other in rows if other["samples_per_s"] == row["samples_per_s"]]
        adaptive = row["label"] == "adaptive_frameless"
        out.append(
            {
                **row,
                "animation": animation,
                "ratio": row["rms"] / full,
                "paper": told,
                "paper_ratio": None if told is None else told / paper[FULL][0],
                "target": TARGETS.get((animation, row["samples_per_s"])) if adaptive else None,
                "first": row["rms"] <= min(equal),
            }
        )
    return out


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Aligned text; a star marks the least error of those with equal samples a second."""
    titles = ("animation", "method", "samples/s", "RMS", "ratio", "paper", "ratio", "target", "ms")
    lines: list[tuple[str, ...]] = [titles]
    for row in rows:
        name = f"{row['animation']}{' (synthetic)' if row['animation'] == 'interactive' else ''}"
        lines.append(
            (
                name,
                ("* " if row["first"] and row["samples_per_s"] else "  ") + row["label"],
                f"{row['samples_per_s'] or row['primary_per_s']:,.0f}",
                f"{row['rms']:.2f}",
                f"{row['ratio']:.2f}",
                "-" if row["paper"] is None else f"{row['paper']:.1f}",
                "-" if row["paper_ratio"] is None else f"{row['paper_ratio']:.2f}",
                ""
                if row["target"] is None
                else f"{row['target']:.2f} {'met' if row['ratio'] <= row['target'] else 'missed'}",
                f"{row['ms_per_refresh']:.1f}",
            )
        )
    return aligned(lines, 2)


def write_curves(rows: Sequence[Mapping[str, Any]], c: Conditions, path: Path) -> None:
    """Fig. 8 as CSV: a line for each method, budget and compared refresh, errors x 255."""
    with path.open("w", newline="") as file:
        lines = csv.writer(file)
        lines.writerow(("animation", "method", "samples_per_s", "refresh", "time_s", "rms"))
        for row in rows:
            for k, error in zip(c.refreshes, row["errors"], strict=True):
                line = (row["animation"], row["label"], row["samples_per_s"], k, float(k / c.rate_hz), error)
                lines.writerow(line)


def plot(rows: Sequence[Mapping[str, Any]], c: Conditions, path: Path) -> None:
    """Fig. 8: error of each compared refresh over time, a panel an animation and budget."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    animations = list(dict.fromkeys(row["animation"] for row in rows))
    budgets = sorted({row["samples_per_s"] for row in rows} - {0})
    figure = Figure(figsize=(5.2 * len(budgets), 3.2 * len(animations)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(animations), max(1, len(budgets)), squeeze=False, sharex=True)
    times = [k / float(c.rate_hz) for k in c.refreshes]
    for i, animation in enumerate(animations):
        for j, budget in enumerate(budgets):
            for row in rows:
                if row["animation"] == animation and row["samples_per_s"] in (0, budget):
                    axes[i][j].plot(times, row["errors"], lw=1, label=row["label"])
            axes[i][j].set_title(f"{animation}, {budget / 1000:g}k samples/s", fontsize=9)
            axes[i][j].set_ylabel("RMS x 255")
    lines, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside upper center", ncols=3 if len(budgets) > 1 else 2, fontsize=8)
    figure.supxlabel("s")
    figure.savefig(path, dpi=110)
