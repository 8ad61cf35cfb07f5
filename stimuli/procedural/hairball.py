"""A ball of curled hairs, a stand-in for Hairball: half a million thin triangles, depth complexity everywhere."""

from __future__ import annotations

import numpy as np

from stimuli.procedural.shapes import Mesh, checkerboard, generator, grid, matte, part, recipe_sha256, rectangle
from stimuli.procedural.tracks import round_trip
from stimuli.scene import Light, Scene

VERSION = 1
DURATION_S = 8.0
STRANDS, STEPS, SIDES = 1_400, 48, 4
BALL_M, HAIR_M = 1.0, 0.004


def hair(rng: np.random.Generator) -> Mesh:
    """STRANDS tubes of SIDES faces: helical walks that grow from a core and stay near the ball."""
    start = rng.normal(size=(STRANDS, 3))
    start *= 0.25 * BALL_M / np.linalg.norm(start, axis=1, keepdims=True)
    outward = start / np.linalg.norm(start, axis=1, keepdims=True)
    side = np.cross(outward, rng.normal(size=(STRANDS, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    third = np.cross(outward, side)
    t = np.linspace(0.0, 1.0, STEPS)[None, :, None]
    phase, turns = rng.uniform(0, 2 * np.pi, (STRANDS, 1, 1)), rng.uniform(0.6, 2.2, (STRANDS, 1, 1))
    curl = rng.uniform(0.15, 0.45, (STRANDS, 1, 1)) * BALL_M
    angle = phase + 2 * np.pi * turns * t
    reach = rng.uniform(0.6, 1.0, (STRANDS, 1, 1)) * BALL_M
    grow = start[:, None] + outward[:, None] * (reach * np.sin(t * np.pi / 2))
    swirl = curl * t * (np.cos(angle) * side[:, None] + np.sin(angle) * third[:, None])
    centre = grow + swirl
    tangent = np.gradient(centre, axis=1)
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    across = np.cross(tangent, outward[:, None] + 1e-3)
    across /= np.linalg.norm(across, axis=2, keepdims=True)
    other = np.cross(tangent, across)
    # Neighbouring rings keep their corners in step: the frame follows the outward direction, which is one a strand.
    ring = np.linspace(0.0, 2 * np.pi, SIDES + 1)
    normals = np.cos(ring)[:, None] * across[:, :, None] + np.sin(ring)[:, None] * other[:, :, None]
    thin = HAIR_M * (1.0 - 0.7 * t)[..., None]
    points = (centre[:, :, None] + thin * normals).reshape(STRANDS, -1, 3)
    one = grid(points[0].reshape(STEPS, SIDES + 1, 3), np.zeros((STEPS, SIDES + 1, 2))).indices
    count = STEPS * (SIDES + 1)
    indices = (one[None] + count * np.arange(STRANDS)[:, None, None]).reshape(-1, 3)
    positions, flat = points.reshape(-1, 3), normals.reshape(-1, 3)
    corner = positions[indices]
    facing = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    if np.mean(np.sum(facing * flat[indices[:, 0]], axis=1) > 0) < 0.5:
        indices = indices[:, ::-1]
    return Mesh(positions, flat, np.zeros((len(positions), 2)), indices)


def build() -> Scene:
    """The scene: the ball over a floor, one area light and one point light, a camera that circles it."""
    tiles = checkerboard(128, 8, (0.3, 0.32, 0.35), (0.7, 0.7, 0.68))
    floor = rectangle((-4, -1.5, 4), (8, 0, 0), (0, 0, -8), (4, 4))
    return Scene(
        name="hairball",
        static=(
            part("hair", hair(generator("hairball")), matte("hair", (0.5, 0.28, 0.13), roughness=0.5)),
            part("floor", floor, matte("tiles", (1.0, 1.0, 1.0), tiles)),
        ),
        movers=(),
        lights=(
            Light(
                "area",
                (9.0, 8.7, 8.0),
                position=(1.5, 3.0, 1.5),
                direction=(0.0, -1.0, 0.0),
                corner=(0.9, 3.0, 0.9),
                edge_u=(1.2, 0.0, 0.0),
                edge_v=(0.0, 0.0, 1.2),
                name="panel",
            ),
            Light("point", (6.0, 7.0, 9.0), (-3.0, 1.0, 1.0), name="fill"),
        ),
        camera=round_trip(
            "circle",
            DURATION_S,
            45.0,
            lambda a: (3.2 * np.sin(a), 0.8 + 0.3 * np.sin(a), 3.2 * np.cos(a)),
            lambda a: (0.0, 0.0, 0.0),
        ),
        sha256=recipe_sha256("hairball", VERSION),
        ambient=(0.08, 0.08, 0.09),
        background=(0.1, 0.11, 0.13),
        duration_s=DURATION_S,
    )
