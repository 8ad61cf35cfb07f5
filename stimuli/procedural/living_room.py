"""A living room, a stand-in for LIVINGROOM: sofa, books, plants, radiator, rug, pictures, windows that light it."""

from __future__ import annotations

import numpy as np

from stimuli.camera_path import KeyedCamera
from stimuli.procedural.rooms import Room
from stimuli.procedural.shapes import (
    Mesh,
    box,
    boxes,
    checkerboard,
    cushion,
    cylinder,
    generator,
    grid,
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
WIDTH_M, DEPTH_M, HEIGHT_M = 6.0, 5.0, 2.7
_BOOKS: tuple[RGB, ...] = ((0.55, 0.1, 0.1), (0.1, 0.2, 0.4), (0.15, 0.35, 0.2), (0.75, 0.65, 0.45), (0.2, 0.18, 0.2))


def build() -> Scene:
    """The scene: two windows (area lights) in the left wall, a lamp, a glide in front of the sofa."""
    rng = generator("living_room")
    windows = [
        Light(
            "area",
            (7.5, 7.8, 8.4),
            position=(-2.98, 1.5, z),
            direction=(1.0, 0.0, 0.0),
            corner=(-2.98, 0.9, z - 0.5),
            edge_u=(0.0, 1.2, 0.0),
            edge_v=(0.0, 0.0, 1.0),
            name=f"window {z}",
        )
        for z in (-1.1, 0.9)
    ]
    return Scene(
        name="living_room",
        static=(*_shell(rng), *_sofa(rng), *_shelf(rng), *_table(), *_plants(rng), *_radiator(), *_rug(rng), *_lamp()),
        movers=(),
        lights=(*windows, Light("point", (1.6, 1.2, 0.75), (2.3, 1.62, -1.9), name="lamp")),
        camera=_camera(),
        sha256=recipe_sha256("living_room", VERSION),
        ambient=(0.12, 0.12, 0.125),
        background=(0.6, 0.7, 0.85),
        duration_s=DURATION_S,
    )


def _shell(rng: np.random.Generator) -> list[Part]:
    w, d, h = WIDTH_M / 2, DEPTH_M / 2, HEIGHT_M
    room = Room(WIDTH_M, DEPTH_M, HEIGHT_M)
    planks = noise(rng, 512, (0.3, 0.17, 0.08), (0.62, 0.42, 0.24), slope=1.3)
    planks[::64, :, :3] //= 3
    planks[32::64, 100::256, :3] //= 3
    paper = checkerboard(128, 16, (0.78, 0.75, 0.68), (0.82, 0.79, 0.72))
    # The left wall has two openings of 1.0 x 1.2 m.
    wall = [
        room.left((10, 2), d, 2 * d, 0, 0.9),
        room.left((10, 1), d, 2 * d, 2.1, h - 2.1),
        room.left((2, 2), d, d - 1.4, 0.9, 1.2),
        room.left((2, 2), 0.4, 1.0, 0.9, 1.2),
        room.left((2, 2), -1.6, d - 1.6, 0.9, 1.2),
        room.right_wall((10, 5)),
        room.back_wall((12, 5)),
        room.front_wall((12, 5)),
    ]
    frames = []
    for z in (-1.1, 0.9):
        frames += [box((-w, 1.5, z + s * 0.5), (0.06, 1.24, 0.04)) for s in (-1, 0, 1)]
        frames += [box((-w, 1.5 + s * 0.6, z), (0.06, 0.04, 1.04)) for s in (-1, 0, 1)]
    skirting = [box((0, 0.05, -d + 0.01), (2 * w, 0.1, 0.02)), box((w - 0.01, 0.05, 0), (0.02, 0.1, 2 * d))]
    art = noise(rng, 128, (0.1, 0.15, 0.4), (0.95, 0.6, 0.25), slope=1.6)
    pictures = join([rectangle((x, 1.35, -d + 0.03), (0.5, 0, 0), (0, 0.65, 0)) for x in (-1.0, -0.25, 0.5)])
    borders = join([box((x + 0.25, 1.675, -d + 0.012), (0.58, 0.73, 0.03)) for x in (-1.0, -0.25, 0.5)])
    return [
        part(
            "floor",
            room.floor((3, 2.5)),
            matte("planks", (1, 1, 1), planks, 0.25),
        ),
        part("ceiling", room.ceiling(), matte("ceiling", (0.85, 0.85, 0.83))),
        part("walls", join(wall), matte("wallpaper", (1.0, 1.0, 1.0), paper)),
        part("woodwork", join([*frames, *skirting]), matte("white paint", (0.85, 0.85, 0.84), roughness=0.3)),
        part("pictures", pictures, matte("pictures", (1.0, 1.0, 1.0), art)),
        part("picture frames", borders, matte("frames", (0.1, 0.07, 0.04), roughness=0.2)),
    ]


def _sofa(rng: np.random.Generator) -> list[Part]:
    weave = checkerboard(64, 32, (0.32, 0.36, 0.42), (0.42, 0.46, 0.52))

    def at(x: float, y: float, z: float) -> tuple[float, float, float]:
        return (x - 0.3, y, z - 1.75)

    body = [
        cushion((2.2, 0.35, 0.9), 0.2, 40, 96).moved(at(0, 0.25, 0)),
        cushion((2.2, 0.6, 0.25), 0.3, 40, 96).moved(at(0, 0.65, -0.35)),
        *[cushion((0.25, 0.5, 0.9), 0.3, 40, 96).moved(at(s * 1.1, 0.4, 0)) for s in (-1, 1)],
        *[cushion((0.68, 0.18, 0.72), 0.3, 40, 96).moved(at(x, 0.47, 0.06)) for x in (-0.68, 0.0, 0.68)],
    ]
    loose = [
        cushion((0.42, 0.42, 0.16), 0.45, 40, 80)
        .turned(rotation(0, -0.35) @ rotation(2, rng.uniform(-0.3, 0.3)))
        .moved(at(x, 0.75, -0.12))
        for x in (-0.8, 0.1, 0.75)
    ]
    armchair = [
        cushion((0.85, 0.35, 0.8), 0.25, 40, 80).moved((0, 0.28, 0)),
        cushion((0.85, 0.75, 0.22), 0.3, 40, 80).moved((0, 0.65, -0.32)),
        *[cushion((0.2, 0.45, 0.8), 0.3, 40, 80).moved((s * 0.42, 0.42, 0)) for s in (-1, 1)],
    ]
    chair = join(armchair).turned(rotation(1, -1.2)).moved((1.75, 0.0, -0.35))
    feet = [cylinder(0.025, 0.1, 16).moved((x, 0.05, z)) for x in (-1.3, 0.7) for z in (-2.1, -1.4)]
    return [
        part("sofa", join(body).scaled_uv(6.0), matte("sofa cloth", (1.0, 1.0, 1.0), weave)),
        part("loose cushions", join(loose), matte("velvet", (0.6, 0.2, 0.1))),
        part("armchair", chair, matte("leather", (0.28, 0.14, 0.07), roughness=0.35)),
        part("sofa feet", join(feet), matte("dark wood", (0.12, 0.07, 0.04), roughness=0.3)),
    ]


def _shelf(rng: np.random.Generator) -> list[Part]:
    """A bookcase on the right wall with some 250 books."""
    x, heights = WIDTH_M / 2 - 0.17, (0.05, 0.45, 0.85, 1.25, 1.65, 2.05)
    boards = [box((x, y, 0.9), (0.3, 0.025, 2.0)) for y in heights]
    sides = [box((x, 1.05, z), (0.3, 2.02, 0.025)) for z in (-0.1, 0.9, 1.9)]
    books: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in _BOOKS]
    for y in heights[:-1]:
        z = -0.05
        while z < 1.84:
            thick, tall, deep = rng.uniform(0.015, 0.05), rng.uniform(0.2, 0.34), rng.uniform(0.15, 0.22)
            if not (0.86 < z < 0.94 or 0.86 < z + thick < 0.94) and rng.random() > 0.04:
                at = np.array([x + 0.13 - deep / 2 - 0.1, y + 0.0125 + tall / 2, z + thick / 2])
                books[int(rng.integers(len(_BOOKS)))].append((at, np.array([deep, tall, thick])))
            z += thick + 0.001
    parts = [part("bookcase", join([*boards, *sides]), matte("oak", (0.45, 0.3, 0.16), roughness=0.5))]
    for i, (color, group) in enumerate(zip(_BOOKS, books, strict=True)):
        mesh = boxes(np.array([at for at, _ in group]), np.array([size for _, size in group]))
        parts.append(part(f"books {i}", mesh, matte(f"book cloth {i}", color)))
    return parts


