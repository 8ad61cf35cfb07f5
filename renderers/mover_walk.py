"""Which movers does a ray meet, and which is the nearest? One walk for nearest hits and for shadows.

Up to `ASK_ALL` bodies every ray asks every body; with more it walks from box to box of the proxy scene and asks the
bodies whose boxes it enters (`renderers.proxy`). A body is asked in its own space, at the ray's own time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from renderers.backend import dr, mi
from renderers.poses import Poses, exists_at, pose_at
from renderers.proxy import STEP, must_ask

if TYPE_CHECKING:
    from renderers.tracer import SceneArrays, Tracer

Asker = Callable[[Any, Any, Any, Any], tuple[Any, ...]]
"""(origin, direction, farthest, active) in a body's own space -> distance (inf: none) and face, u, v of its hit."""
Found = tuple["RawHit", ...]
"""The nearest hit so far; empty for shadows."""


@dataclass
class RawHit:
    """A PyTree: tracer-space ``t`` (inf: none), global ``face``, barycentrics ``u``, ``v`` of its 2nd and 3rd vertex,
    ``mover`` (0: static)."""

    t: Any
    face: Any
    u: Any
    v: Any
    mover: Any

    @property
    def valid(self) -> Any:
        """Whether anything was hit."""
        return self.t < dr.inf


@dataclass(frozen=True)
class Question:
    """What rays ``o + t d`` (tracer space) at ``time_s`` relative to t1 ask of every mover.

    ``shadow``: only whether anything that casts shadows is hit, else what is hit first. ``coherent``: neighbouring
    lanes go one way.
    """

    o: Any
    d: Any
    time_s: Any
    shadow: bool
    coherent: bool


def nearest_asker(scene: Any, coherent: bool) -> Asker:
    """Asks a body's Mitsuba scene for the nearest hit."""

    def ask(o: Any, d: Any, farthest: Any, active: Any) -> tuple[Any, ...]:
        found = scene.ray_intersect_preliminary(mi.Ray3f(o, d, farthest, 0.0, []), coherent=coherent, active=active)
        t = dr.select(active & found.is_valid(), found.t, dr.inf)
        return t, found.prim_index, found.prim_uv.x, found.prim_uv.y

    return ask


def shadow_asker(scene: Any, coherent: bool) -> Asker:
    """Asks whether anything is hit: a distance of -1, nearer than all, ends the ray."""

    def ask(o: Any, d: Any, farthest: Any, active: Any) -> tuple[Any, ...]:
        hit = scene.ray_test(mi.Ray3f(o, d, farthest, 0.0, []), coherent=coherent, active=active)
        return (dr.select(active & hit, mi.Float(-1), dr.inf),)

    return ask


def _no_shadow(o: Any, d: Any, farthest: Any, active: Any) -> tuple[Any, ...]:
    """The answer of a body that casts no shadow."""
    return (mi.Float(dr.inf),)


def past_movers(
    tracer: Tracer, arrays: SceneArrays, poses: Poses, question: Question, active: Any, farthest: Any, found: Found
) -> tuple[Any, Found]:
    """``farthest`` and ``found`` (the hit there), or what a mover puts before them; for shadows -1 where one blocks.

    Called inside kernels.
    """
    scenes = tracer.casting(arrays)[1] if question.shadow else arrays.bodies
    make = shadow_asker if question.shadow else nearest_asker
    askers: list[Asker] = [_no_shadow if scene is None else make(scene, question.coherent) for scene in scenes]
    if tracer.uses_proxy:
        return _walk(tracer, arrays, poses, question, active, farthest, found, askers)
    for body, asker in zip(tracer.bodies, askers, strict=True):
        if asker is not _no_shadow:
            on = active & (farthest > 0) if question.shadow else active
            o, d, on = _own_ray(tracer, poses, question, body.mover, on)
            answer = asker(o, d, farthest, on)
            farthest, found = _nearer(answer, on, farthest, found, body.face_base, body.mover)
    return farthest, found


def _own_ray(tracer: Tracer, poses: Poses, question: Question, mover: Any, active: Any) -> tuple[Any, Any, Any]:
    """The ray in the mover's own space, and whether the mover exists at the ray's time."""
    inverse = pose_at(poses, mi.UInt32(mover), question.time_s, active).inverse()
    if tracer.needs.appearing:
        active = active & exists_at(poses, mi.UInt32(mover), question.time_s, active)  # a new mask: it is the caller's
    return inverse.point(question.o), inverse.vector(question.d), active


def _nearer(
    answer: tuple[Any, ...], active: Any, farthest: Any, found: Found, face_base: Any, mover: Any
) -> tuple[Any, Found]:
    hit = active & (answer[0] < farthest)
    for best in found:
        t, face, u, v = answer
        found = (dr.select(hit, RawHit(t, face + face_base, u, v, mi.UInt32(mover)), best),)
    return dr.select(hit, answer[0], farthest), found


def _next_box(
    arrays: SceneArrays, question: Question, walked: Any, farthest: Any, asked: Any, active: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """The next box face beyond ``walked``: is there one, how far, its body, must it be asked; bits of the asked."""
    o, d = question.o, question.d
    ray = mi.Ray3f(dr.fma(d, walked, o), d, farthest - walked, 0.0, [])
    found = arrays.proxy.ray_intersect_preliminary(ray, coherent=question.coherent, active=active)
    ok = active & found.is_valid()
    body = dr.select(ok, found.prim_index // 12, 0)
    bit = mi.UInt64(1) << mi.UInt64(body & 63)
    ask = ok & (must_ask(arrays.boxes, body, found.prim_index - body * 12, o, d, ok) | ((asked & bit) == 0))
    return ok, walked + found.t, body, ask, dr.select(ask, asked | bit, asked)


def _walk(
    tracer: Tracer, arrays: SceneArrays, poses: Poses, question: Question, active: Any, farthest: Any, found: Found,
    askers: list[Asker],
) -> tuple[Any, Found]:  # fmt: skip
    """From box to box until the next one is behind the nearest hit."""

    def step(walked: Any, farthest: Any, found: Found, asked: Any, on: Any) -> tuple[Any, ...]:
        ok, at, body, ask, asked = _next_box(arrays, question, walked, farthest, asked, on)
        mover = dr.gather(mi.UInt32, arrays.body_mover, body, ask)
        o, d, ask = _own_ray(tracer, poses, question, mover, ask)
        answer = dr.switch(body, askers, o, d, farthest, active=ask)
        base = dr.gather(mi.UInt32, arrays.body_face_base, body, ask) if found else 0
        farthest, found = _nearer(answer, ask, farthest, found, base, mover)
        walked = at + STEP * (1 + at)
        return walked, farthest, found, asked, ok & (walked < farthest)

    start = (mi.Float(0), mi.Float(farthest), found, mi.UInt64(0), active)
    label = "shadow movers" if question.shadow else "movers"
    end = dr.while_loop(start, lambda walked, farthest, found, asked, on: on, step, label=label)
    return end[1], end[2]
