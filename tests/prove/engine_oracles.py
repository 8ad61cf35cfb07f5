"""The ray engine at full length: depth of every mesh against float64 and against a rasteriser, direct light and mirrors
against Mitsuba, the cost of 156 movers, the bench. ``python -m tests.prove.engine_oracles`` writes
evidence/engine_oracles.json.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from renderers import Tracer
from renderers.backend import dr, mi
from renderers.bench_whitted import measure_whitted
from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.frozen import frozen
from renderers.mitsuba_scene import diffuse_only
from renderers.vanilla import frame_lanes
from stimuli import load_scene
from stimuli.scene import Light, Part, Primitive, Scene
from tests.evidence import write_evidence
from tests.renderers.float64_tracer import nearest, world_triangles
from tests.renderers.mitsuba_oracle import centre_pictures

SIZE_PX = (512, 288)
MSAA_PLACES = ((0.5, 0.5), (0.375, 0.125), (0.875, 0.375), (0.125, 0.625), (0.625, 0.875),
               (0.375, 0.875), (0.875, 0.625), (0.125, 0.375), (0.625, 0.125))  # fmt: skip
FILES = {
    "kitchen": "bart_kitchen/bart_kitchen.glb",
    "robots": "bart_robots/bart_robots.glb",
    "sponza": "sponza_dabrovic/sponza.glb",
}


def pixel_rays(
    scene: Scene, time_s: float, size_px: tuple[int, int], within: tuple[float, float] = (0.5, 0.5)
) -> tuple[np.ndarray, np.ndarray]:
    """World origins and unit directions through all pixels (at ``within`` of each), scanline order."""
    pose = scene.camera.pose(np.array([time_s]))[0]
    x, y = np.meshgrid(np.arange(size_px[0]) + within[0], np.arange(size_px[1]) + within[1])
    pixel = 2 * np.tan(scene.camera.yfov_rad / 2) / size_px[1]
    local = np.stack([(x - size_px[0] / 2) * pixel, (size_px[1] / 2 - y) * pixel, -np.ones_like(x)], -1).reshape(-1, 3)
    direction = local @ pose[:3, :3].T
    return np.tile(pose[:3, 3], (len(direction), 1)), direction / np.linalg.norm(direction, axis=1, keepdims=True)


def every_mesh(scene: Scene, time_s: float) -> dict[str, float]:
    """Depth against float64 on 300 seeded pixels and on one ray to the middle of a triangle of every mesh."""
    tracer = Tracer(scene)
    origin, direction = pixel_rays(scene, time_s, SIZE_PX)
    pick = np.random.default_rng(0).choice(len(origin), 300, replace=False)
    groups = [(np.eye(4), scene.static), *((m.track.pose(np.array([time_s]))[0], m.parts) for m in scene.movers)]
    middles = []
    for matrix, parts in groups:
        for part in parts:
            faces = np.asarray(part.primitive.indices).reshape(-1, 3).astype(int)
            full = matrix @ part.matrix
            middles.append(full[:3, :3] @ part.positions[faces[len(faces) // 2]].mean(axis=0) + full[:3, 3])
    towards = np.array(middles) - origin[0]
    o = np.concatenate([origin[pick], np.tile(origin[0], (len(middles), 1))])
    d = np.concatenate([direction[pick], towards / np.linalg.norm(towards, axis=1, keepdims=True)])
    triangles, _ = world_triangles(scene, time_s)
    t = np.array([nearest(triangles, a, b)[0] for a, b in zip(o, d, strict=True)])
    got = tracer.trace(o, d, time_s).t
    hit = np.isfinite(t) & np.isfinite(got)
    off = np.abs(got[hit] - t[hit]) / t[hit]
    return {
        "rays": len(t), "meshes": len(middles), "worst_relative": float(off.max()),
        "beyond_1e-4": int((off > 1e-4).sum()), "hit_differs": int((np.isfinite(t) != np.isfinite(got)).sum()),
    }  # fmt: skip


def raster_depth(path: str, time_s: float, size_px: tuple[int, int], near_m: float, queue: Any) -> None:
    """In a child process: pyrender's depth buffer of the scene, metres along the axis."""
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    import pyrender

    scene = load_scene(path)
    picture = pyrender.Scene()
    groups = [(np.eye(4), scene.static), *((m.track.pose(np.array([time_s]))[0], m.parts) for m in scene.movers)]
    radius = 0.0
    for matrix, parts in groups:
        for part in parts:
            full = matrix @ part.matrix
            primitive = pyrender.Primitive(
                positions=part.positions.astype(np.float32), mode=4,
                indices=np.asarray(part.primitive.indices).astype(np.uint32),
                material=pyrender.MetallicRoughnessMaterial(doubleSided=True),
            )  # fmt: skip
            picture.add(pyrender.Mesh([primitive]), pose=full)
            points = part.positions @ full[:3, :3].T + full[:3, 3]
            radius = max(radius, float(np.abs(points).max()))
    camera = pyrender.PerspectiveCamera(yfov=scene.camera.yfov_rad, znear=near_m, zfar=radius * 4)
    picture.add(camera, pose=scene.camera.pose(np.array([time_s]))[0])
    renderer = pyrender.OffscreenRenderer(*size_px)
    queue.put(renderer.render(picture, flags=pyrender.RenderFlags.DEPTH_ONLY | pyrender.RenderFlags.SKIP_CULL_FACES))


