"""What one ray sees: its visible hit, the light that leaves it, and the light through mirrors and see-through surfaces.

Whitted 1980: at each hit one shadow ray a light, then on along the mirror direction (depth 3, then none) and straight
through what can be seen through. Called inside kernels; see `renderers.engine` for spaces and units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from renderers.backend import dr, mi
from renderers.camera import Ray
from renderers.materials import look_at_hit, opacity
from renderers.motion import Place
from renderers.mover_walk import RawHit
from renderers.rng import combined
from renderers.shading import ambient_occlusion, direct_light, mirror_weight, start_point
from renderers.surface import Surface, surface_at

if TYPE_CHECKING:
    from renderers.engine import Engine, EngineState

MIRROR_DEPTH = 3
_MOST_STEPS = 48  # mirrors and see-through layers along one primary ray
_MOST_CUTOUTS = 64


@dataclass
class Shaded:
    """One hit: own light (``surface`` + ``albedo`` * ``light``), and how rays go on from it."""

    surface: Any
    albedo: Any
    light: Any
    mirror: Any
    behind: Any
    shadow: Any
    ambient_occlusion: Any


def visible_hit(
    engine: Engine, state: EngineState, ray: Ray, time_s: Any, active: Any, coherent: bool
) -> tuple[RawHit, Surface]:
    """The nearest hit that is not cut out, and its surface."""
    hit = engine.tracer.nearest(state.arrays, state.poses, ray.o, ray.d, time_s, active, coherent)
    if engine.requirements.cutouts:
        hit = past_cutouts(engine, state, ray, hit, time_s, active)
    seen = active & hit.valid
    surface = surface_at(engine.tracer, state.arrays, state.poses, hit, ray.d, time_s, seen)
    engine.trap(state, "hit", seen, hit.t, hit.u, hit.v)
    engine.trap(state, "surface", seen, surface.point, surface.normal, surface.geometric, surface.uv_density)
    return hit, surface


def past_cutouts(engine: Engine, state: EngineState, ray: Ray, hit: RawHit, time_s: Any, active: Any) -> RawHit:
    """Go on from hits that alphaMode MASK cuts out."""

    def is_cut(hit: RawHit, on: Any) -> Any:
        on = on & hit.valid
        surface = surface_at(engine.tracer, state.arrays, state.poses, hit, ray.d, time_s, on)
        facing = dr.abs(dr.dot(surface.geometric, ray.d))
        width = dr.fma(ray.spread, hit.t, ray.width)
        return on & ~opacity(engine.requirements, state.materials, surface, width, facing, on)

    def step(hit: RawHit, cut: Any, steps: Any) -> tuple[Any, ...]:
        gap = hit.t + 1e-5 * (1 + hit.t)
        o = mi.Point3f(dr.fma(ray.d, gap, ray.o))
        found = engine.tracer.nearest(state.arrays, state.poses, o, ray.d, time_s, cut, coherent=False)
        found = RawHit(found.t + gap, found.face, found.u, found.v, found.mover)
        hit = dr.select(cut, found, hit)
        return hit, is_cut(hit, cut) & (steps < _MOST_CUTOUTS), steps + 1

    start = (hit, is_cut(hit, active), mi.UInt32(0))
    return dr.while_loop(start, lambda hit, cut, steps: cut, step, label="cutouts")[0]


def shade(
    engine: Engine,
    state: EngineState,
    surface: Surface,
    hit: RawHit,
    ray: Ray,
    time_s: Any,
    active: Any,
    rng: Any,
    light_samples: int,
    coherent: bool,
    short_rays: bool = True,
) -> Shaded:
    """Light leaving one hit towards the ray's origin, and the weights of the rays that go on from it."""
    needs = engine.requirements
    view = -mi.Vector3f(ray.d)
    facing = dr.abs(dr.dot(surface.geometric, ray.d))
    width = dr.fma(ray.spread, dr.select(hit.valid, hit.t, 0), ray.width)
    look = look_at_hit(needs, state.materials, surface, width, facing, active)
    none = dr.select(active, mi.UInt32(0), mi.UInt32(0))
    shadow, ao_rays = none, none
    own, light, albedo, mirror = look.emission, mi.Color3f(0), look.diffuse, mi.Color3f(0)
    if engine.lighting == "ambient_occlusion":
        albedo = dr.select(look.phong, look.diffuse, look.base) if needs.phong else look.base
        lit = active & ~look.unlit
        light = mi.Color3f(
            ambient_occlusion(
                engine.tracer, state.arrays, state.poses, surface, state.ao_radius, time_s, lit, rng, engine.ao_samples
            )
        )
        ao_rays = dr.select(lit, mi.UInt32(engine.ao_samples), mi.UInt32(0))
    else:
        lit = active & ~look.unlit if needs.unlit else active
        got = direct_light(
            engine.tracer, state.arrays, state.poses, state.lights, engine.light_groups, engine.lights_move,
            surface, look, view, time_s, lit, rng, light_samples, coherent,
        )  # fmt: skip
        shadow, light = got.shadow_rays, got.noisy
        own = own + look.diffuse * got.even + got.specular
        if needs.ambient:
            own = own + state.ambient * dr.select(look.unlit, 0, look.ambient)
        if engine.lighting == "probes" and engine.indirect is not None:
            bounced, ao_rays = engine.indirect.light(state, surface, view, time_s, lit, rng, short_rays)
            own = own + look.diffuse * bounced
        if needs.mirrors:
            mirror = mirror_weight(look, dr.maximum(dr.dot(surface.normal, view), 0))
    behind = mi.Color3f(0)
    if needs.transparency:
        # alpha BLEND: the surface covers alpha of what is behind; transmission: Phong adds, glTF replaces diffuse.
        kept = dr.select(look.see_through, look.alpha, 1)
        through = dr.select(look.see_through, look.transmission, 0)
        diffuse_left = dr.select(look.phong, 1, 1 - through)
        own, mirror = own * kept, mirror * kept
        own = dr.select(through > 0, own * diffuse_left, own)
        albedo = albedo * (kept * diffuse_left)
        tint = dr.select(look.phong, mi.Color3f(1), look.base)
        behind = mi.Color3f(1 - kept) + tint * (kept * through)
    engine.trap(state, "shading", active, own, albedo, light, mirror, behind)
    zero = mi.Color3f(0)
    return Shaded(
        surface=dr.select(active, own, zero),
        albedo=dr.select(active, dr.select(look.unlit, zero, albedo), zero),
        light=dr.select(active, light, zero),
        mirror=dr.select(active, mirror, zero),
        behind=dr.select(active, behind, zero),
        shadow=shadow,
        ambient_occlusion=ao_rays,
    )


