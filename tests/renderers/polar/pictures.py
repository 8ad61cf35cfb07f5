"""Pictures that are functions of direction, sent through a polar buffer without any scene."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np

from renderers.backend import dr, mi
from renderers.clip_frames import view_at
from renderers.frozen import opaque_float
from renderers.polar.panels import Eye, Panel, eyes_of
from renderers.polar.polar_map import RadialMap, buffer_size, direction, farthest_deg, gaze_basis
from renderers.polar.resolve import look_up, panel_state, polar_state, resolve
from renderers.technique import View
from stimuli.scene import StillCamera

RATE = Fraction(240)


def still_view(
    size_px: tuple[int, int], yfov_deg: float = 60.0, gaze: tuple[float, float] | None = None, **more
) -> View:
    """A view from the origin down -z."""
    return view_at(0, RATE, Fraction(0), size_px, StillCamera(np.eye(4), np.radians(yfov_deg)), gaze, **more)


def pixel_directions(panel: Panel) -> np.ndarray:
    """(H, W, 3) float64 unit eye directions of the pixels' centres."""
    width, height = panel.size_px
    x, y = np.arange(width)[None, :, None] + 0.5, np.arange(height)[:, None, None] + 0.5
    points = np.asarray(panel.plane.corner) + x * np.asarray(panel.plane.step_x) + y * np.asarray(panel.plane.step_y)
    return points / np.linalg.norm(points, axis=2, keepdims=True)


def map_of(eye: Eye, kind: str = "acuity") -> RadialMap:
    """The map to the farthest corner of the eye's panels."""
    gaze = np.asarray(eye.panels[0].plane.gaze)
    return RadialMap(kind, max(farthest_deg(p.plane, p.size_px, gaze) for p in eye.panels))


def texel_directions(radial: RadialMap, size: tuple[int, int], gaze: tuple) -> np.ndarray:
    """(H, W, 3) directions of the texels."""
    phi = 2 * np.pi * (np.arange(size[1]) + 0.5) / size[1]
    return direction(gaze_basis(gaze), radial.centres_deg(size[0])[None, :], phi[:, None])


def through_buffer(
    picture: Callable[[np.ndarray], np.ndarray], eye: Eye, kind: str = "acuity", size: tuple[int, int] | None = None,
    radial: RadialMap | None = None,
) -> list[np.ndarray]:  # fmt: skip
    """``picture`` (directions (..., 3) -> values (...)) sampled at the texels and resolved for every panel (H, W)."""
    radial = map_of(eye, kind) if radial is None else radial
    if size is None:
        size = buffer_size(max(p.ppd for p in eye.panels), radial.most_deg, None, None)
    gaze = eye.panels[0].plane.gaze
    values = picture(texel_directions(radial, size, gaze))
    buffer = opaque_float(np.repeat(values[..., None], 4, axis=2))
    polar = polar_state(radial, size, gaze)
    out = []
    for panel in eye.panels:
        width, height = panel.size_px
        empty = dr.zeros(mi.Float, width * height * 4)
        dr.make_opaque(empty)
        pixel, marks = dr.arange(mi.UInt32, width * height), mi.UInt32(np.zeros(size[0] * size[1], np.uint32))
        places = mi.UInt32(np.zeros(2 * width * height, np.uint32))
        _, places = look_up(polar, panel_state(panel), pixel, marks, places)
        found = resolve(polar, places, pixel, buffer, empty)
        out.append(found.numpy().reshape(height, width, 4)[..., 0])
    return out


def eye_of(size_px: tuple[int, int], yfov_deg: float = 60.0, gaze: tuple[float, float] | None = None, **more) -> Eye:
    """The one eye of a view without viewports."""
    (eye,) = eyes_of(still_view(size_px, yfov_deg, gaze, **more), size_px)
    return eye
