"""The calibration procedure before a session: targets on the display, one after the other, until the tracker knows.

A lab file asks for it with the tracker's option ``calibrate``:
- ``device``: the tracker's own calibration. Host-paced (Tobii): each target is shown, and the tracker is told to take
  it in. Device-paced (Gazepoint): the server says which target is next, and it is shown until the next.
- ``map``: for trackers that have none; raw gaze at the targets gives a polynomial (`studyapp.gaze.calibration`), which
  the reader process puts on every sample from then on.
Escape ends it. What came of it is an event of the session.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from stimuli.errors import InputError, problem
from studyapp.cli import JobFailed
from studyapp.clock import now_ns
from studyapp.devices.device_reader import DeviceReader
from studyapp.gaze.angles import ScreenGeometry, separation_dva
from studyapp.gaze.calibration import fit_map
from studyapp.gaze.targets import TargetScreen
from studyapp.seams import Display

SETTLE_S, LOOK_S, STEP_S = 0.7, 0.5, 0.05
ANSWER_LIMIT_S = 20.0
"""A tracker that says nothing for so long during its calibration has failed."""
LEAST_SPREAD = 0.3
"""Raw gaze must span at least this share of the targets' extent, in its narrower direction."""
STYLES = ("device", "map")
OnTarget = Callable[[float, float], None]


class Calibrator:
    """One calibration of device ``name`` of ``reader`` on ``screen``; ``on_target`` is told where each target stands
    (a simulated observer looks there)."""

    def __init__(
        self, reader: DeviceReader, name: str, display: Display, screen: TargetScreen, geometry: ScreenGeometry,
        on_target: OnTarget | None = None,
    ) -> None:  # fmt: skip
        self._reader, self._name, self._display = reader, name, display
        self._screen, self._geometry, self._on_target = screen, geometry, on_target
        self._said: deque[dict[str, Any]] = deque()

    def run(self, style: str, points: np.ndarray) -> dict[str, Any]:
        """Calibrate at normalised (N, 2) ``points``; JSON-ready record of what came of it.

        Raises InputError for another style, JobFailed where the tracker failed or escape was pressed.
        """
        if style not in STYLES:
            raise InputError(problem(f"device {self._name}", "option calibrate", style, " | ".join(STYLES)))
        self._display.keys()
        self._reader.heard()
        self._said.clear()
        found = self._by_map(points) if style == "map" else self._by_device(points)
        return {"device": self._name, "style": style, "points": len(points), **found}

    def _by_map(self, points: np.ndarray) -> dict[str, Any]:
        """Mean raw gaze at each target -> polynomial, in normalised coordinates."""
        self._reader.set_map(self._name, None)
        gaze = self._reader.gaze(self._name)
        raw = np.full((len(points), 2), np.nan)
        for place, point in enumerate(points):
            self._look_at(point)
            self._hold(point, SETTLE_S)
            rows: list[tuple[float, float]] = []

            def take(rows: list[tuple[float, float]] = rows) -> None:
                newest = gaze.newest()
                if newest is not None and newest[3]:
                    rows.append((newest[0], newest[1]))

            self._hold(point, LOOK_S, take)
            if rows:
                # Medians: a blink's edge or a late saccade does not count.
                raw[place] = self._geometry.from_dva(*np.median(rows, axis=0))
        try:
            found = fit_map(raw, points)
        except InputError as error:
            raise JobFailed(f"gaze: calibration of {self._name} failed: {error}") from error
        seen = np.isfinite(raw).all(axis=1)
        # Eyes that stayed where they were give a map too, of their noise.
        spread, wanted = (np.linalg.svd(at[seen] - at[seen].mean(axis=0))[1].min() for at in (raw, points))
        if spread < LEAST_SPREAD * wanted:
            got = f"gaze that spans {100 * spread / wanted:.0f} % of the targets"
            raise JobFailed(
                f"gaze: calibration of {self._name} failed: got {got}, wanted {100 * LEAST_SPREAD:.0f} % at least"
            )
        self._reader.set_map(self._name, found.coefficients)
        targets, mapped = self._geometry.to_dva(*points[seen].T), self._geometry.to_dva(*found(raw[seen]).T)
        residual = float(np.sqrt(np.mean(separation_dva(*targets, *mapped) ** 2)))
        return {"seen": int(seen.sum()), "residual_deg": residual, "coefficients": found.coefficients.tolist()}

    def _by_device(self, points: np.ndarray) -> dict[str, Any]:
        """The tracker's own, at its pace or ours."""
        self._reader.calibrate(self._name, "begin", points)
        try:
            begun = self._answer(points[0])
            if begun.get("paced") == "host":
                for point in points:
                    self._look_at(point)
                    self._hold(point, SETTLE_S)
                    self._reader.calibrate(self._name, "point", point[None])
                    self._answer(point)
                self._reader.calibrate(self._name, "finish", points)
                return {"result": self._answer(points[-1])["result"]}
            at = points[0]
            while True:
                said = self._answer(at)
                if "result" in said:
                    return {"result": said["result"]}
                if "target" in said:
                    at = np.array(said["target"], float)
                    self._look_at(at)
        except JobFailed:
            # Where the reader itself is gone there is nobody to be told.
            with contextlib.suppress(OSError):
                self._reader.calibrate(self._name, "abort", points)
            raise

    def _look_at(self, point: np.ndarray) -> None:
        if self._on_target is not None:
            self._on_target(*(float(angle) for angle in self._geometry.to_dva(*point)))

    def _hold(self, point: np.ndarray, duration_s: float, each_refresh: Callable[[], None] | None = None) -> None:
        """Show the target for so long; escape ends the calibration."""
        shown_s = 0.0
        while shown_s < duration_s:
            self._screen.show(float(point[0]), float(point[1]), STEP_S, each_refresh)
            shown_s += STEP_S
            pressed = self._display.keys()
            if any(key == "escape" for key, _ in pressed):
                raise JobFailed("gaze: calibration: ended by escape; nothing was shown of the study")

    def _answer(self, at: np.ndarray) -> dict[str, Any]:
        """What the tracker says next, its target staying up meanwhile."""
        until_ns = now_ns() + int(ANSWER_LIMIT_S * 1e9)
        while now_ns() < until_ns:
            self._said.extend(said for name, said in self._reader.heard() if name == self._name)
            if self._said:
                said = self._said.popleft()
                if "failed" in said:
                    raise JobFailed(f"gaze: calibration of {self._name} failed: {said['failed']}")
                return said
            # The reader's heart may stand still while the tracker takes a target in.
            gone = [line for line in self._reader.missing() if line.startswith((f"{self._name}:", "device reader:"))]
            if gone:
                raise JobFailed(f"gaze: calibration of {self._name} failed: {gone[0]}")
            self._hold(at, STEP_S)
        raise JobFailed(f"gaze: calibration of {self._name} failed: no answer in {ANSWER_LIMIT_S:g} s")
