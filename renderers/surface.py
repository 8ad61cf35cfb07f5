"""What lies at a hit: position, normals, texture coordinates, footprint. Gathered from flat arrays, whatever it was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from renderers.backend import dr, mi
from renderers.poses import Poses, pose_at

if TYPE_CHECKING:
    from renderers.tracer import RawHit, SceneArrays, Tracer


@dataclass
class Surface:
    """A PyTree. Tracer space unless it says so. ``geometric`` and ``normal`` face the ray's origin; ``point_local`` is
    in the mover's own space; ``point_before`` too: where the place was at t0, another one only where a mesh deforms.
    ``uv_density``: square root of texture area per tracer area (0 without coordinates). ``color``: vertex colour
    (Vector4f; 1 without).
    """

    point: Any
    point_local: Any
    point_before: Any
    normal: Any
    geometric: Any
    uv: Any
    uv_density: Any
    material: Any
    color: Any


def surface_at(
    tracer: Tracer, arrays: SceneArrays, poses: Poses, hit: RawHit, d: Any, time_s: Any, active: Any
) -> Surface:
    """The surface of ``hit`` for a ray of direction ``d`` at ``time_s``."""
    needs = tracer.needs
    face = dr.gather(mi.Vector4u, arrays.faces, hit.face, active)
    index = (face.x, face.y, face.z)
    a, b, c = (dr.gather(mi.Vector4f, arrays.vertices, i * 2, active) for i in index)
    pa, pb, pc = (mi.Point3f(v.x, v.y, v.z) for v in (a, b, c))
    w = 1 - hit.u - hit.v
    # Position from barycentrics: a few ulps, whatever the distance.
    local = pa + (pb - pa) * hit.u + (pc - pa) * hit.v
    before = _place_before(tracer, arrays, hit, index, local, active) if needs.deforming else local
    across = dr.cross(pb - pa, pc - pa)
    point, geometric = mi.Point3f(local), mi.Vector3f(across)
    pose = None
    if tracer.bodies:
        pose = pose_at(poses, hit.mover, time_s, active)
        point, geometric = pose.point(local), mi.Vector3f(pose.normal(across))
    length = dr.norm(geometric)
    geometric = dr.select(length > 0, geometric * dr.rcp(length), -d)
    geometric = dr.select(dr.dot(geometric, d) > 0, -geometric, geometric)
    normal, uv, density = geometric, mi.Point2f(0), mi.Float(0)
    if needs.normals or needs.textures:
        na, nb, nc = (dr.gather(mi.Vector4f, arrays.vertices, i * 2 + 1, active) for i in index)
    if needs.normals:
        smooth = mi.Vector3f(*(na[k] * w + nb[k] * hit.u + nc[k] * hit.v for k in range(3)))
        if pose is not None:
            smooth = mi.Vector3f(pose.normal(smooth))
        size = dr.norm(smooth)
        normal = dr.select(size > 1e-6, smooth * dr.rcp(size), geometric)
        # A shading normal looks to the side that the ray came from, as the face does.
        normal = dr.select(dr.dot(normal, geometric) < 0, -normal, normal)
    if needs.textures:
        ua, ub, uc = mi.Point2f(a.w, na.w), mi.Point2f(b.w, nb.w), mi.Point2f(c.w, nc.w)
        uv = mi.Point2f(ua * w + ub * hit.u + uc * hit.v)
        du, dv = ub - ua, uc - ua
        texture_area = dr.abs(du.x * dv.y - du.y * dv.x)
        density = dr.sqrt(dr.select(length > 0, texture_area * dr.rcp(length), 0))
    color = mi.Vector4f(1)
    if needs.colors:
        ca, cb, cc = (dr.gather(mi.Vector4f, arrays.colors, i, active) for i in index)
        color = ca * w + cb * hit.u + cc * hit.v
    return Surface(point, local, before, mi.Normal3f(normal), mi.Normal3f(geometric), uv, density, face.w, color)


def _place_before(
    tracer: Tracer, arrays: SceneArrays, hit: RawHit, index: tuple[Any, ...], local: Any, active: Any
) -> Any:
    """Where the place of a hit was at t0: ``local`` but on meshes that deform."""
    run = tracer.geometry.deforming
    if run is None or arrays.before is None:
        return local
    bends = active & (hit.face - run.first_face < run.faces)  # unsigned: smaller numbers wrap to large ones
    a, b, c = (dr.gather(mi.Vector4f, arrays.before, i - run.first_vertex, bends) for i in index)
    pa, pb, pc = (mi.Point3f(v.x, v.y, v.z) for v in (a, b, c))
    return dr.select(bends, pa + (pb - pa) * hit.u + (pc - pa) * hit.v, local)


def met_from_behind(
    tracer: Tracer, arrays: SceneArrays, poses: Poses, hit: RawHit, d: Any, time_s: Any, active: Any
) -> Any:
    """Whether a ray of direction ``d`` met the back of its face (fronts are counter-clockwise)."""
    face = dr.gather(mi.Vector4u, arrays.faces, hit.face, active)
    a, b, c = (dr.gather(mi.Vector4f, arrays.vertices, i * 2, active) for i in (face.x, face.y, face.z))
    pa, pb, pc = (mi.Point3f(v.x, v.y, v.z) for v in (a, b, c))
    across = mi.Vector3f(dr.cross(pb - pa, pc - pa))
    if tracer.bodies:
        across = mi.Vector3f(pose_at(poses, hit.mover, time_s, active).normal(across))
    return dr.dot(across, d) > 0
