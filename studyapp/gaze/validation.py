"""Validation of any eye tracker: accuracy, precision and data loss in degrees of visual angle, by looking at targets.

Vendor-independent: it uses only what the session records. Definitions: Holmqvist et al., Eye tracking (2011), ch. 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from protocols.conditions import Gaze
from studyapp.clock import now_ns
from studyapp.gaze.angles import ScreenGeometry, separation_dva
from studyapp.gaze.targets import TargetScreen
from studyapp.seams import GazeSource

SETTLE_S, LOOK_S = 0.4, 0.6


@dataclass(frozen=True)
class TargetGaze:
    """Gaze at one target: its place, and the samples taken while it was looked at (x_dva, y_dva, valid)."""

    x_dva: float
    y_dva: float
    samples: np.ndarray  # (N, 3) float64


@dataclass(frozen=True)
class Validation:
    """Degrees of visual angle. ``accuracy``: mean over targets of the distance from target to mean gaze; ``worst``: the
    largest of them; ``precision_rms``: root mean square of the distance between successive samples; ``precision_sd``:
    root mean square distance from the mean; ``loss``: share of samples that are not valid; ``age_p95_ms``: age of the
    newest sample at each refresh, 95th percentile; nan where nothing was seen."""

    accuracy_deg: float
    worst_deg: float
    precision_rms_deg: float
    precision_sd_deg: float
    loss: float
    targets: int
    age_p95_ms: float

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready, nan as None."""
        return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in asdict(self).items()}

    def failures(self, limits: Gaze) -> list[str]:
        """What the protocol's limits refuse, one line each."""
        checks = [
            ("accuracy", self.accuracy_deg, limits.accuracy_deg, "degrees"),
            ("precision (RMS)", self.precision_rms_deg, limits.precision_deg, "degrees"),
            ("data loss", self.loss, limits.loss, "of the samples"),
        ]
        # nan fails: what was not seen is not good.
        return [
            f"gaze: {name}: got {value:.3g}, wanted at most {limit:g} {unit}"
            for name, value, limit, unit in checks
            if not value <= limit
        ]


def evaluate(targets: Sequence[TargetGaze], ages_ms: Sequence[float] = ()) -> Validation:
    """The measures of a set of targets that were looked at."""
    distances, successive, spread = [], [], []
    total = sum(len(target.samples) for target in targets)
    valid_count = 0
    for target in targets:
        seen = target.samples[target.samples[:, 2] > 0] if len(target.samples) else target.samples
        valid_count += len(seen)
        if not len(seen):
            distances.append(np.nan)
            continue
        x, y = seen[:, 0], seen[:, 1]
        distances.append(float(separation_dva(x.mean(), y.mean(), target.x_dva, target.y_dva)))
        successive += list(separation_dva(x[:-1], y[:-1], x[1:], y[1:]))
        spread += list(separation_dva(x, y, x.mean(), y.mean()))
    return Validation(
        accuracy_deg=float(np.mean(distances)) if distances else np.nan,
        worst_deg=float(np.max(distances)) if distances else np.nan,
        precision_rms_deg=float(np.sqrt(np.mean(np.square(successive)))) if successive else np.nan,
        precision_sd_deg=float(np.sqrt(np.mean(np.square(spread)))) if spread else np.nan,
        loss=1.0 - valid_count / total if total else 1.0,
        targets=len(targets),
        age_p95_ms=float(np.percentile(ages_ms, 95)) if len(ages_ms) else np.nan,
    )


def validate(
    screen: TargetScreen,
    gaze: GazeSource,
    geometry: ScreenGeometry,
    points: np.ndarray,
    on_target: Callable[[float, float], None] | None = None,
) -> Validation:
    """Show each of the normalised ``points``; what is seen after `SETTLE_S` counts. ``on_target`` is told where the
    next target stands (a simulated observer looks there). The newest sample is taken once a refresh."""
    looked, ages_ms = [], []
    for point in points:
        x_dva, y_dva = (float(angle) for angle in geometry.to_dva(*point))
        if on_target is not None:
            on_target(x_dva, y_dva)
        screen.show(float(point[0]), float(point[1]), SETTLE_S)
        rows: list[tuple[float, float, float]] = []
        last_ns = [0]

        def take(rows: list[tuple[float, float, float]] = rows, last_ns: list[int] = last_ns) -> None:
            newest = gaze.newest()
            if newest is None:
                return
            ages_ms.append((now_ns() - newest[2]) * 1e-6)
            if newest[2] != last_ns[0]:
                last_ns[0] = newest[2]
                rows.append((newest[0], newest[1], float(newest[3])))

        screen.show(float(point[0]), float(point[1]), LOOK_S, take)
        looked.append(TargetGaze(x_dva, y_dva, np.array(rows, float).reshape(-1, 3)))
    return evaluate(looked, ages_ms)
