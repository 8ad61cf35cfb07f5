"""Lights as a flat table, and what they send to a point. Intensities and places are in tracer space.

A light without falloff (BART) of intensity 1 lights a facing white surface to 1, as classic renderers have it: its
irradiance is pi times its intensity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.frozen import opaque_float
from renderers.requirements import light_kind
from renderers.space import TracerSpace
from stimuli.scene import Light, Scene

ROWS = 5  # Vector4f rows of a light
_NO_RANGE = 1e30
_UNROLLED = 3
_LEAST_DISTANCE2 = 1e-12


@dataclass(frozen=True)
class LightGroup:
    """Lights of one kind: the table's entries ``start`` to ``start + count - 1``."""

    kind: str
    start: int
    count: int


@dataclass
class LightArrays:
    """A PyTree: ``rows`` (2, L, 5, 4) float32 flat: at t0 and at t1."""

    rows: Any
    count: int


@dataclass
class Incident:
    """A PyTree: light arriving from unit direction ``to_light``: ``irradiance`` on a facing surface (Color3f), and how
    far a shadow ray must go (``distance``, tracer units)."""

    to_light: Any
    irradiance: Any
    distance: Any


def sorted_lights(scene: Scene, sphere_sampled: bool) -> tuple[list[Light], tuple[LightGroup, ...]]:
    """The scene's lights ordered by kind, and the groups."""
    pairs = sorted(((light_kind(light, sphere_sampled), i) for i, light in enumerate(scene.lights)))
    groups = []
    for kind in sorted({kind for kind, _ in pairs}):
        places = [k for k, (other, _) in enumerate(pairs) if other == kind]
        groups.append(LightGroup(kind, places[0], len(places)))
    return [scene.lights[i] for _, i in pairs], tuple(groups)


def _unit(v: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(v))
    return v / length if length > 0 else np.array([0.0, 0.0, -1.0])


def _row(light: Light, kind: str, space: TracerSpace, time_s: float) -> np.ndarray:
    """(5, 4): position, 0 | intensity, range | direction, cos inner | edge u or radius, cos outer | edge v, even."""
    matrix = np.eye(4) if light.track is None else light.track.pose(np.array([time_s]))[0]
    turn = matrix[:3, :3]

    def place(p: Any) -> np.ndarray:
        return space.points(turn @ np.asarray(p, float) + matrix[:3, 3])

    intensity = np.asarray(light.intensity, float)
    position = place(light.corner if kind == "area" else light.position)
    direction = _unit(turn @ np.asarray(light.direction, float))
    edge_u, edge_v = (turn @ np.asarray(e, float) * space.scale for e in (light.edge_u, light.edge_v))
    # How large a sphere is in the world: the track's scale counts.
    radius = light.radius * float(np.cbrt(abs(np.linalg.det(turn)))) * space.scale
    if kind == "point" and light.kind == "sphere":
        intensity, edge_u = intensity * math.pi * radius**2, np.array([radius, 0, 0])
    elif kind == "sphere":
        edge_u = np.array([radius, 0, 0])
    elif kind in ("point", "spot"):
        edge_u = np.zeros(3)
        intensity = intensity * (math.pi if light.falloff == "none" else space.scale**2)
    reach = light.range_m * space.scale if np.isfinite(light.range_m) else _NO_RANGE
    return np.array(
        [
            [*position, 0],
            [*intensity, reach],
            [*direction, math.cos(light.inner_rad)],
            [*edge_u, math.cos(light.outer_rad)],
            [*edge_v, 1.0 if light.falloff == "none" else 0.0],
        ]
    )


def light_arrays(
    lights: list[Light], groups: tuple[LightGroup, ...], space: TracerSpace, t0_s: float, t1_s: float
) -> LightArrays:
    """The device's table of ``lights`` at both ends of the interval."""
    kinds = [group.kind for group in groups for _ in range(group.count)]
    rows = [[_row(light, kind, space, t) for light, kind in zip(lights, kinds, strict=True)] for t in (t0_s, t1_s)]
    table = np.array(rows, np.float32).ravel()
    return LightArrays(opaque_float(table if table.size else np.zeros(2 * ROWS * 4)), max(1, len(lights)))


@dataclass
class LightSample:
    """One light's five rows at a ray's time (Vector4f each)."""

    rows: tuple[Any, ...]


