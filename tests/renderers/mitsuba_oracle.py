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


def block_z(ours: np.ndarray, theirs: np.ndarray, block_px: int = 8) -> np.ndarray:
    """|z| of each block's mean: ``ours`` and ``theirs`` are (R, H, W, 3) independent renders; rounding 5e-4."""
    a, b = (np.array([block_means(picture, block_px) for picture in pictures]) for pictures in (ours, theirs))
    return z_of_means(a, b, 5e-4)


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