def _table() -> list[Part]:
    top = cylinder(0.55, 0.02, 96).moved((-0.2, 0.42, -0.2))
    legs = []
    for angle in (0.5, 2.6, 4.7):
        x, z = np.sin(angle), np.cos(angle)
        legs.append(tube(np.array([[0.45 * x, 0.0, 0.45 * z], [0.3 * x, 0.41, 0.3 * z]]) - (0.2, 0.0, 0.2), 0.015, 20))
    bowl = lathe(
        np.array([0.0, 0.06, 0.1, 0.14, 0.15, 0.138, 0.095, 0.055, 0.0]),
        np.array([0.0, 0.0, 0.03, 0.07, 0.1, 0.1, 0.07, 0.035, 0.012]),
        64,
    )
    heap = ((0.05, 0, 0), (-0.04, 0, 0.04), (-0.03, 0.0, -0.05), (0.0, 0.06, 0.0))
    fruit = [sphere(0.042, 24, 36).moved((-0.2 + x, 0.49 + y, -0.25 + z)) for x, y, z in heap]
    cups = [_cup().moved((x, 0.43, z)) for x, z in ((0.1, 0.05), (-0.5, -0.05))]
    return [
        part("table top", top, matte("table glass", (0.9, 0.95, 0.93), roughness=0.0, transmission=0.7)),
        part("table legs", join(legs), matte("steel", (0.75, 0.75, 0.77), roughness=0.1, metallic=1.0)),
        part("bowl", bowl.moved((-0.2, 0.431, -0.25)), matte("china", (0.85, 0.86, 0.88), roughness=0.1)),
        part("fruit", join(fruit), matte("oranges", (0.9, 0.42, 0.05), roughness=0.4)),
        part("cups", join(cups), matte("glaze", (0.2, 0.45, 0.5), roughness=0.1)),
    ]


