"""What one ray sees, as kernels hand it on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from renderers.motion import Place
from renderers.surface import Surface


@dataclass
class Sample:
    """A PyTree: what one ray saw. ``color`` = ``surface`` + ``albedo`` * ``light`` where nothing was clamped.

    ``color``: Color3f linear in [0, 65504]; ``light``: what came from sampled lights or ambient occlusion (the noisy
    part). ``hit``: Bool; ``t`` (tracer units, inf: none), ``z``: depth along the camera's axis, world units.
    ``point``, ``normal``, ``normal_geometric``: tracer space, at the ray's time; ``point_local`` in the own space of
    ``mover`` (0: static), ``point_before`` where that place was at t0 (another one only where a mesh deforms).
    ``motion``: Vector2f px (0 unless asked for). ``clamped``: UInt32. ``rays``: UInt32 a kind.
    ``mirrored``: the picture here is mostly a reflection; ``shown``: the reflected hit.
    """

    color: Any
    hit: Any
    t: Any
    z: Any
    point: Any
    point_local: Any
    point_before: Any
    mover: Any
    normal: Any
    normal_geometric: Any
    albedo: Any
    light: Any
    surface: Any
    material: Any
    motion: Any
    clamped: Any
    mirrored: Any
    shown: Place
    direction: Any
    rays: dict[str, Any]


@dataclass
class FirstHit:
    """A PyTree: light leaving the first thing on a ray, without what mirrors and see-through surfaces add.

    ``color``: Color3f; ``hit``: Bool; ``t``: tracer units; ``back``: the face was met from behind; ``shadow``: rays.
    """

    color: Any
    hit: Any
    t: Any
    surface: Surface
    back: Any
    shadow: Any