def light_at(arrays: LightArrays, index: Any, moving: bool, share: Any) -> LightSample:
    """Light ``index``; ``share``: 0 at t0, 1 at t1 (used only where some light moves)."""
    index = mi.UInt32(index)
    now = [dr.gather(mi.Vector4f, arrays.rows, (index + arrays.count) * ROWS + row) for row in range(ROWS)]
    if not moving:
        return LightSample(tuple(now))
    before = [dr.gather(mi.Vector4f, arrays.rows, index * ROWS + row) for row in range(ROWS)]
    return LightSample(tuple(dr.lerp(a, b, share) for a, b in zip(before, now, strict=True)))


def _xyz(v: Any) -> Any:
    return mi.Vector3f(v.x, v.y, v.z)


def incident(kind: str, light: LightSample, point: Any, x: Any, y: Any) -> Incident:
    """What ``light`` sends to ``point``; ``x``, ``y`` in [0, 1) choose the place on an area or sphere light.

    area: radiance * cos * A / d^2 (one-sided). sphere: uniform in the cone that it subtends. The mean over (x, y) is
    the light's irradiance; points inside a sphere light get none.
    """
    place, power, direction, edge_u, edge_v = light.rows
    color = mi.Color3f(power.x, power.y, power.z)
    if kind == "directional":
        return Incident(-_xyz(direction), color, mi.Float(dr.inf))
    if kind == "sphere":
        return _sphere(_xyz(place) - point, edge_u.x, color, x, y)
    target = _xyz(place)
    if kind == "area":
        target = target + _xyz(edge_u) * x + _xyz(edge_v) * y
    away = target - point
    distance2 = dr.maximum(dr.squared_norm(away), _LEAST_DISTANCE2)
    inverse = dr.rsqrt(distance2)
    to_light = away * inverse
    distance = distance2 * inverse
    if kind == "area":
        area = dr.norm(dr.cross(_xyz(edge_u), _xyz(edge_v)))
        cosine = dr.maximum(-dr.dot(to_light, _xyz(direction)), 0)
        return Incident(to_light, color * (cosine * area * dr.rcp(distance2)), distance * (1 - 1e-3))
    share = dr.select(edge_v.w > 0.5, 1, dr.rcp(distance2))
    # KHR_lights_punctual: a smooth end at the light's range.
    window = dr.square(dr.square(distance * dr.rcp(power.w)))
    share *= dr.clip(1 - window, 0, 1)
    if kind == "spot":
        cosine = -dr.dot(to_light, _xyz(direction))
        ramp = dr.clip((cosine - edge_u.w) * dr.rcp(dr.maximum(direction.w - edge_u.w, 1e-4)), 0, 1)
        share *= dr.square(ramp)
    # A point light that stands for a sphere is not shadowed by the sphere's own mesh.
    return Incident(to_light, color * share, dr.maximum(distance * (1 - 1e-4) - edge_u.x * 1.05, 0))


def _sphere(away: Any, radius: Any, color: Any, x: Any, y: Any) -> Incident:
    """Uniform sampling of the cone that a sphere subtends: irradiance = radiance * solid angle."""
    distance2 = dr.maximum(dr.squared_norm(away), _LEAST_DISTANCE2)
    distance = dr.sqrt(distance2)
    sine2 = dr.minimum(dr.square(radius) / distance2, 1)
    outside = distance > radius
    one_minus_cosine = sine2 / (1 + dr.sqrt(1 - sine2))
    cosine = 1 - x * one_minus_cosine
    sine = dr.sqrt(dr.maximum(0, 1 - dr.square(cosine)))
    sin_phi, cos_phi = dr.sincos(dr.two_pi * y)
    frame = mi.Frame3f(away / distance)
    to_light = frame.to_world(mi.Vector3f(sine * cos_phi, sine * sin_phi, cosine))
    # The nearer crossing of the sphere, short of its own mesh.
    along = distance * cosine
    reach = along - dr.sqrt(dr.maximum(0, dr.square(radius) - (distance2 - dr.square(along))))
    irradiance = color * dr.select(outside, dr.two_pi * one_minus_cosine, 0)
    return Incident(to_light, irradiance, dr.maximum(reach - 0.05 * radius, 0))


def repeat(count: int, state: tuple[Any, ...], step: Callable[..., tuple[Any, ...]], label: str) -> tuple[Any, ...]:
    """``state = step(i, *state)`` for i in 0 .. count - 1: written out for a few, else a loop on the device."""
    if count <= _UNROLLED:
        for i in range(count):
            state = step(mi.UInt32(i), *state)
        return state
    found = dr.while_loop(
        (mi.UInt32(0), *state), lambda i, *rest: i < count, lambda i, *rest: (i + 1, *step(i, *rest)), label=label
    )
    return found[1:]