def _cup() -> Mesh:
    bowl = lathe(
        np.array([0.0, 0.03, 0.038, 0.04, 0.036, 0.034, 0.026, 0.0]),
        np.array([0.0, 0.0, 0.04, 0.085, 0.085, 0.04, 0.008, 0.008]),
        48,
    )
    return join([bowl, torus(0.024, 0.005, 36, 12).turned(rotation(0, np.pi / 2)).moved((0.05, 0.045, 0.0))])


def _plants(rng: np.random.Generator) -> list[Part]:
    """Two pots; every leaf is a bent blade of its own."""
    pots, leaves = [], []
    for x, z, count, reach in ((-2.4, -2.0, 130, 0.75), (2.5, 2.1, 160, 0.9)):
        pots.append(
            lathe(np.array([0.0, 0.14, 0.19, 0.2, 0.18, 0.0]), np.array([0.0, 0.0, 0.34, 0.36, 0.36, 0.33]), 64).moved(
                (x, 0.0, z)
            )
        )
        t, s = np.meshgrid(np.linspace(0.0, 1.0, 17), np.linspace(-1.0, 1.0, 5), indexing="ij")
        for _ in range(count):
            length, droop, wide = reach * rng.uniform(0.5, 1.0), rng.uniform(0.2, 1.1), rng.uniform(0.012, 0.03)
            out = length * t * np.sin(0.25 + 0.5 * droop)
            up = length * (t * np.cos(0.25 + 0.5 * droop) - 0.5 * droop * t**2) + 0.33
            blade = np.stack(
                [s * wide * (np.sin(np.pi * np.clip(t * 0.93 + 0.05, 0, 1)) + 0.02), up - 0.15 * wide * s**2, out],
                axis=2,
            )
            mesh = grid(blade, np.stack([s, t], axis=2))
            leaves.append(mesh.turned(rotation(1, rng.uniform(0, 2 * np.pi))).moved((x, 0.0, z)))
    return [
        part("pots", join(pots), matte("terracotta", (0.6, 0.28, 0.17))),
        part("leaves", join(leaves), matte("leaves", (0.14, 0.34, 0.1), roughness=0.5)),
    ]