def against_raster(path: Path, scene: Scene, time_s: float) -> dict[str, float]:
    """Share of pixels whose depth is within 1e-3 of the rasteriser's, which keeps one multisample place a pixel: the
    share at the place that agrees best is taken."""
    axis = -scene.camera.pose(np.array([time_s]))[0][:3, 2]
    depths = []
    tracer = Tracer(scene)
    for within in MSAA_PLACES:
        origin, direction = pixel_rays(scene, time_s, SIZE_PX, within)
        hits = tracer.trace(origin, direction, time_s)
        depths.append(np.where(np.isfinite(hits.t), hits.t * (direction @ axis), 0.0).reshape(SIZE_PX[::-1]))
    z = np.array(depths)
    # A near plane just before the nearest thing: the rasteriser's depth is coarse far behind its near plane.
    near_m = 0.9 * float(z[z > 0].min())
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    child = context.Process(target=raster_depth, args=(str(path), time_s, SIZE_PX, near_m, queue))
    child.start()
    raster = queue.get(timeout=120)
    child.join()
    close = np.abs(z - raster) <= 1e-3 * np.maximum(raster, 1e-9)
    return {"within_1e-3": float(close.mean(axis=(1, 2)).max())}


def movers_cost(scene: Scene, time_s: float, runs: int = 15) -> dict[str, float]:
    """Primary rays at 960x540: the movers as they are against all bodies baked static, interleaved."""
    parts = list(scene.static)
    for mover in scene.movers:
        matrix = mover.track.pose(np.array([time_s]))[0]
        parts += [replace(part, matrix=matrix @ part.matrix) for part in mover.parts]
    size = (960, 540)
    jobs = []
    for subject in (scene, replace(scene, static=tuple(parts), movers=())):
        engine = Engine(subject)
        _, x, y = frame_lanes(size)
        state = engine.state(view_at(0, Fraction(240), Fraction(time_s), size, scene.camera))

        def primary(state: Any, x: Any, y: Any, engine: Engine = engine) -> Any:
            ray = engine.camera_ray(state, x, y)
            return engine.tracer.nearest(state.arrays, state.poses, ray.o, ray.d, 0.0, True, coherent=True).t

        jobs.append((frozen(primary), state, x, y))
    times = np.zeros((runs + 2, 2))
    for run in range(runs + 2):
        for k, (kernel, *arguments) in enumerate(jobs):
            start_s = time.perf_counter()
            dr.eval(kernel(size[0] * size[1], *arguments))
            dr.sync_thread()
            times[run, k] = time.perf_counter() - start_s
    t = [kernel(size[0] * size[1], *arguments).numpy() for kernel, *arguments in jobs]
    both = np.isfinite(t[0]) & np.isfinite(t[1])
    apart = np.abs(t[0][both] - t[1][both]) > 1e-4 * t[1][both]
    ms = np.median(times[2:], axis=0) * 1e3
    return {
        "movers": len(scene.movers), "movers_ms": float(ms[0]), "baked_ms": float(ms[1]),
        "ratio": float(np.median(times[2:, 0] / times[2:, 1])),
        "pixels_beyond_1e-4": int(apart.sum() + (np.isfinite(t[0]) != np.isfinite(t[1])).sum()),
    }  # fmt: skip


