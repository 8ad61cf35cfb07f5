"""From the polar buffer to Cartesian pictures, inside kernels: bilinear, wrapped in angle, through the gaze.

A buffer is a flat `mi.Float` of W * H * 4 (RGB and coverage), row j * W + i. Along the radius the weights are linear in
eccentricity, so that smooth pictures come back whatever the mapping; before the first texel lies its opposite one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.engine import LARGEST
from renderers.frozen import opaque_float, opaque_uint
from renderers.parameters import PolarMapping
from renderers.polar.panels import Panel
from renderers.polar.polar_map import RadialMap, gaze_basis


@dataclass
class PolarState:
    """A PyTree: one eye's buffer. ``basis``: right, up, gaze (9 floats); ``centres``: W + 2 eccentricities in radians
    (the opposite of the first texel's, the texels', one beyond); ``ratio`` and ``scale``: see `_share`."""

    kind: PolarMapping
    width: Any
    height: Any
    basis: Any
    centres: Any
    ratio: Any
    scale: Any


@dataclass
class PanelState:
    """A PyTree: one panel's plane (corner, step x, step y: 9 floats), the lens of its rays, its width in pixels."""

    plane: Any
    lens: Any
    width: Any


@dataclass
class Texels:
    """A PyTree: the four texels of a direction and their weights."""

    index: list[Any]
    weight: list[Any]


def polar_state(radial: RadialMap, size: tuple[int, int], gaze: tuple[float, float, float]) -> PolarState:
    """The device's buffer geometry for this gaze."""
    width, height = size
    centres = np.radians(radial.centres_deg(width))
    beyond = 2 * centres[-1] - centres[-2]
    if radial.kind == "acuity":
        ratio, scale = 1.0, 1 / math.log1p(radial.most_deg)
    else:
        ratio = radial.mar_slope / radial.mar_foveal_deg
        t = ratio * radial.most_deg
        scale = 1 / (math.log1p(t) - t / (1 + t))
    return PolarState(
        kind=radial.kind,
        width=opaque_uint(width),
        height=opaque_uint(height),
        basis=opaque_float(gaze_basis(gaze)),
        centres=opaque_float(np.concatenate([[-centres[0]], centres, [beyond]])),
        ratio=opaque_float(ratio),
        scale=opaque_float(scale),
    )


def panel_state(panel: Panel) -> PanelState:
    """The device's geometry of ``panel``."""
    plane = panel.plane
    return PanelState(
        plane=opaque_float([*plane.corner, *plane.step_x, *plane.step_y]),
        lens=opaque_float(panel.lens),
        width=opaque_uint(panel.size_px[0]),
    )


def _vector(values: Any, row: int) -> Any:
    return mi.Vector3f(*(dr.gather(mi.Float, values, mi.UInt32(3 * row + k)) for k in range(3)))


def _share(polar: PolarState, theta_rad: Any) -> Any:
    """Share of the radius at an eccentricity: the float32 twin of `RadialMap.share`."""
    t = theta_rad * (180 / math.pi) * polar.ratio
    if polar.kind == "acuity":
        return dr.log(1 + t) * polar.scale
    tail = mi.Float(0)
    for n in range(9, 1, -1):  # Horner: t^2/2 - 2 t^3/3 + 3 t^4/4 ...
        tail = dr.fma(tail, t, (-1) ** n * (n - 1) / n)
    return dr.select(t < 0.1, tail * t * t, dr.log(1 + t) - t / (1 + t)) * polar.scale


def pixel_direction(panel: PanelState, x_px: Any, y_px: Any) -> Any:
    """Eye direction (unit) of a picture point."""
    return dr.normalize(_vector(panel.plane, 0) + _vector(panel.plane, 1) * x_px + _vector(panel.plane, 2) * y_px)


def found_at(polar: PolarState, d: Any) -> Any:
    """Where a unit eye direction lies among the texels: Vector2u, column and row below it, 16 bits of fraction each.

    First word: the column counted from 1 (0 is the opposite of the first) and the row above it, 16 bits each; second:
    how far beyond them, in 65,535ths. What a picture's pixel reads of a buffer, for as long as the gaze rests.
    """
    across, above, along = (dr.dot(d, _vector(polar.basis, k)) for k in range(3))
    theta = dr.atan2(dr.sqrt(across * across + above * above), along)
    # Column: the texel whose centre lies below theta.
    width, height = polar.width, polar.height
    guess = dr.clip(_share(polar, theta) * mi.Float(width) - 0.5, -1.0, mi.Float(width) - 1)
    column = mi.UInt32(mi.Int32(dr.floor(guess)) + 1)
    low, high = (dr.gather(mi.Float, polar.centres, column + k) for k in (0, 1))
    fx = dr.clip((theta - low) / (high - low), 0, 1)
    # Row, wrapped.
    turn = dr.atan2(above, across) * (0.5 / math.pi)
    turn = turn - dr.floor(turn)
    at = turn * mi.Float(height) - 0.5
    below = dr.floor(at)
    fy = at - below
    row = mi.UInt32(mi.Int32(below) + mi.Int32(height)) % height
    fractions = mi.UInt32(dr.round(fx * 65535)) | (mi.UInt32(dr.round(fy * 65535)) << 16)
    return mi.Vector2u(column | (row << 16), fractions)


