"""Closed rooms whose bounced light is known."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from renderers.backend import mi
from renderers.clip_frames import view_at
from renderers.engine import Engine, EngineState
from renderers.parameters import Probes
from renderers.polar import probe_maps
from stimuli.scene import Light, Material, Part, Phong, Scene
from tests.renderers.scenes import scene_of
from tests.renderers.scenes_by_hand import box, look_at, pbr, quad

RATE = Fraction(60)


def wall(color: tuple, emission: float = 0.0, **values: object) -> Material:
    """A diffuse one-sided surface."""
    shown = pbr(color, emissiveFactor=np.full(3, emission), **values)
    return Material("wall", shown, phong=Phong((0, 0, 0), color, (0, 0, 0), 1.0))


def furnace(albedo: float, emission: float) -> Scene:
    """A box (its faces look inwards) whose every point emits and reflects: radiance emission / (1 - albedo)."""
    return scene_of(box((0, 0, 0), (1, 1, 1), wall((albedo,) * 3, emission)))


def cornell(divide: bool = False) -> Scene:
    """White room, red left and green right wall, an area light below the ceiling; the front is closed and white."""
    white, red, green = (wall(c) for c in ((0.7, 0.7, 0.7), (0.65, 0.05, 0.05), (0.05, 0.6, 0.08)))
    parts = [
        quad((-1, -1, 1), (2, 0, 0), (0, 0, -2), white, "floor"),
        quad((-1, 1, -1), (2, 0, 0), (0, 0, 2), white, "ceiling"),
        quad((-1, -1, -1), (2, 0, 0), (0, 2, 0), white, "back"),
        quad((1, -1, 1), (-2, 0, 0), (0, 2, 0), white, "front"),
        quad((-1, -1, 1), (0, 0, -2), (0, 2, 0), red, "left"),
        quad((1, -1, -1), (0, 0, 2), (0, 2, 0), green, "right"),
    ]
    if divide:
        parts.append(quad((0, -1, 1), (0, 0, -2), (0, 2, 0), wall((0.7,) * 3, doubleSided=True), "divider"))
        corner, edge = (-0.8, 0.98, -0.2), (0.4, 0, 0)
    else:
        corner, edge = (-0.25, 0.98, -0.25), (0.5, 0, 0)
    light = Light("area", (8.0,) * 3, direction=(0, -1, 0), corner=corner, edge_u=edge, edge_v=(0, 0, 0.5))
    return scene_of(*parts, lights=(light,), camera=look_at((0, 0, 0.95), (0, -0.2, 0), 80.0))


def probed(scene: Scene, **settings: object) -> Engine:
    """An engine with probes of these settings and no short rays unless asked for."""
    return Engine(scene).with_probes(Probes(**{"occlusion_rays": 0, "grid": (4, 4, 4), **settings}))


def state_at(engine: Engine, k: int, size_px: tuple[int, int] = (8, 8), cut: bool = False) -> EngineState:
    """The engine's state at frame k, its probes advanced."""
    return engine.state(view_at(k, RATE, Fraction(0), size_px, engine.scene.camera, cut=cut))


def irradiance_at(engine: Engine, state: EngineState, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N, 3) irradiance / pi that the probes give at world ``points`` with ``normals`` (eye along the normal)."""
    where = mi.Point3f(engine.space.points(np.asarray(points, float)).T.astype(np.float32))
    n = mi.Vector3f(np.asarray(normals, np.float32).T)
    found = probe_maps.irradiance_at(engine.indirect.settings, state.indirect, where, n, n, mi.Bool(True))
    return np.array(found.numpy()).T


def parts_named(scene: Scene, name: str) -> Part:
    """The static part called ``name``."""
    return next(part for part in scene.static if part.name == name)
