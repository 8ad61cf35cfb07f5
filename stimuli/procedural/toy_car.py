"""A toy car drives round wooden blocks on a textured floor: a rigid body, four wheels that roll and steer, a camera."""

from __future__ import annotations

import numpy as np

from stimuli.camera_path import KeyedCamera
from stimuli.procedural.shapes import (
    Mesh,
    box,
    boxes,
    checkerboard,
    cylinder,
    generator,
    grid,
    join,
    matte,
    noise,
    part,
    recipe_sha256,
    rectangle,
    rotation,
    sphere,
)
from stimuli.procedural.tracks import CurveTrack, WheelTrack, round_trip
from stimuli.scene import Light, Mover, Part, Scene

VERSION = 1
DURATION_S = 8.0
WHEEL_M, WHEELBASE_M, TRACK_M = 0.045, 0.21, 0.17
COURSE = np.array(
    [
        [0.9, 0, 0],
        [0.75, 0, -0.6],
        [0.1, 0, -0.75],
        [-0.3, 0, -0.25],
        [-0.85, 0, -0.35],
        [-0.95, 0, 0.35],
        [-0.3, 0, 0.7],
        [0.45, 0, 0.55],
    ]
)


def build() -> Scene:
    """The scene, 8 s a round; the camera's path is closed as well."""
    course = CurveTrack(COURSE, DURATION_S)
    movers = [Mover("car", _body(), course)]
    for name, x, z, steers in (
        ("wheel front left", -1, -1, True),
        ("wheel front right", 1, -1, True),
        ("wheel rear left", -1, 1, False),
        ("wheel rear right", 1, 1, False),
    ):
        offset = (x * TRACK_M / 2, WHEEL_M, z * WHEELBASE_M / 2)
        track = WheelTrack(course, offset, WHEEL_M, WHEELBASE_M if steers else 0.0)
        movers.append(Mover(name, _wheel(), track))
    return Scene(
        name="toy_car",
        static=_room(),
        movers=tuple(movers),
        lights=(
            Light(
                "area",
                (9.0, 8.6, 8.0),
                position=(0.0, 2.2, 0.0),
                direction=(0.0, -1.0, 0.0),
                corner=(-0.5, 2.2, -0.5),
                edge_u=(1.0, 0.0, 0.0),
                edge_v=(0.0, 0.0, 1.0),
                name="ceiling",
            ),
            Light("point", (0.35, 0.3, 0.22), (-1.2, 0.9, 0.9), name="lamp"),
        ),
        camera=_camera(),
        sha256=recipe_sha256("toy_car", VERSION),
        ambient=(0.12, 0.13, 0.15),
        background=(0.3, 0.4, 0.55),
        duration_s=DURATION_S,
    )


def _body() -> tuple[Part, ...]:
    paint = matte("paint", (0.75, 0.06, 0.05), roughness=0.15)
    glass = matte("windows", (0.05, 0.07, 0.09), roughness=0.05)
    chrome = matte("chrome", (0.85, 0.85, 0.88), roughness=0.1, metallic=1.0)
    lamp = matte("headlight", (1.0, 1.0, 0.9), emissive=(1.2, 1.1, 0.8))
    hull = _hull(
        np.array([[-0.2, 0.06], [-0.19, 0.1], [-0.09, 0.115], [0.16, 0.115], [0.2, 0.09], [0.2, 0.045], [-0.2, 0.04]]),
        0.16,
    )
    cabin = _hull(np.array([[-0.07, 0.115], [-0.03, 0.175], [0.1, 0.175], [0.15, 0.115]]), 0.13)
    roof = box((0.0, 0.178, 0.035), (0.125, 0.008, 0.135))
    bumpers = join([box((0.0, 0.055, -0.205), (0.15, 0.02, 0.015)), box((0.0, 0.055, 0.205), (0.15, 0.02, 0.015))])
    lights = join([sphere(0.016, 10, 16).moved((x, 0.08, -0.195)) for x in (-0.055, 0.055)])
    stripe = rectangle((-0.02, 0.1835, -0.03), (0.0, 0.0, 0.13), (0.04, 0.0, 0.0))
    return (
        part("hull", hull, paint),
        part("cabin", cabin, glass),
        part("roof", roof, paint),
        part("bumpers", bumpers, chrome),
        part("headlights", lights, lamp),
        part("stripe", stripe, matte("stripe", (0.9, 0.9, 0.85))),
    )


