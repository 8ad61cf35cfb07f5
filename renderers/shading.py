"""Whitted shading of one hit: emission, ambient term, one shadow ray a light (or n for lights with an area), or
ambient occlusion. Mirrors and see-through surfaces are followed by `renderers.engine`.

BRDFs: Phong (diffuse / pi + specular cos^n / pi; BART's lights then give its own formula) and glTF 2.0's
metallic-roughness (specification, Appendix B: Lambert + GGX with Smith's height-correlated masking, Schlick Fresnel).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from renderers.backend import dr, mi
from renderers.lights import LightArrays, LightGroup, incident, light_at, repeat
from renderers.materials import Look
from renderers.poses import Poses
from renderers.requirements import MIRROR_LEAST, MIRROR_ROUGHNESS
from renderers.rng import combined, uniform
from renderers.surface import Surface
from renderers.tracer import SceneArrays, Tracer

OFFSET = 5e-6
"""Secondary rays start this far off the face, relative to max(1, |p|), in tracer units."""
_LEAST_ALPHA = 0.01  # GGX width of the smoothest highlight: mirrors take over there


@dataclass
class Direct:
    """A PyTree: light that reaches a hit. ``even`` and ``noisy``: what multiplies the diffuse colour, from point-like
    lights and from lights that are sampled; ``specular``: highlights; ``shadow_rays``: UInt32."""

    even: Any
    noisy: Any
    specular: Any
    shadow_rays: Any


def start_point(surface: Surface, side: Any) -> Any:
    """Where a secondary ray starts: off the face along ``side`` (the geometric normal or its opposite)."""
    p = surface.point
    size = dr.maximum(1, dr.maximum(dr.abs(p.x), dr.maximum(dr.abs(p.y), dr.abs(p.z))))
    return dr.fma(mi.Vector3f(side), OFFSET * size, p)


def fresnel(f0: Any, cosine: Any) -> Any:
    """Schlick's approximation."""
    x = dr.clip(1 - cosine, 0, 1)
    return f0 + (1 - f0) * (dr.square(dr.square(x)) * x)


def mirror_weight(look: Look, cosine: Any) -> Any:
    """Weight of the mirror reflection (Color3f): Phong's specular colour; Schlick for roughness <= 0.25, else none."""
    smooth = dr.select(look.roughness <= MIRROR_ROUGHNESS, fresnel(look.specular, cosine), 0)
    weight = dr.select(look.phong, look.specular, smooth)
    return dr.select(look.unlit | (dr.max(weight) < MIRROR_LEAST), 0, weight)


def _highlight(look: Look, normal: Any, view: Any, to_light: Any, phong: bool, metallic: bool) -> tuple[Any, Any]:
    """(highlight per irradiance, what Fresnel leaves for the diffuse part). Phong's lobe has no n.l, as in BART."""
    nl = dr.maximum(dr.dot(normal, to_light), 0)
    value, left = mi.Color3f(0), mi.Color3f(1)
    if phong:
        mirrored = normal * (2 * dr.dot(normal, to_light)) - to_light
        lobe = dr.power(dr.maximum(dr.dot(mirrored, view), 0), look.shine) * dr.inv_pi
        value = look.specular * dr.select(look.shine > 0, lobe, 0)
    if metallic:
        half = dr.normalize(to_light + view)
        nv, nh, vh = (dr.maximum(dr.dot(a, b), 1e-4) for a, b in ((normal, view), (normal, half), (view, half)))
        alpha2 = dr.square(dr.maximum(dr.square(look.roughness), _LEAST_ALPHA))
        density = alpha2 / (math.pi * dr.square(dr.square(nh) * (alpha2 - 1) + 1))
        masking = 0.5 / (
            nl * dr.sqrt(nv * nv * (1 - alpha2) + alpha2) + nv * dr.sqrt(nl * nl * (1 - alpha2) + alpha2) + 1e-9
        )
        f = fresnel(look.specular, vh)
        value = dr.select(look.phong, value, f * (density * masking * nl))
        left = dr.select(look.phong, mi.Color3f(1), 1 - f)
    return value, left