def _radiator() -> list[Part]:
    columns = []
    for z in np.linspace(-0.4, 0.4, 14):
        turns = np.array([[0.0, 0.12, 0.0], [0.0, 0.7, 0.0]])
        columns += [tube(np.add(turns, (-2.9 + dx, 0.0, -0.1 + z)), 0.022, 20) for dx in (0.0, 0.06)]
    pipes = [cylinder(0.028, 0.9, 28).turned(rotation(0, np.pi / 2)).moved((-2.87, y, -0.1)) for y in (0.12, 0.7)]
    return [part("radiator", join([*columns, *pipes]), matte("enamel", (0.85, 0.85, 0.83), roughness=0.2))]


def _rug(rng: np.random.Generator) -> list[Part]:
    pattern = checkerboard(128, 16, (0.5, 0.12, 0.12), (0.75, 0.6, 0.35))
    fringe = [
        tube(np.array([[x, 0.004, s * 0.9 + 0.1], [x + rng.normal(0, 0.01), 0.003, s * 0.97 + 0.1]]), 0.0015, 4)
        for x in np.linspace(-1.5, 1.1, 180)
        for s in (-1.0, 1.0)
    ]
    return [
        part("rug", box((-0.2, 0.006, 0.1), (2.7, 0.012, 1.8)), matte("rug", (1.0, 1.0, 1.0), pattern)),
        part("fringe", join(fringe), matte("fringe", (0.75, 0.65, 0.45))),
    ]


def _lamp() -> list[Part]:
    at = (2.3, 0.0, -1.9)
    shade = lathe(np.array([0.22, 0.14]), np.array([1.45, 1.75]), 64).moved(at)
    stand = join(
        [cylinder(0.012, 1.5, 24).moved((at[0], 0.75, at[2])), cylinder(0.14, 0.03, 64).moved((at[0], 0.015, at[2]))]
    )
    bulb = sphere(0.04, 20, 28).moved((at[0], 1.56, at[2]))
    return [
        part("lamp shade", shade, matte("shade", (0.9, 0.82, 0.65), emissive=(0.5, 0.4, 0.25), transmission=0.3)),
        part("lamp stand", stand, matte("lamp brass", (0.8, 0.6, 0.3), roughness=0.15, metallic=1.0)),
        part("bulb", bulb, matte("bulb", (1.0, 1.0, 1.0), emissive=(9.0, 7.0, 4.5))),
    ]


def _camera() -> KeyedCamera:
    return round_trip(
        "glide",
        DURATION_S,
        58.0,
        lambda a: (1.1 * np.sin(a), 1.35 + 0.1 * np.sin(2 * a), 1.9 + 0.3 * np.cos(a)),
        lambda a: (0.8 * np.sin(a - 0.6), 0.75, -1.6),
    )
