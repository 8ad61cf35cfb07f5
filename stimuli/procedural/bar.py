"""A bar at night, a stand-in for BISTRO: bottles before a mirror, thin bright strings and neon, chrome, 15 lights.

What matters of the original for aliasing and flicker is here: features thinner than a pixel that are much brighter than
what is round them, mirrors that double them, much geometry, many lights. It is not a copy of it.
"""

from __future__ import annotations

import numpy as np

from stimuli.camera_path import KeyedCamera
from stimuli.procedural.rooms import Room
from stimuli.procedural.shapes import (
    Mesh,
    box,
    boxes,
    checkerboard,
    cylinder,
    generator,
    join,
    lathe,
    matte,
    noise,
    part,
    recipe_sha256,
    rectangle,
    rotation,
    sphere,
    torus,
    tube,
)
from stimuli.procedural.tracks import round_trip
from stimuli.scene import RGB, Light, Part, Scene

VERSION = 1
DURATION_S = 8.0
WIDTH_M, DEPTH_M, HEIGHT_M = 9.0, 6.0, 3.2
_GLASS: tuple[RGB, ...] = ((0.35, 0.75, 0.35), (0.85, 0.55, 0.2), (0.9, 0.92, 0.95), (0.35, 0.5, 0.85))
_LABELS: tuple[RGB, ...] = ((0.85, 0.8, 0.65), (0.7, 0.1, 0.08), (0.1, 0.12, 0.3), (0.9, 0.65, 0.1))


def build() -> Scene:
    """The scene: the counter runs along x, the bottle wall stands at z = -DEPTH / 2, the camera glides before it."""
    rng = generator("bar")
    bulbs, wires = _strings()
    pendants = [(-3.0 + 1.2 * i, 2.15, -1.0) for i in range(6)]
    lights = [
        Light("point", (2.6, 2.0, 1.25), (x, y - 0.1, z), name=f"pendant {i}") for i, (x, y, z) in enumerate(pendants)
    ]
    lights += [
        Light("point", (0.55, 0.4, 0.22), (x, 2.62, z), name=f"string {i}")
        for i, (x, z) in enumerate([(-3.2, 1.2), (-1.1, 1.4), (1.1, 1.2), (3.2, 1.4)])
    ]
    lights += [Light("point", (0.9, 0.12, 0.35), (-2.4, 2.5, -2.6), name="neon pink")]
    lights += [Light("point", (0.1, 0.5, 0.9), (2.6, 2.5, -2.6), name="neon blue")]
    lights += [
        Light(
            "spot", (9.0, 8.0, 6.5), (x, 3.1, -1.9), (0.0, -0.8, -0.6), inner_rad=0.35, outer_rad=0.7, name=f"spot {i}"
        )
        for i, x in enumerate((-2.5, 0.0, 2.5))
    ]
    return Scene(
        name="bar",
        static=(
            *_shell(rng),
            *_counter(rng),
            *_shelves(rng),
            *_stools(),
            *_pendants(pendants),
            part("bulbs", bulbs, matte("bulbs", (1.0, 0.9, 0.7), emissive=(9.0, 6.5, 3.5))),
            part("wires", wires, matte("wires", (0.02, 0.02, 0.02))),
            *_neon(),
        ),
        movers=(),
        lights=tuple(lights),
        camera=_camera(),
        sha256=recipe_sha256("bar", VERSION),
        ambient=(0.03, 0.025, 0.03),
        background=(0.005, 0.006, 0.012),
        duration_s=DURATION_S,
    )


def _shell(rng: np.random.Generator) -> list[Part]:
    room = Room(WIDTH_M, DEPTH_M, HEIGHT_M)
    tiles = checkerboard(256, 2, (0.12, 0.1, 0.1), (0.75, 0.72, 0.68))
    plaster = noise(rng, 256, (0.25, 0.12, 0.1), (0.45, 0.2, 0.16))
    brick = _bricks(rng)
    floor, ceiling = room.floor((15, 10)), room.ceiling((3, 2))
    walls = [room.left_wall((4, 2)), room.right_wall((4, 2)), room.back_wall((6, 2)), room.front_wall((6, 2))]
    return [
        part("floor", floor, matte("floor tiles", (1.0, 1.0, 1.0), tiles, roughness=0.2)),
        part("ceiling", ceiling, matte("plaster", (1.0, 1.0, 1.0), plaster)),
        part("walls", join(walls), matte("brick", (1.0, 1.0, 1.0), brick)),
        part("beams", _beams(), matte("beams", (0.16, 0.09, 0.05))),
    ]