def direct_light(
    tracer: Tracer,
    arrays: SceneArrays,
    poses: Poses,
    lights: LightArrays,
    groups: tuple[LightGroup, ...],
    moving_lights: bool,
    surface: Surface,
    look: Look,
    view: Any,
    time_s: Any,
    active: Any,
    rng: Any,
    light_samples: int,
    coherent: bool,
) -> Direct:
    """Light from all lights. ``view``: unit vector to the ray's origin. ``rng``: UInt32 seed a lane, or None.

    Each area light gets ``light_samples`` = k * k places: the cell centres of an even grid, or with a seed one random
    place a cell. ``coherent``: neighbouring lanes' shadow rays go the same way.
    """
    needs = tracer.needs
    normal, geometric = mi.Vector3f(surface.normal), mi.Vector3f(surface.geometric)
    origin = start_point(surface, geometric)
    share = mi.Float(1) if isinstance(time_s, (int, float)) else 1 - time_s / poses.span_s
    state = (mi.Color3f(0), mi.Color3f(0), mi.Color3f(0), mi.UInt32(0))
    for group in groups:
        sampled = group.kind in ("area", "sphere")
        samples = light_samples if sampled else 1
        side = math.isqrt(samples)

        def step(
            i: Any, even: Any, noisy: Any, specular: Any, rays: Any,
            group: LightGroup = group, samples: int = samples, side: int = side, sampled: bool = sampled,
        ) -> tuple[Any, ...]:  # fmt: skip
            number, cell = (i, mi.UInt32(0)) if samples == 1 else (i // samples, i % samples)
            light = light_at(lights, number + group.start, moving_lights, share)
            x = y = mi.Float(0.5)
            if sampled and rng is not None:
                place = combined(rng, number * 65536 + cell + 1)
                x, y = uniform(place, 0), uniform(place, 1)
            x = (mi.Float(cell % side) + x) * (1 / side)
            y = (mi.Float(cell // side) + y) * (1 / side)
            got = incident(group.kind, light, surface.point, x, y)
            nl = dr.dot(normal, got.to_light)
            lit = active & (nl > 0) & (dr.dot(geometric, got.to_light) > 0) & (dr.max(got.irradiance) > 0)
            blocked = tracer.occluded(arrays, poses, origin, got.to_light, time_s, lit, got.distance, coherent)
            energy = dr.select(lit & ~blocked, got.irradiance * (1 / samples), 0)
            rays = rays + dr.select(lit, mi.UInt32(1), mi.UInt32(0))
            left = mi.Color3f(1)
            if needs.specular:
                shine, left = _highlight(look, normal, view, got.to_light, needs.phong, needs.metallic)
                specular = specular + dr.select(lit & ~blocked, shine * energy, 0)
            diffuse = energy * left * (nl * dr.inv_pi)
            if sampled:
                return even, noisy + diffuse, specular, rays
            return even + diffuse, noisy, specular, rays

        state = repeat(group.count * samples, state, step, group.kind)
    return Direct(*state)


def ambient_occlusion(
    tracer: Tracer,
    arrays: SceneArrays,
    poses: Poses,
    surface: Surface,
    radius: Any,
    time_s: Any,
    active: Any,
    rng: Any,
    samples: int,
) -> Any:
    """Share of the hemisphere that is open within ``radius`` (tracer units), cosine-weighted, ``samples`` short rays.

    Directions are a stratified set of radii and a golden-angle turn, rotated by the lane's seed.
    """
    normal = mi.Vector3f(surface.normal)
    frame = mi.Frame3f(normal)
    origin = start_point(surface, mi.Vector3f(surface.geometric))
    turn = uniform(rng, 0x51) if rng is not None else mi.Float(0.5)
    shift = uniform(rng, 0x52) if rng is not None else mi.Float(0.5)

    def step(i: Any, open_rays: Any) -> tuple[Any]:
        height2 = (mi.Float(i) + shift) * (1 / samples)
        sin_phi, cos_phi = dr.sincos(dr.two_pi * (turn + mi.Float(i) * 0.6180339887))
        across = dr.sqrt(height2)
        d = frame.to_world(mi.Vector3f(across * cos_phi, across * sin_phi, dr.sqrt(dr.maximum(0, 1 - height2))))
        # Directions below a smoothed face count as closed, without a ray.
        up = active & (dr.dot(d, mi.Vector3f(surface.geometric)) > 0)
        blocked = tracer.occluded(arrays, poses, origin, d, time_s, up, radius)
        return (open_rays + dr.select(up & ~blocked, 1.0, 0.0),)

    return repeat(samples, (mi.Float(0),), step, "ambient occlusion")[0] * (1 / samples)
