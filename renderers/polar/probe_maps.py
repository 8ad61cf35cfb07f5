"""The maps of light probes: how rays are blended into them, and what a surface gets from the eight probes around it.

Majercik et al., JCGT 8(2), 2019: each probe holds irradiance and distance as octahedral maps with a border.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from renderers.backend import dr, mi
from renderers.lights import repeat
from renderers.parameters import Probes
from renderers.polar.octahedral import look_up, padded_index, texel_direction

IRRADIANCE, DISTANCE = 6, 14  # interior texels a side
GAMMA = 5.0  # irradiance is stored as its fifth root, as the eye sees differences
_SUDDEN, _BRIGHT = 0.25, 0.10  # changes of a stored value that speed it up, or that are taken as fireflies


@dataclass
class ProbeArrays:
    """A PyTree. ``irradiance`` (P, 8, 8, 4) and ``distance`` (P, 16, 16, 2) flat; ``valid`` (P,) 1.0 where the
    probe has seen the scene from outside of its walls; ``low``, ``spacing``: first probe and grid step (3 floats each,
    tracer space); ``reach``: longest distance that is stored; ``radius``: length of the short rays."""

    irradiance: Any
    distance: Any
    valid: Any
    low: Any
    spacing: Any
    reach: Any
    radius: Any


def probe_position(arrays: ProbeArrays, x: Any, y: Any, z: Any) -> Any:
    """Where (Point3f, tracer space) the probe in column x, row y, layer z (UInt32) stands."""
    low, spacing = ([dr.gather(mi.Float, v, mi.UInt32(k)) for k in range(3)] for v in (arrays.low, arrays.spacing))
    return mi.Point3f(*(dr.fma(mi.Float(i), s, o) for i, s, o in zip((x, y, z), spacing, low, strict=True)))


def blend_irradiance(
    p: Probes, slot: Any, start: Any, step: Any, rays: Any, kept: Any, found: Any, irradiance: Any, valid: Any
) -> tuple[Any, Any]:  # fmt: skip
    """Cosine-weighted means of the rays' radiance, blended into the stored fifth roots."""
    n, texels = p.rays, IRRADIANCE**2
    probe = slot // texels
    texel = slot - probe * texels
    normal = texel_direction(texel, IRRADIANCE)

    def add(i: Any, total: Any, weights: Any, back: Any) -> tuple[Any, Any, Any]:
        d = dr.gather(mi.Vector4f, rays, i)
        value = dr.gather(mi.Vector4f, found, probe * n + i)
        cosine = dr.maximum(normal.x * d.x + normal.y * d.y + normal.z * d.z, 0)
        cosine = dr.select(value.w < 0, 0, cosine)
        radiance = mi.Color3f(value.x, value.y, value.z)
        return total + radiance * cosine, weights + cosine, back + dr.select(value.w < 0, 1.0, 0.0)

    total, weights, back = repeat(n, (mi.Color3f(0), mi.Float(0), mi.Float(0)), add, "irradiance")
    number = start + probe * step
    place = number * (IRRADIANCE + 2) ** 2 + padded_index(texel, IRRADIANCE)
    outside = (back <= p.backface_share * n) & (weights > 0)
    new = dr.power(total * dr.rcp(dr.maximum(2 * weights, 1e-9)), 1 / GAMMA)
    stored = dr.gather(mi.Vector4f, irradiance, place)
    old = mi.Color3f(stored.x, stored.y, stored.z)
    change = new - old
    kept = dr.select(dr.max(-change) > _SUDDEN, dr.maximum(kept - 0.75, 0), kept)
    change = dr.select(mi.luminance(change) > _BRIGHT, change * 0.25, change)
    value = dr.select(dr.max(old) == 0, new, old + change * (1 - kept))
    dr.scatter(irradiance, mi.Vector4f(value.x, value.y, value.z, 0), place, outside)
    dr.scatter(valid, dr.select(outside, mi.Float(1), mi.Float(0)), number, texel == 0)
    return irradiance, valid


