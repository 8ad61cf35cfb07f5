"""Foveated ray tracing of a headset: every viewport of a view has its own history, all share gaze, pose and seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from renderers.stereo import EyeCamera
from renderers.technique import Frame, LazyCounts, View, Viewport
from stimuli.errors import InputError, problem

if TYPE_CHECKING:
    from renderers.foveated.technique import Foveated


class Eyes:
    """One technique a viewport, made by ``make`` for a picture's size when it is first seen."""

    def __init__(self, make: Callable[[tuple[int, int]], Foveated]) -> None:
        self._make = make
        self._by_viewport: dict[Viewport, Foveated] = {}

    def _of(self, view: View) -> list[tuple[Viewport, Foveated, View]]:
        if view.geometry is not None:
            raise InputError(problem("viewports", "view geometry", "a flat screen", "None: viewports are a headset's"))
        if len({v.name for v in view.viewports}) < len(view.viewports):
            raise InputError(problem("viewports", "names", [v.name for v in view.viewports], "a different one each"))
        found = []
        for v in view.viewports:
            if v.centred_on_gaze:
                wanted = "one that rests in the eye's picture (of insets that follow the gaze: polar)"
                raise InputError(problem(f"viewport {v.name}", "centred_on_gaze", True, wanted))
            if v not in self._by_viewport:
                self._by_viewport[v] = self._make(v.size_px)
            camera = EyeCamera(view.camera, v.yfov_rad, v.eye_offset_m, v.name)
            own = replace(view, size_px=v.size_px, camera=camera, viewports=())
            found.append((v, self._by_viewport[v], own))
        return found

    def render(self, view: View) -> Frame:
        """All viewports; ``color`` is the first's, rays and seconds are sums."""
        frames = {v.name: technique.render(own) for v, technique, own in self._of(view)}
        first = next(iter(frames.values()))

        def total(kind: str) -> Callable[[], int]:
            return lambda: sum(frame.rays[kind] for frame in frames.values())

        kinds = {kind for frame in frames.values() for kind in frame.rays}
        stages = dict.fromkeys(name for frame in frames.values() for name in frame.seconds)
        return Frame(
            color=first.color,
            rays=LazyCounts({kind: total(kind) for kind in sorted(kinds)}),
            seconds={name: sum(frame.seconds.get(name, 0.0) for frame in frames.values()) for name in stages},
            time_s=first.time_s,
            clamped=sum(frame.clamped for frame in frames.values()),
            viewports={name: frame.color for name, frame in frames.items()},
        )

    def show(self, view: View) -> dict[str, np.ndarray]:
        """Debug pictures of every viewport: NAME.PICTURE."""
        found: dict[str, Any] = {}
        for v, technique, own in self._of(view):
            found |= {f"{v.name}.{name}": picture for name, picture in technique.show(own).items()}
        return found

    def close(self) -> None:
        """Free the OpenGL contexts."""
        for technique in self._by_viewport.values():
            technique.close()
        self._by_viewport.clear()
