"""Live mode: a technique behind the verb of a stored clip, rendered per refresh with the newest gaze.

The presenter never fetches a live frame ahead: the gaze would be a refresh old. What every frame was made from (gaze,
its age, seed) and its render time are kept, so that the frame can be rendered again, bit-exact, after the session.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import atan2, degrees, hypot, radians, tan

import numpy as np

from renderers.technique import Gaze, Technique, View, ViewGeometry
from stimuli.encode import DisplayTable, encode
from stimuli.scene import CameraPath
from studyapp.clock import now_ns
from studyapp.seams import GazeSource

LIVE_DTYPE = np.dtype(
    [
        ("frame", "<i4"),  # index since onset
        ("x_deg", "<f8"),  # gaze as the View had it, from the panel's centre; nan: none
        ("y_deg", "<f8"),
        ("gaze_ns", "<i8"),  # stamp of that sample, -1: none
        ("age_ns", "<i8"),  # its age when rendering began, -1: none
        ("render_ns", "<i8"),  # how long rendering and encoding took
        ("begun_ns", "<i8"),
    ]
)


@dataclass(frozen=True)
class PanelPlace:
    """Where a panel stands for the eye: its centre on the screen, right and up of the point that gaze is measured from,
    its height and the eye's distance (metres), and whether its picture is flipped left to right."""

    right_m: float
    up_m: float
    height_m: float
    distance_m: float
    flipped: bool = False

    def seen(self, x_dva: float, y_dva: float, geometry: ViewGeometry | None, yfov_rad: float) -> Gaze:
        """A gaze direction (azimuth and elevation, degrees, on the screen) as a technique takes it: from the picture's
        centre, through the point of the screen that is looked at. Without ``geometry`` the picture subtends the
        camera's own field, ``yfov_rad`` high."""
        right_m = self.distance_m * tan(radians(x_dva))
        up_m = tan(radians(y_dva)) * hypot(right_m, self.distance_m) - self.up_m
        right_m = (right_m - self.right_m) * (-1 if self.flipped else 1)
        # Without geometry, the eye stands where the picture's half height subtends half the camera's field.
        distance = self.height_m / 2 / tan(yfov_rad / 2) if geometry is None else geometry.distance_m
        return degrees(atan2(right_m, distance)), degrees(atan2(up_m, hypot(right_m, distance)))


@dataclass(frozen=True)
class LiveView:
    """What a live panel needs beside its technique. ``place`` None: gaze is that from the panel's centre already."""

    camera: CameraPath
    size_px: tuple[int, int]
    rate_hz: Fraction
    frame_count: int
    start_s: Fraction = Fraction(0)
    geometry: ViewGeometry | None = None
    place: PanelPlace | None = None
    exposure: float = 1.0
    tone: str = "none"
    table: DisplayTable | None = None
    warm_up_s: Fraction = Fraction(1)
    seed: int = 0


class LiveSource:
    """A FrameSource (``live = True``) that renders frame ``index`` when it is asked for.

    A frame asked for again without another in between is not rendered again. `begin` resets the technique and renders
    the warm-up: call it before each trial, outside the frame loop.
    """

    live = True

    def __init__(
        self, technique: Technique, view: LiveView, gaze: GazeSource | None = None, clock_ns: Callable[[], int] = now_ns
    ) -> None:
        self.size_px, self.rate_hz, self.frame_count = view.size_px, view.rate_hz, view.frame_count
        self._technique, self._view, self._gaze, self._clock_ns = technique, view, gaze, clock_ns
        self._codes = np.empty((view.size_px[1], view.size_px[0], 4), np.uint8)
        self._warm_frames = max(1, round(view.warm_up_s * view.rate_hz))
        self._newest = -1
        self._last: tuple[Gaze, int] | None = None
        self._log = np.zeros(view.frame_count * 2, LIVE_DTYPE)
        self._logged = 0

    def begin(self) -> None:
        """Forget history and log, and bring the technique to its steady state at the clip's start."""
        self._technique.reset(self._view.seed)
        self._newest, self._logged, self._last = -1, 0, None
        warm = self._warm_frames
        for index in range(-warm, 0):
            self._encode(self._technique.render(self._view_at(index, None, cut=index == -warm)).color)

    def frame(self, index: int) -> np.ndarray:
        """(H, W, 4) uint8 codes, rendered now with the newest gaze; valid until the next call."""
        if index == self._newest:
            return self._codes
        gaze, stamp = self._newest_gaze()
        begun = self._clock_ns()
        self._encode(self._technique.render(self._view_at(index, gaze, cut=False)).color)
        self._newest = index
        if self._logged < len(self._log):
            x, y = gaze if gaze is not None else (np.nan, np.nan)
            age = begun - stamp if stamp >= 0 else -1
            self._log[self._logged] = (index, x, y, stamp, age, self._clock_ns() - begun, begun)
            self._logged += 1
        return self._codes

    def log(self) -> np.ndarray:
        """(N,) LIVE_DTYPE: every frame rendered since `begin`."""
        return self._log[: self._logged].copy()

    def provenance(self) -> Mapping[str, object]:
        """What the session stores beside the log to render the frames again."""
        return {
            "technique": type(self._technique).name,
            "seed": self._view.seed,
            "start_s": str(self._view.start_s),
            "rate_hz": str(self.rate_hz),
            "warm_up_s": str(self._view.warm_up_s),
            "exposure": self._view.exposure,
            "tone": self._view.tone,
        }

    def _view_at(self, index: int, gaze: Gaze | None, cut: bool) -> View:
        view = self._view
        t1 = view.start_s + index / view.rate_hz
        # A technique's index counts from the warm-up's start, as for stored clips.
        return View(
            index + self._warm_frames,
            t1 - 1 / view.rate_hz,
            t1,
            view.size_px,
            view.camera,
            gaze,
            view.geometry,
            view.exposure,
            view.tone,
            cut,
        )

    def _encode(self, linear: np.ndarray) -> None:
        encode(linear, self._view.exposure, self._view.tone, self._view.table, self._codes)

    def _newest_gaze(self) -> tuple[Gaze | None, int]:
        """The newest valid sample, seen from the panel's centre; through a blink the last one holds."""
        if self._gaze is None:
            return None, -1
        sample = self._gaze.newest()
        if sample is not None and sample[3]:
            self._last = (self._from_panel(sample[0], sample[1]), sample[2])
        return self._last if self._last is not None else (None, -1)

    def _from_panel(self, x_deg: float, y_deg: float) -> Gaze:
        """Direction from the screen's centre -> direction from the panel's centre, through points on the screen."""
        view = self._view
        if view.place is None:
            return x_deg, y_deg
        return view.place.seen(x_deg, y_deg, view.geometry, view.camera.yfov_rad)