def _bricks(rng: np.random.Generator) -> np.ndarray:
    """(256, 256, 4) codes: eight courses of four bricks, each of its own red, with pale joints."""
    row, column = np.mgrid[0:256, 0:256]
    course = row // 32
    shifted = (column + 32 * (course % 2)) % 256
    tone = rng.uniform(0.7, 1.15, (8, 4))[course, shifted // 64]
    grain = noise(rng, 256, (0.85, 0.85, 0.85), (1.0, 1.0, 1.0))[..., :3] / 255.0
    color = np.array([0.5, 0.24, 0.18]) * tone[..., None] * grain
    joint = (row % 32 < 3) | (shifted % 64 < 3)
    color = np.where(joint[..., None], (0.55, 0.52, 0.48), color)
    codes = np.full((256, 256, 4), 255, np.uint8)
    codes[..., :3] = np.round(np.clip(color, 0.0, 1.0) * 255.0)
    return codes


def _beams() -> Mesh:
    x = np.linspace(-WIDTH_M / 2 + 0.6, WIDTH_M / 2 - 0.6, 7)
    centres = np.stack([x, np.full(7, HEIGHT_M - 0.1), np.zeros(7)], axis=1)
    return boxes(centres, np.tile((0.14, 0.2, DEPTH_M), (7, 1)))


def _counter(rng: np.random.Generator) -> list[Part]:
    wood = noise(rng, 256, (0.16, 0.07, 0.03), (0.45, 0.22, 0.1), slope=1.3)
    panels = boxes(
        np.stack([np.linspace(-3.3, 3.3, 12), np.full(12, 0.5), np.full(12, -0.585)], axis=1),
        np.tile((0.5, 0.8, 0.03), (12, 1)),
    )
    rail_end = [np.array([[x, 0.25, -0.4], [x, 0.25, -0.58]]) for x in np.linspace(-3.5, 3.5, 8)]
    rail = [cylinder(0.025, 7.2, 24).turned(rotation(2, np.pi / 2)).moved((0.0, 0.25, -0.4))]
    rail += [tube(ends, 0.015, 12) for ends in rail_end]
    glasses = join([_wine_glass().moved((x, 1.115, z)) for x, z in _glass_places(rng)])
    taps = join([_tap().moved((x, 1.115, -1.15)) for x in (-0.4, -0.2, 0.0, 0.2, 0.4)])
    return [
        part(
            "counter",
            box((0, 0.54, -1.0), (7.2, 1.08, 0.8)),
            matte("counter wood", (1.0, 1.0, 1.0), wood, roughness=0.5),
        ),
        part(
            "counter top", box((0, 1.095, -1.0), (7.4, 0.04, 0.95)), matte("stone", (0.05, 0.05, 0.06), roughness=0.08)
        ),
        part("panels", panels, matte("panels", (0.22, 0.1, 0.05), roughness=0.4)),
        part("rail", join(rail), matte("brass", (0.85, 0.62, 0.25), roughness=0.12, metallic=1.0)),
        part("glasses", glasses, matte("clear glass", (0.97, 0.98, 1.0), roughness=0.0, transmission=0.9)),
        part("taps", taps, matte("chrome", (0.8, 0.8, 0.82), roughness=0.05, metallic=1.0)),
    ]


def _glass_places(rng: np.random.Generator) -> np.ndarray:
    x = np.linspace(-3.2, 3.2, 26) + rng.uniform(-0.05, 0.05, 26)
    return np.stack([x, rng.uniform(-1.05, -0.68, 26)], axis=1)


def _wine_glass() -> Mesh:
    radius = np.array(
        [
            0.0,
            0.034,
            0.034,
            0.005,
            0.004,
            0.004,
            0.02,
            0.036,
            0.041,
            0.039,
            0.034,
            0.033,
            0.037,
            0.039,
            0.034,
            0.018,
            0.0,
        ]
    )
    height = np.array(
        [0.0, 0.0, 0.003, 0.007, 0.012, 0.085, 0.095, 0.115, 0.14, 0.165, 0.19, 0.19, 0.165, 0.14, 0.117, 0.098, 0.092]
    )
    return lathe(radius, height, 28)


def _tap() -> Mesh:
    neck = np.array([[0, 0, 0], [0, 0.25, 0], [0, 0.33, 0.02], [0, 0.36, 0.06], [0, 0.33, 0.1], [0, 0.27, 0.11]])
    return join(
        [tube(neck, 0.016, 14), cylinder(0.01, 0.14, 12).moved((0, 0.42, 0.0)), sphere(0.02, 10, 16).moved((0, 0.5, 0))]
    )


def _bottle(kind: int) -> tuple[Mesh, Mesh]:
    """Glass and label of one of three shapes, 0.3 m high."""
    body, shoulder = ((0.037, 0.17), (0.042, 0.14), (0.033, 0.2))[kind]
    radius = np.array(
        [0.0, body - 0.004, body, body, body * 0.92, body * 0.6, 0.015, 0.0135, 0.0135, 0.016, 0.016, 0.0]
    )
    height = np.array(
        [
            0.0,
            0.0,
            0.006,
            shoulder,
            shoulder + 0.02,
            shoulder + 0.045,
            shoulder + 0.065,
            shoulder + 0.075,
            0.2765,
            0.278,
            0.3,
            0.3,
        ]
    )
    label = lathe(np.full(2, body + 0.0006), np.array([0.04, shoulder - 0.03]), 28)
    return lathe(radius, height, 28), label


def _shelves(rng: np.random.Generator) -> list[Part]:
    back = -DEPTH_M / 2
    parts = [
        part(
            "mirror",
            rectangle((-3.4, 1.0, back + 0.02), (6.8, 0, 0), (0, 1.45, 0)),
            matte("mirror", (0.95, 0.95, 0.95), roughness=0.0, metallic=1.0),
        )
    ]
    heights = (1.05, 1.5, 1.95)
    boards = [box((0, y - 0.015, back + 0.16), (6.8, 0.03, 0.28)) for y in heights]
    posts = [box((x, 1.7, back + 0.16), (0.04, 1.5, 0.28)) for x in np.linspace(-3.4, 3.4, 6)]
    parts.append(part("shelves", join([*boards, *posts]), matte("shelf", (0.1, 0.06, 0.04), roughness=0.3)))
    strips = [box((0, y - 0.035, back + 0.295), (6.7, 0.006, 0.006)) for y in heights]
    parts.append(part("shelf strips", join(strips), matte("shelf strips", (1, 1, 1), emissive=(5.0, 4.4, 3.2))))
    shapes = [_bottle(kind) for kind in range(3)]
    glass: list[list[Mesh]] = [[] for _ in _GLASS]
    labels: list[list[Mesh]] = [[] for _ in _LABELS]
    for y in heights:
        for x in np.arange(-3.3, 3.31, 0.115):
            if np.min(np.abs(x - np.linspace(-3.4, 3.4, 6))) < 0.07 or rng.random() < 0.08:
                continue
            kind, tint, paper = rng.integers(3), rng.integers(len(_GLASS)), rng.integers(len(_LABELS))
            place = (x + rng.uniform(-0.012, 0.012), y, back + rng.uniform(0.1, 0.22))
            turn = rotation(1, rng.uniform(0, 2 * np.pi))
            glass[tint].append(shapes[kind][0].turned(turn).moved(place))
            labels[paper].append(shapes[kind][1].turned(turn).moved(place))
    for i, (color, meshes) in enumerate(zip(_GLASS, glass, strict=True)):
        parts.append(
            part(f"bottles {i}", join(meshes), matte(f"bottle glass {i}", color, roughness=0.03, transmission=0.6))
        )
    for i, (color, meshes) in enumerate(zip(_LABELS, labels, strict=True)):
        stripes = checkerboard(64, 8, (color[0] * 0.5, color[1] * 0.5, color[2] * 0.5), color)
        parts.append(part(f"labels {i}", join(meshes), matte(f"label {i}", (1.0, 1.0, 1.0), stripes)))
    return parts


def _stools() -> list[Part]:
    seats, legs = [], []
    for x in np.linspace(-3.0, 3.0, 6):
        seats.append(cylinder(0.18, 0.07, 36).moved((x, 0.74, 0.0)))
        legs += [cylinder(0.02, 0.7, 20).moved((x, 0.35, 0.0)), cylinder(0.17, 0.02, 36).moved((x, 0.01, 0.0))]
        legs.append(torus(0.14, 0.008, 36, 10).moved((x, 0.3, 0.0)))
    return [
        part("seats", join(seats), matte("leather", (0.35, 0.04, 0.04), roughness=0.35)),
        part("stool legs", join(legs), matte("stool chrome", (0.75, 0.75, 0.78), roughness=0.08, metallic=1.0)),
    ]


def _pendants(places: list[tuple[float, float, float]]) -> list[Part]:
    profile = np.array([0.16, 0.15, 0.1, 0.045, 0.02]), np.array([0.0, 0.05, 0.11, 0.15, 0.2])
    shades = join([lathe(*profile, 40).moved(place) for place in places])
    cords = join([cylinder(0.004, HEIGHT_M - y - 0.2, 8).moved((x, (HEIGHT_M + y + 0.2) / 2, z)) for x, y, z in places])
    bulbs = join([sphere(0.035, 14, 20).moved((x, y + 0.05, z)) for x, y, z in places])
    return [
        part("shades", shades, matte("enamel", (0.05, 0.12, 0.08), roughness=0.2)),
        part("cords", cords, matte("cords", (0.02, 0.02, 0.02))),
        part("pendant bulbs", bulbs, matte("pendant bulbs", (1.0, 0.95, 0.8), emissive=(14.0, 11.0, 7.0))),
    ]


def _strings() -> tuple[Mesh, Mesh]:
    """Two catenaries of small bulbs across the room, and their wires of 3 mm."""
    bulbs, wires = [], []
    for z in (1.2, 1.4):
        for left, right in ((-4.3, -1.45), (-1.45, 1.45), (1.45, 4.3)):
            x = np.linspace(left, right, 41)
            y = 2.95 - 0.35 * (1 - ((x - (left + right) / 2) / ((right - left) / 2)) ** 2)
            points = np.stack([x, y, np.full(41, z)], axis=1)
            wires.append(tube(points, 0.0015, 5))
            bulbs += [sphere(0.012, 8, 12).moved(point - (0, 0.02, 0)) for point in points[2:-1:4]]
    return join(bulbs), join(wires)


def _neon() -> list[Part]:
    """Two signs of thin glowing tube on the back wall: a wave and a looped glass."""
    back = -DEPTH_M / 2 + 0.06
    t = np.linspace(0.0, 1.0, 160)
    wave = np.stack([-3.0 + 1.4 * t, 2.65 + 0.12 * np.sin(6 * np.pi * t), np.full(160, back)], axis=1)
    frame = np.stack(
        [-2.3 + 0.85 * np.cos(2 * np.pi * t), 2.65 + 0.24 * np.sin(2 * np.pi * t), np.full(160, back)], axis=1
    )
    loop = np.stack(
        [
            2.5 + 0.5 * np.sin(2 * np.pi * t),
            2.7 + 0.2 * np.sin(4 * np.pi * t),
            np.full(160, back),
        ],
        axis=1,
    )
    return [
        part(
            "neon pink",
            join([tube(wave, 0.007, 8), tube(frame, 0.006, 8)]),
            matte("neon pink", (1, 1, 1), emissive=(10.0, 0.8, 3.5)),
        ),
        part("neon blue", tube(loop, 0.007, 8), matte("neon blue", (1, 1, 1), emissive=(0.8, 5.0, 11.0))),
    ]


def _camera() -> KeyedCamera:
    """A glide to and fro before the counter, closed in 8 s."""
    return round_trip(
        "glide",
        DURATION_S,
        50.0,
        lambda a: (2.2 * np.sin(a), 1.6 + 0.12 * np.sin(2 * a), 1.9 + 0.35 * np.cos(a)),
        lambda a: (1.0 * np.sin(a - 0.5), 1.55, -2.2),
    )