def follow(
    engine: Engine, state: EngineState, ray: Ray, hit: RawHit, surface: Surface, shaded: Shaded, time_s: Any,
    active: Any, rng: Any, light_samples: int,
) -> dict[str, Any]:  # fmt: skip
    """Light through mirrors (depth 3, then dropped) and see-through surfaces (straight on, same depth).

    A ray that splits goes on as its reflection; the straight-on part waits in ``waiting`` at its mirror depth.
    """
    mirrors = engine.requirements.mirrors and engine.lighting != "ambient_occlusion"
    see_through = engine.requirements.transparency
    levels = (MIRROR_DEPTH + 1 if mirrors else 1) if see_through else 0
    zero3, no = mi.Color3f(0), mi.UInt32(0)

    def onward(s: Any, hit: RawHit, surface: Surface, shaded: Shaded, on: Any) -> dict[str, Any]:
        """Choose how the lane goes on from a shaded hit."""
        d = mi.Vector3f(s["d"])
        width = dr.fma(s["spread"], dr.select(hit.valid, hit.t, 0), s["width"])
        reflects, passes = mi.Bool(False), mi.Bool(False)
        if mirrors:
            reflects = on & (dr.max(shaded.mirror * s["weight"]) >= 1e-3) & (s["depth"] < MIRROR_DEPTH)
            reflects &= dr.max(shaded.mirror) > 0
        if see_through:
            passes = on & (dr.max(shaded.behind * s["weight"]) > 1e-4)
        through_o = start_point(surface, -mi.Vector3f(surface.geometric))
        through_weight = s["weight"] * shaded.behind
        waiting = []
        for level, place in enumerate(s["waiting"]):
            store = passes & reflects & (s["depth"] == level)
            entry = {
                "o": through_o,
                "d": d,
                "weight": through_weight,
                "width": width,
                "spread": s["spread"],
                "on": mi.Bool(True),
            }
            waiting.append(dr.select(store, entry, place))
        normal = mi.Vector3f(surface.normal)
        bounced = d - normal * (2 * dr.dot(d, normal))
        geometric = mi.Vector3f(surface.geometric)
        # A reflection that a smoothed normal sends below the face is brought back above it.
        below = dr.dot(bounced, geometric)
        bounced = dr.normalize(dr.select(below < 1e-3, bounced + geometric * (2e-3 - below), bounced))
        out = dict(s)
        straight = passes & ~reflects
        out["o"] = dr.select(reflects, start_point(surface, geometric), dr.select(straight, through_o, s["o"]))
        out["d"] = dr.select(reflects, bounced, d)
        out["weight"] = dr.select(
            reflects, s["weight"] * shaded.mirror, dr.select(straight, through_weight, s["weight"])
        )
        out["width"] = dr.select(reflects | straight, width, s["width"])
        out["depth"] = s["depth"] + dr.select(reflects, mi.UInt32(1), no)
        out["on"] = reflects | passes
        out["reflection"] = s["reflection"] + dr.select(reflects, mi.UInt32(1), no)
        out["transmission"] = s["transmission"] + dr.select(passes, mi.UInt32(1), no)
        out["waiting"] = waiting
        # A lane that ends takes up the deepest waiting ray.
        for level in reversed(range(levels)):
            place = out["waiting"][level]
            take = ~out["on"] & place["on"]
            for name in ("o", "d", "weight", "width", "spread"):
                out[name] = dr.select(take, place[name], out[name])
            out["depth"] = dr.select(take, mi.UInt32(level), out["depth"])
            out["on"] = out["on"] | take
            place = dict(place)
            place["on"] = place["on"] & ~take
            out["waiting"][level] = place
        return out

    idle = {
        "o": mi.Point3f(0), "d": mi.Vector3f(0, 0, 1), "weight": zero3, "width": mi.Float(0), "spread": mi.Float(0),
        "on": mi.Bool(False),
    }  # fmt: skip
    start = {
        "o": mi.Point3f(ray.o), "d": mi.Vector3f(ray.d), "weight": mi.Color3f(1), "width": mi.Float(ray.width),
        "spread": mi.Float(ray.spread), "depth": mi.UInt32(0), "on": mi.Bool(active), "color": zero3,
        "shadow": mi.UInt32(0), "ambient_occlusion": mi.UInt32(0), "reflection": mi.UInt32(0),
        "transmission": mi.UInt32(0), "steps": mi.UInt32(0),
        "shown": Place(mi.UInt32(0), mi.Point3f(0), mi.Point3f(0)), "found": mi.Bool(False),
        "waiting": [dict(idle) for _ in range(levels)],
    }  # fmt: skip
    start = onward(start, hit, surface, shaded, active)

    def step(s: dict[str, Any]) -> tuple[dict[str, Any]]:
        on = s["on"]
        here = Ray(s["o"], s["d"], s["width"], s["spread"])
        hit, surface = visible_hit(engine, state, here, time_s, on, coherent=False)
        seen = on & hit.valid
        seed = None if rng is None else combined(rng, s["steps"] + 7919)
        shaded = shade(engine, state, surface, hit, here, time_s, seen, seed, light_samples, coherent=False)
        light = dr.select(seen, shaded.surface + shaded.albedo * shaded.light, state.background)
        s = dict(s)
        # The first thing that the first mirror shows, for reflected motion vectors.
        first = seen & (s["depth"] == 1) & ~s["found"]
        s["shown"] = dr.select(first, Place(hit.mover, surface.point_local, surface.point_before), s["shown"])
        s["found"] = s["found"] | first
        s["color"] = s["color"] + dr.select(on, s["weight"] * light, 0)
        s["shadow"] = s["shadow"] + dr.select(seen, shaded.shadow, no)
        s["ambient_occlusion"] = s["ambient_occlusion"] + dr.select(seen, shaded.ambient_occlusion, no)
        s["steps"] = s["steps"] + 1
        s = onward(s, hit, surface, shaded, seen)
        engine.trap(state, "mirrors and glass", on, s["color"], s["o"], s["d"], s["weight"])
        s["on"] = s["on"] & (s["steps"] < _MOST_STEPS)
        return (s,)

    return dr.while_loop((start,), lambda s: s["on"], step, label="mirrors and glass")[0]