def texels_of(polar: PolarState, found: Any) -> Texels:
    """The four texels of a place of `found_at` and their bilinear weights."""
    width, height = polar.width, polar.height
    column, row = found.x & 0xFFFF, found.x >> 16
    fx, fy = mi.Float(found.y & 0xFFFF) * (1 / 65535), mi.Float(found.y >> 16) * (1 / 65535)
    after = dr.select(row + 1 == height, 0, row + 1)
    opposite = mi.Bool(column == 0)
    inner = dr.select(opposite, 0, column - 1)
    outer = dr.minimum(column, width - 1)
    half = height >> 1
    index, weight = [], []
    for r, wy in ((row, 1 - fy), (after, fy)):
        turned = dr.select(r >= half, r - half, r + half)
        index += [dr.select(opposite, turned, r) * width + inner, r * width + outer]
        weight += [wy * (1 - fx), wy * fx]
    return Texels(index, weight)


def look_up(polar: PolarState, panel: PanelState, pixel: Any, marks: Any, found: Any) -> tuple[Any, Any]:
    """Write the places of the panel's pixels into ``found`` (flat, 2 UInt32 each), 1 into the texels' ``marks``."""
    place = found_at(polar, _at_pixel(panel, pixel))
    dr.scatter(found, place, pixel)
    for index in texels_of(polar, place).index:
        dr.scatter(marks, mi.UInt32(1), index)
    return marks, found


def resolve(polar: PolarState, found: Any, pixel: Any, buffer: Any, picture: Any) -> Any:
    """Write a panel's pixels (flat H * W * 4) from the polar ``buffer``; ``found``: from `look_up`.

    Looked up anew in every frame, into memory of its own, this took 3.9 times as long (four viewports, 1.6M pixels).
    """
    texels = texels_of(polar, dr.gather(mi.Vector2u, found, pixel))
    total = mi.Vector4f(0)
    for index, weight in zip(texels.index, texels.weight, strict=True):
        total = dr.fma(dr.gather(mi.Vector4f, buffer, index), weight, total)
    # weights may add up to a rounding above 1
    dr.scatter(picture, dr.minimum(total, LARGEST), pixel)
    return picture


def tiled_texel(polar: PolarState, lane: Any) -> tuple[Any, Any]:
    """(texel number, whether there is one) of a lane: tiles of 4 rows by 4 columns, so that packets of rays are narrow.

    Lanes: W times H, rounded up to a multiple of 4 rows.
    """
    band = lane // (4 * polar.width)
    within = lane - band * (4 * polar.width)
    row = band * 4 + (within & 3)
    return row * polar.width + (within >> 2), row < polar.height


def in_use(polar: PolarState, lane: Any, marks: Any) -> tuple[Any, Any]:
    """(texel number, whether some pixel reads it) of a lane, see `tiled_texel`."""
    texel, there = tiled_texel(polar, lane)
    return texel, there & (dr.gather(mi.UInt32, marks, texel, there) == 1)


def _at_pixel(panel: PanelState, pixel: Any) -> Any:
    y = pixel // panel.width
    x = pixel - y * panel.width
    return pixel_direction(panel, mi.Float(x) + 0.5, mi.Float(y) + 0.5)


def texel_direction(polar: PolarState, texel: Any) -> tuple[Any, Any]:
    """(unit eye direction, solid angle in steradians) of a texel number."""
    row = texel // polar.width
    column = texel - row * polar.width
    before, theta, after = (dr.gather(mi.Float, polar.centres, column + k) for k in range(3))
    sine, cosine = dr.sincos(theta)
    sin_phi, cos_phi = dr.sincos((mi.Float(row) + 0.5) * (dr.two_pi / mi.Float(polar.height)))
    right, up, gaze = (_vector(polar.basis, k) for k in range(3))
    d = gaze * cosine + (right * cos_phi + up * sin_phi) * sine
    return d, dr.abs(sine) * ((after - before) * 0.5) * (dr.two_pi / mi.Float(polar.height))