def _hull(profile_zy: np.ndarray, width_m: float) -> Mesh:
    """A closed prism: the side view ``profile_zy`` (P, 2), convex, swept over ``width_m``, with flat faces."""
    z, y = profile_zy[:, 0], profile_zy[:, 1]
    next_z, next_y = np.roll(z, -1), np.roll(y, -1)
    half = width_m / 2.0
    faces = []
    middle = profile_zy.mean(axis=0)
    for a, b in zip(np.stack([z, y], 1), np.stack([next_z, next_y], 1), strict=True):
        face = rectangle((-half, a[1], a[0]), (width_m, 0.0, 0.0), (0.0, b[1] - a[1], b[0] - a[0]))
        outward = face.normals[0, 1] * ((a[1] + b[1]) / 2 - middle[1]) + face.normals[0, 2] * (
            (a[0] + b[0]) / 2 - middle[0]
        )
        faces.append(face if outward > 0 else _turned_over(face))
    count = len(profile_zy)
    fan = np.stack([np.zeros(count - 2, np.int64), np.arange(1, count - 1), np.arange(2, count)], axis=1)
    for side in (-1.0, 1.0):
        positions = np.stack([np.full(count, side * half), y, z], axis=1)
        normal = np.cross(positions[1] - positions[0], positions[2] - positions[0])[0]
        indices = fan if normal * side > 0 else fan[:, ::-1]
        faces.append(Mesh(positions, np.tile((side, 0.0, 0.0), (count, 1)), np.zeros((count, 2)), indices))
    return join(faces)


def _turned_over(mesh: Mesh) -> Mesh:
    return Mesh(mesh.positions, -mesh.normals, mesh.uv, mesh.indices[:, ::-1])


def _wheel() -> tuple[Part, ...]:
    sideways = rotation(2, np.pi / 2)
    tyre = cylinder(WHEEL_M, 0.03, 40).turned(sideways)
    hub = cylinder(0.02, 0.036, 24).turned(sideways)
    # Five bright spokes on both sides show the turning.
    spokes = []
    for angle in 2 * np.pi * np.arange(5) / 5:
        for x in (-0.0165, 0.0165):
            spokes.append(box((x, 0.024, 0.0), (0.004, 0.034, 0.008)).turned(rotation(0, angle)))
    return (
        part("tyre", tyre, matte("rubber", (0.03, 0.03, 0.03))),
        part("hub", hub, matte("hub", (0.8, 0.8, 0.82), roughness=0.2, metallic=1.0)),
        part("spokes", join(spokes), matte("spokes", (0.9, 0.85, 0.2))),
    )


def _room() -> tuple[Part, ...]:
    rng = generator("toy_car")
    side = np.linspace(-2.0, 2.0, 41)
    x, z = np.meshgrid(side, side)
    floor = grid(np.stack([x, np.zeros_like(x), z], axis=2), np.stack([x, z], axis=2) * 1.5, outward=True)
    if floor.normals[0, 1] < 0:
        floor = _turned_over(floor)
    planks = noise(rng, 512, (0.35, 0.2, 0.1), (0.8, 0.58, 0.34), slope=1.2)
    planks[::64, :, :3] = (40, 22, 12)
    planks[:, ::256, :3] = planks[:, ::256, :3] // 3
    letters = checkerboard(64, 4, (0.1, 0.25, 0.6), (0.95, 0.85, 0.3))
    places = np.array(
        [[0.25, 0.0], [0.32, 0.22], [-0.62, 0.05], [0.15, -1.15], [1.25, 0.5], [-1.35, -0.5], [-0.75, 1.15]]
    )
    sizes = rng.uniform(0.1, 0.2, len(places))
    blocks = boxes(np.stack([places[:, 0], sizes / 2, places[:, 1]], 1), np.repeat(sizes[:, None], 3, 1))
    balls = join([sphere(0.12).moved((-0.1, 0.12, 0.2)), sphere(0.09).moved((0.62, 0.09, -0.05))])
    poles = join(
        [
            cylinder(0.006, 0.5, 12).moved((px, 0.25, pz))
            for px, pz in ((0.5, -1.0), (-1.1, 0.75), (1.2, -0.3), (0.05, 0.35))
        ]
    )
    walls = join(
        [
            rectangle((-2, 0, -2), (4, 0, 0), (0, 1.2, 0), (8, 2.4)),
            rectangle((-2, 0, 2), (0, 0, -4), (0, 1.2, 0), (8, 2.4)),
            rectangle((2, 0, -2), (0, 0, 4), (0, 1.2, 0), (8, 2.4)),
        ]
    )
    wallpaper = checkerboard(128, 8, (0.72, 0.76, 0.74), (0.8, 0.83, 0.8))
    return (
        part("floor", floor, matte("planks", (1.0, 1.0, 1.0), planks, roughness=0.6)),
        part("blocks", blocks, matte("blocks", (1.0, 1.0, 1.0), letters)),
        part("balls", balls, matte("mirror balls", (0.95, 0.95, 0.95), roughness=0.0, metallic=1.0)),
        part("poles", poles, matte("poles", (0.9, 0.3, 0.1))),
        part("walls", walls, matte("wallpaper", (1.0, 1.0, 1.0), wallpaper)),
    )


def _camera() -> KeyedCamera:
    """A slow arc in front of the course, aimed near its middle; closed in 8 s."""
    return round_trip(
        "arc",
        DURATION_S,
        45.0,
        lambda a: (0.45 * np.sin(a), 0.75 + 0.1 * np.cos(a), 1.75 - 0.15 * np.cos(a)),
        lambda a: (0.15 * np.sin(a + 0.6), 0.05, 0.1 * np.cos(a)),
    )
