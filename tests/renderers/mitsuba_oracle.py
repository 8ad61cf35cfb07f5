"""Pictures by Mitsuba's own integrators, for comparison with the engine's."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from renderers.backend import mi
from renderers.clip_frames import view_at
from renderers.engine import Engine
from renderers.frozen import opaque_float
from renderers.mitsuba_scene import mitsuba_scene
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


def block_z(ours: np.ndarray, theirs: np.ndarray, block_px: int = 8) -> np.ndarray:
    """|z| of each block's mean: ``ours`` and ``theirs`` are (R, H, W, 3) independent renders; variance of block means
    over the R renders of both (at least that of half-float rounding)."""

    def means(pictures: np.ndarray) -> np.ndarray:
        r, h, w, _ = pictures.shape
        cut = pictures[:, : h // block_px * block_px, : w // block_px * block_px]
        return cut.reshape(r, h // block_px, block_px, w // block_px, block_px, 3).mean(axis=(2, 4, 5))

    a, b = means(ours), means(theirs)
    variance = a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b)
    floor = (5e-4 * (np.abs(b.mean(axis=0)) + 1e-3)) ** 2
    return np.abs(a.mean(axis=0) - b.mean(axis=0)) / np.sqrt(variance + floor)


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
