"""Mixed reality: virtual objects and their shadows over a picture of the real room (HERR, 3.1 and Fig. 7).

Surfaces whose material is `captured` are the room. They are not drawn: they darken the camera's picture by the share of
light that virtual objects take from them (ratio of the lit room with and without them; differential rendering after
Debevec 1998). The camera's picture is the captured textures themselves, seen by the same eye.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from renderers.backend import dr, mi
from renderers.camera import Ray
from renderers.engine import Engine, EngineState
from renderers.frozen import opaque_uint
from renderers.parameters import Probes
from renderers.samples import Sample
from stimuli.errors import InputError, problem
from stimuli.scene import Scene


def room_of(scene: Scene) -> Scene:
    """``scene`` with its captured surfaces alone, under the same lights. InputError where it has none."""
    static = tuple(part for part in scene.static if part.material.captured)
    if not static:
        raise InputError(
            problem(f"{scene.name}: mixed_reality", "captured surfaces", "none", "a material marked captured (a room)")
        )
    return replace(scene, name=f"{scene.name} (room)", static=static, movers=(), skins=())


class ShadowCatcher:
    """The room beside the whole scene. ``probes``: the room's own bounced light, where the scene has it too."""

    def __init__(self, engine: Engine, probes: Probes | None, seed: int) -> None:
        room = Engine(room_of(engine.scene))
        self.engine = room if probes is None else room.with_probes(probes, seed)
        self.captured = opaque_uint([bool(m.captured) for m in engine.tracer.materials])

    def covered(self, sample: Sample, state: EngineState, ray: Ray, captured: Any, light_samples: int) -> Any:
        """Vector4f of one ray: premultiplied colour of virtual things, and how much of the camera's picture they take.

        ``state``, ``ray``: the room's, in its own tracer space; ``sample``: what the whole scene shows there.
        """
        real = sample.hit & (dr.gather(mi.UInt32, captured, sample.material, sample.hit) == 1)
        alone = self.engine.sample(state, ray, active=real, light_samples=light_samples)
        lit, full = mi.luminance(alone.color), mi.luminance(sample.color)
        left = dr.select(lit > 0, dr.clip(full / dr.maximum(lit, 1e-20), 0, 1), 1)
        virtual = sample.hit & ~real
        c = dr.select(virtual, sample.color, 0)
        taken = dr.select(real, 1 - left, dr.select(virtual, mi.Float(1), mi.Float(0)))
        return mi.Vector4f(c.x, c.y, c.z, taken)

    def camera_picture(self, state: EngineState, ray: Ray) -> Any:
        """Color3f: the capture's texture along a ray (black beside the room)."""
        sample = self.engine.sample(state, ray)
        return dr.select(sample.hit, sample.albedo, 0)


def composited(over: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """(H, W, 3) of ``over`` (H, W, 4; premultiplied) above ``camera`` (H, W, 3)."""
    return over[..., :3] + (1 - over[..., 3:]) * camera