def blend_distance(
    p: Probes, slot: Any, start: Any, step: Any, rays: Any, kept: Any, found: Any, reach: Any, distance: Any
) -> Any:  # fmt: skip
    """Mean distance and squared distance, in sharp lobes."""
    n, texels = p.rays, DISTANCE**2
    probe = slot // texels
    texel = slot - probe * texels
    normal = texel_direction(texel, DISTANCE)

    def add(i: Any, total: Any, weights: Any) -> tuple[Any, Any]:
        d = dr.gather(mi.Vector4f, rays, i)
        r = dr.abs(dr.gather(mi.Float, found, (probe * n + i) * 4 + 3))
        cosine = dr.maximum(normal.x * d.x + normal.y * d.y + normal.z * d.z, 0)
        weight = dr.power(cosine, p.sharpness)
        return total + mi.Vector2f(r, r * r) * weight, weights + weight

    total, weights = repeat(n, (mi.Vector2f(0), mi.Float(0)), add, "distance")
    place = (start + probe * step) * (DISTANCE + 2) ** 2 + padded_index(texel, DISTANCE)
    old = dr.gather(mi.Vector2f, distance, place)
    new = total * dr.rcp(dr.maximum(2 * weights, 1e-20))
    value = dr.select(old.x == 0, new, dr.lerp(new, old, kept))
    dr.scatter(distance, value, place, weights > 1e-20)
    return distance


def copy_borders(
    kind: int, size: int, slot: Any, start: Any, step: Any, border: Any, source: Any, maps: Any
) -> Any:  # fmt: skip
    """Copy the border of ``size`` maps (``kind`` floats a texel) from the texels that its folds meet."""
    texels = 4 * size + 4
    probe = slot // texels
    at = slot - probe * texels
    base = (start + probe * step) * (size + 2) ** 2
    vector = mi.Vector4f if kind == 4 else mi.Vector2f
    value = dr.gather(vector, maps, base + dr.gather(mi.UInt32, source, at))
    dr.scatter(maps, value, base + dr.gather(mi.UInt32, border, at))
    return maps


def irradiance_at(p: Probes, arrays: ProbeArrays, point: Any, normal: Any, to_eye: Any, active: Any) -> Any:
    """Irradiance / pi at a surface from the eight probes around it, those behind walls left out by distance."""
    low, spacing = (
        mi.Vector3f(*(dr.gather(mi.Float, v, mi.UInt32(k)) for k in range(3))) for v in (arrays.low, arrays.spacing)
    )
    bias = 0.75 * p.bias * dr.min(spacing)
    asked = mi.Point3f(mi.Vector3f(point) + (normal * 0.2 + to_eye * 0.8) * bias)
    place = (mi.Vector3f(asked) - low) / spacing
    cells, share = [], []
    for axis, n in enumerate(p.grid):
        cell = mi.UInt32(dr.clip(place[axis], 0, max(n - 2, 0)))
        cells.append(cell)
        share.append(dr.clip(place[axis] - mi.Float(cell), 0, 1))
    nx, ny, nz = p.grid

    def add(i: Any, total: Any, weights: Any) -> tuple[Any, Any]:
        steps = (i & 1, (i >> 1) & 1, (i >> 2) & 1)
        x, y, z = (dr.minimum(c + s, n - 1) for c, s, n in zip(cells, steps, (nx, ny, nz), strict=True))
        number = (z * ny + y) * nx + x
        probe = probe_position(arrays, x, y, z)
        trilinear = mi.Float(1)
        for s, a in zip(steps, share, strict=True):
            trilinear *= dr.maximum(0.001, dr.select(s == 1, a, 1 - a))
        towards = mi.Vector3f(probe - point)
        towards *= dr.rcp(dr.maximum(dr.norm(towards), 1e-9))
        weight = dr.square(0.5 * (1 + dr.dot(towards, normal))) + 0.2
        away = mi.Vector3f(asked - probe)
        length = dr.maximum(dr.norm(away), 1e-9)
        moments = look_up(mi.Vector2f, arrays.distance, number, away, DISTANCE, active) * 2
        variance = dr.abs(dr.square(moments.x) - moments.y)
        beyond = length - moments.x
        chance = variance * dr.rcp(variance + dr.square(beyond) + 1e-12)
        weight *= dr.select(beyond > 0, dr.maximum(0.05, chance * chance * chance), 1)
        weight = dr.maximum(1e-6, weight)
        weight = dr.select(weight < 0.2, weight * weight * weight * (1 / 0.04), weight) * trilinear
        weight *= dr.gather(mi.Float, arrays.valid, number, active)
        value = look_up(mi.Vector4f, arrays.irradiance, number, normal, IRRADIANCE, active)
        root = dr.power(dr.maximum(mi.Color3f(value.x, value.y, value.z), 0), GAMMA / 2)
        return total + root * weight, weights + weight

    total, weights = repeat(8, (mi.Color3f(0), mi.Float(0)), add, "probes")
    return dr.select(weights > 0, dr.square(total * dr.rcp(dr.maximum(weights, 1e-30))) * 2, 0)
