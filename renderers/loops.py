"""Clips that close: a scene and a camera made periodic with the clip's duration, or the reason why they cannot be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from stimuli.clip_request import ClipRequest
from stimuli.errors import InputError, problem
from stimuli.scene import CameraPath, PoseTrack, Scene, VertexTrack

LOOP_TOLERANCE = 1e-4
"""Largest difference of a pose's entries, as a share of the largest entry, over which a loop counts as closed."""


@dataclass(frozen=True)
class LoopTrack:
    """A track that begins again every ``period_s`` after ``start_s``, before it too."""

    track: PoseTrack
    start_s: float
    period_s: float

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) seconds -> (T, 4, 4)."""
        return self.track.pose(self.start_s + np.mod(np.asarray(time_s, np.float64) - self.start_s, self.period_s))


@dataclass(frozen=True)
class LoopVertices:
    """The same for a mesh that changes its shape."""

    track: VertexTrack
    start_s: float
    period_s: float

    def vertices(self, time_s: float) -> tuple[np.ndarray, np.ndarray | None]:
        """World positions (N, 3) and unit normals at one time."""
        return self.track.vertices(self.start_s + (time_s - self.start_s) % self.period_s)


@dataclass(frozen=True)
class LoopCamera:
    """The same for a camera."""

    camera: CameraPath
    start_s: float
    period_s: float

    @property
    def yfov_rad(self) -> float:
        """The camera's own field."""
        return self.camera.yfov_rad

    @property
    def name(self) -> str:
        """The camera's own name."""
        return self.camera.name

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T,) seconds -> (T, 4, 4)."""
        return LoopTrack(self.camera, self.start_s, self.period_s).pose(time_s)


def closed_loop(scene: Scene, camera: CameraPath, request: ClipRequest) -> tuple[Scene, CameraPath]:
    """Scene and camera made periodic with the clip's duration; InputError where something does not come back."""
    frames, rate = request.frame_count, Fraction(request.rate_hz)
    start, period = float(Fraction(request.start_s)), float(frames / rate)
    tracks: list[tuple[str, PoseTrack]] = [("camera", camera)]
    tracks += [(f"mover {mover.name}", mover.track) for mover in scene.movers]
    tracks += [(f"light {light.name}", light.track) for light in scene.lights if light.track is not None]
    for name, track in tracks:
        first, last = track.pose(np.array([start, start + period]))
        if np.abs(first - last).max() > LOOP_TOLERANCE * max(1.0, float(np.abs(first).max())):
            got = f"{name} is elsewhere after {period:g} s"
            raise InputError(problem(request.scene, "closed loop", got, "a path whose period is the clip's duration"))
    for skin in scene.skins:
        first, last = (skin.track.vertices(at)[0] for at in (start, start + period))
        if np.abs(first - last).max(initial=0.0) > LOOP_TOLERANCE * max(1.0, float(np.abs(first).max(initial=0.0))):
            got = f"{scene.static[skin.part].name} has another shape after {period:g} s"
            raise InputError(problem(request.scene, "closed loop", got, "a shape whose period is the clip's duration"))
    for mover in scene.movers:
        if not (mover.visible_s[0] <= start and mover.visible_s[1] >= start + period):
            raise InputError(
                problem(request.scene, "closed loop", f"mover {mover.name} comes or goes", "none that does")
            )
    looped = replace(
        scene,
        movers=tuple(replace(mover, track=LoopTrack(mover.track, start, period)) for mover in scene.movers),
        lights=tuple(
            light if light.track is None else replace(light, track=LoopTrack(light.track, start, period))
            for light in scene.lights
        ),
        skins=tuple(replace(skin, track=LoopVertices(skin.track, start, period)) for skin in scene.skins),
    )
    return looped, LoopCamera(camera, start, period)
