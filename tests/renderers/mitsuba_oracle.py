"""Pictures by Mitsuba's own integrators, for comparison with the engine's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from fractions import Fraction
from typing import Any

import numpy as np

from renderers import shading, whitted
from renderers.backend import dr, mi
from renderers.camera import Ray
from renderers.clip_frames import view_at
from renderers.engine import Engine, EngineState
from renderers.frozen import opaque_float
from renderers.mitsuba_scene import mitsuba_scene
from renderers.parameters import Reference
from renderers.reference import ReferenceRenderer
from renderers.vanilla import frame_lanes
from stimuli.scene import Scene


def centre_pictures(subject: Scene, size_px: tuple[int, int], time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) colours of the engine and of `direct` for the same rays through pixel centres (one point-like light:
    no randomness in either)."""
    engine = Engine(subject)
    _, x, y = frame_lanes(size_px)
    view = view_at(0, Fraction(240), Fraction(time_s), size_px, subject.camera)
    state = engine.state(view)
    ray = engine.camera_ray(state, x, y)
    ours = engine.sample(state, ray).color.numpy().T
    theirs_scene = mitsuba_scene(subject, engine.space, size_px, float(view.t1))
    integrator = mi.load_dict({"type": "direct", "emitter_samples": 1, "bsdf_samples": 0})
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(0, size_px[0] * size_px[1])
    theirs = integrator.sample(theirs_scene, sampler, mi.RayDifferential3f(ray.o, ray.d))[0].numpy().T
    return ours, theirs


def block_means(picture: np.ndarray, block_px: int = 8) -> np.ndarray:
    """(H // block, W // block) means of a picture (H, W, 3) over its blocks and channels."""
    h, w, channels = picture.shape
    cut = np.asarray(picture, np.float64)[: h // block_px * block_px, : w // block_px * block_px]
    return cut.reshape(h // block_px, block_px, w // block_px, block_px, channels).mean(axis=(1, 3, 4))


def z_of_means(ours: np.ndarray, theirs: np.ndarray, floor: float) -> np.ndarray:
    """|z| of each block: ``ours`` and ``theirs`` (R, rows, columns) are block means of R independent renders each.

    Their spread over the renders gives the standard error; ``floor`` (relative) is added to it for rounding.
    """
    variance = ours.var(axis=0, ddof=1) / len(ours) + theirs.var(axis=0, ddof=1) / len(theirs)
    rounding = floor * (np.abs(theirs.mean(axis=0)) + 1e-3)
    return np.abs(ours.mean(axis=0) - theirs.mean(axis=0)) / np.sqrt(variance + rounding**2)


class Narrow(Engine):
    """An engine whose camera rays have cones ``cone`` pixels wide (0: textures are looked up at level 0)."""

    cone = 0.0

    def camera_ray(self, state: EngineState, x_px: Any, y_px: Any, time_s: Any = 0.0) -> Ray:
        """The ray of `Engine.camera_ray` with the narrow cone."""
        ray = super().camera_ray(state, x_px, y_px, time_s)
        spread = ray.spread * self.cone if self.cone else mi.Float(0)
        return Ray(ray.o, ray.d, mi.Float(0), spread)


@contextmanager
def mitsubas_starts(engine: Engine) -> Iterator[None]:
    """Secondary rays start where Mitsuba's `offset_p` and `spawn_ray_to` start them, and end where those end (lights at
    a finite distance)."""
    shifted: list[Any] = []
    ray_epsilon, shadow_epsilon = float(mi.math.RayEpsilon), float(mi.math.ShadowEpsilon)
    plain_start, plain_occluded = shading.start_point, engine.tracer.occluded

    def start_point(surface: Any, side: Any) -> Any:
        p = surface.point
        size = 1 + dr.maximum(dr.abs(p.x), dr.maximum(dr.abs(p.y), dr.abs(p.z)))
        shift = mi.Vector3f(side) * (size * ray_epsilon)
        shifted.append(shift)  # kept: freeing one while another recording is made aborts
        return p + shift

    def occluded(
        arrays: Any, poses: Any, o: Any, d: Any, time_s: Any, active: Any, tmax: Any, coherent: bool = False
    ) -> Any:
        away = (o - shifted[-1]) + d * tmax - o  # towards the light from the new start
        length = dr.norm(away)
        end = length * (1 - shadow_epsilon)
        return plain_occluded(arrays, poses, o, away / length, time_s, active, end, coherent)

    shading.start_point = whitted.start_point = start_point  # type: ignore[assignment]
    engine.tracer.occluded = occluded  # type: ignore[method-assign]
    try:
        yield
    finally:
        shading.start_point = whitted.start_point = plain_start  # type: ignore[assignment]
        engine.tracer.occluded = plain_occluded  # type: ignore[method-assign]


def our_means(
    subject: Scene,
    size_px: tuple[int, int],
    time_s: float,
    spp: int,
    runs: int,
    cone_px: float = 0.0,
    as_mitsuba: bool = True,
) -> np.ndarray:
    """(runs, rows, columns) block means of independent renders by the technique `reference`.

    ``cone_px``: width of the cones that textures are looked up by (0: level 0). ``as_mitsuba``: `mitsubas_starts`.
    """
    engine = Narrow(subject)
    engine.cone = cone_px * spp**0.5  # the technique narrows cones by its samples a pixel
    renderer = ReferenceRenderer(engine, size_px, Reference(spp=spp), 0, "total")
    view = view_at(0, Fraction(240), Fraction(time_s), size_px, subject.camera)
    means = []
    with mitsubas_starts(engine) if as_mitsuba else nullcontext():
        for seed in range(runs):
            renderer.reset(seed)
            means.append(block_means(renderer.render(view).color))
    return np.array(means)


def emitter_quad(corner: object, u: object, v: object, image: np.ndarray, space: Any, flip: bool) -> dict[str, Any]:
    """A rectangle that emits the sRGB picture ``image`` (row 0 at v = 0) along u x v, or against it (``flip``)."""
    corner, u, v = (np.asarray(value, float) for value in (corner, u, v))
    points = space.points(np.array([corner, corner + u, corner + u + v, corner + v]))
    properties = mi.Properties()
    bitmap = mi.Bitmap(np.ascontiguousarray(image[::-1, :, :3]))
    bitmap.set_srgb_gamma(True)
    radiance = {"type": "bitmap", "bitmap": bitmap, "filter_type": "bilinear", "wrap_mode": "repeat"}
    properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}})
    mesh = mi.Mesh("emitter", 4, 2, properties, False, True)
    values = mi.traverse(mesh)
    values["vertex_positions"] = opaque_float(points)
    values["faces"] = mi.UInt32([0, 2, 1, 0, 3, 2] if flip else [0, 1, 2, 0, 2, 3])
    values["vertex_texcoords"] = opaque_float([[0, 1], [1, 1], [1, 0], [0, 0]])
    values.update()
    return mesh