def without_normals(scene: Scene) -> Scene:
    """``scene`` with flat faces: where vertex normals turn away from the eye, Mitsuba lights a face and we do not."""

    def flat(parts: tuple[Part, ...]) -> tuple[Part, ...]:
        return tuple(
            replace(part, primitive=Primitive(positions=part.primitive.positions, indices=part.primitive.indices))
            for part in parts
        )

    movers = tuple(replace(mover, parts=flat(mover.parts)) for mover in scene.movers)
    return replace(scene, static=flat(scene.static), movers=movers)


def lit_in_float64(triangles: np.ndarray, o: np.ndarray, d: np.ndarray, light: np.ndarray) -> bool | None:
    """Whether the light reaches what the ray (o, d) hits: no offset, only the face that was hit is left out.

    None where the ray misses, or where a face lies within 1e-9 of the hit (then which face was hit is chance).
    """
    t, face = nearest(triangles, o, d)
    others = np.delete(triangles, face, axis=0) if face >= 0 else triangles
    if face < 0 or nearest(others, o, d)[0] - t < 1e-9 * t:
        return None
    point = o + t * d
    away = light - point
    distance = float(np.linalg.norm(away))
    return bool(nearest(others, point, away / distance)[0] >= distance)


def against_direct(scene: Scene, time_s: float, size_px: tuple[int, int] = SIZE_PX) -> dict[str, Any]:
    """The same rays under one point light (the scene's own, or one beside the camera): share of pixels more than 1e-3
    from Mitsuba's `direct`, and with whom a float64 reference sides in up to 60 of them, drawn at random.

    One of the two pictures sees such a pixel's light and the other does not: the starts of shadow rays differ.
    """
    subject = diffuse_only(scene, textures=False)
    if len(scene.lights) != 1 or scene.lights[0].kind != "point" or scene.lights[0].falloff == "none":
        radius = Engine(scene).space.radius
        pose = scene.camera.pose(np.array([time_s]))[0]
        place = pose[:3, 3] + 0.1 * radius * pose[:3, 1]
        subject = replace(subject, lights=(Light("point", ((0.1 * radius) ** 2,) * 3, tuple(place)),))
    ours, theirs = centre_pictures(subject, size_px, time_s)
    apart = np.flatnonzero(np.abs(ours - theirs).max(axis=1) > 1e-3 * (1 + theirs.max(axis=1)))
    order = frame_lanes(size_px)[0].numpy()
    origin, direction = pixel_rays(subject, time_s, size_px)
    triangles, _ = world_triangles(subject, time_s)
    light = np.array(subject.lights[0].position)
    sides = {"ours": 0, "Mitsuba's": 0, "neither can be told": 0}
    for k in np.random.default_rng(0).permutation(apart)[:60]:
        lit = lit_in_float64(triangles, origin[order[k]], direction[order[k]], light)
        side = "neither can be told" if lit is None else "ours" if lit == (ours[k].sum() > theirs[k].sum()) else ""
        sides[side or "Mitsuba's"] += 1
    return {"beyond_1e-3": len(apart) / len(ours), "float64_sides_with": sides}


def main() -> int:
    """Everything, to evidence/engine_oracles.json."""
    assets = Path(os.environ.get("STUDYAPP_ASSETS", Path(__file__).parents[3] / "shared" / "assets"))
    found: dict[str, Any] = {}
    for name, file in FILES.items():
        scene = load_scene(str(assets / file))
        time_s = 0.31 * scene.duration_s
        found[name] = {"depth": every_mesh(scene, time_s)}
        found[name]["raster"] = against_raster(assets / file, scene, time_s)
        found[name]["direct"] = against_direct(without_normals(scene), time_s)
        print(name, found[name], flush=True)
    found["tunnel_geom"] = {"direct": against_direct(load_scene("tunnel_geom"), 0.0, (960, 540))}
    print("tunnel_geom", found["tunnel_geom"], flush=True)
    found["movers_cost"] = movers_cost(load_scene(str(assets / FILES["robots"])), 3.0)
    print(found["movers_cost"], flush=True)
    found["bench"] = vars(measure_whitted(load_scene("tunnel_geom")))
    print(found["bench"], flush=True)
    found["variant"] = mi.variant()
    write_evidence("engine_oracles", found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
