"""A walking robot of 16 rigid bodies, a stand-in for CERBERUS: swinging limbs, turning head, a workshop round it."""

from __future__ import annotations

import numpy as np

from stimuli.camera_path import KeyedCamera
from stimuli.procedural.shapes import (
    Mesh,
    box,
    checkerboard,
    cushion,
    cylinder,
    generator,
    join,
    matte,
    noise,
    part,
    recipe_sha256,
    rectangle,
    rotation,
    sphere,
    torus,
)
from stimuli.procedural.tracks import CurveTrack, SwingTrack, round_trip
from stimuli.scene import Light, Material, Mover, Part, PoseTrack, Scene

VERSION = 1
DURATION_S = 8.0
STEP_S = 1.0
_COURSE = np.array(
    [[2.0, 1.0, 0.0], [1.2, 1.0, -1.4], [-1.2, 1.0, -1.4], [-2.0, 1.0, 0.0], [-1.2, 1.0, 1.4], [1.2, 1.0, 1.4]]
)


def build() -> Scene:
    """The scene: the robot walks a closed round in 8 s, eight steps."""
    shell = matte("shell", (0.85, 0.5, 0.08), roughness=0.3)
    steel = matte("steel", (0.7, 0.71, 0.74), roughness=0.15, metallic=1.0)
    rubber = matte("rubber", (0.05, 0.05, 0.05))
    glow = matte("glow", (0.2, 0.9, 1.0), emissive=(0.3, 2.5, 3.0))
    course = CurveTrack(_COURSE, DURATION_S)
    torso = SwingTrack(course, (0.0, 0.02, 0.0), 2, 0.05, STEP_S)
    movers = [
        Mover("pelvis", _parts("pelvis", shell, [cushion((0.34, 0.2, 0.24), 0.4)], steel, [_ring(0.15, 0.02)]), course),
        Mover("torso", _torso(shell, steel, glow), torso),
    ]
    neck = SwingTrack(torso, (0.0, 0.62, 0.0), 1, 0.6, 4.0)
    head = SwingTrack(neck, (0.0, 0.1, 0.0), 0, 0.15, 2.0)
    movers.append(Mover("neck", _parts("neck", steel, [cylinder(0.05, 0.16, 32)], rubber, [_ring(0.06, 0.012)]), neck))
    movers.append(Mover("head", _head(shell, steel, glow), head))
    for side, name, phase in ((-1.0, "left", 0.0), (1.0, "right", np.pi)):
        movers += _leg(course, side, name, phase, shell, steel, rubber)
        movers += _arm(torso, side, name, phase + np.pi, shell, steel, rubber)
    return Scene(
        name="robot",
        static=_workshop(),
        movers=tuple(movers),
        lights=(
            Light(
                "spot",
                (60.0, 56.0, 48.0),
                (3.0, 3.8, 2.5),
                (-0.55, -0.7, -0.45),
                inner_rad=0.5,
                outer_rad=0.8,
                name="key",
            ),
            Light("point", (5.0, 6.0, 8.0), (-3.0, 3.0, 1.5), name="fill"),
        ),
        camera=_camera(),
        sha256=recipe_sha256("robot", VERSION),
        ambient=(0.02, 0.02, 0.025),
        background=(0.03, 0.03, 0.04),
        duration_s=DURATION_S,
    )


def _parts(name: str, first: Material, one: list[Mesh], second: Material, two: list[Mesh]) -> tuple[Part, ...]:
    return part(f"{name} {first.name}", join(one), first), part(f"{name} {second.name}", join(two), second)


def _ring(major_m: float, minor_m: float) -> Mesh:
    return torus(major_m, minor_m, 64, 20)


def _bolts(count: int, radius_m: float, height_m: float) -> list[Mesh]:
    angle = 2 * np.pi * np.arange(count) / count
    return [sphere(0.012, 8, 12).moved((radius_m * np.sin(a), height_m, radius_m * np.cos(a))) for a in angle]


def _torso(shell: Material, steel: Material, glow: Material) -> tuple[Part, ...]:
    chest = cushion((0.56, 0.5, 0.34), 0.45, 48, 96).moved((0.0, 0.34, 0.0))
    hoses = [torus(0.07, 0.012, 48, 12).turned(rotation(0, np.pi / 2)).moved((x, 0.2, 0.16)) for x in (-0.1, 0.1)]
    waist = [_ring(0.11 - 0.006 * i, 0.022).moved((0.0, 0.03 * i, 0.0)) for i in range(4)]
    core = sphere(0.06, 24, 32).moved((0.0, 0.4, -0.165))
    return (
        part("chest", chest, shell),
        part("torso steel", join([*hoses, *waist, *_bolts(12, 0.2, 0.56)]), steel),
        part("core", core, glow),
    )


def _head(shell: Material, steel: Material, glow: Material) -> tuple[Part, ...]:
    skull = cushion((0.28, 0.26, 0.26), 0.5, 40, 80).moved((0.0, 0.14, 0.0))
    ears = [cylinder(0.05, 0.32, 40).turned(rotation(2, np.pi / 2)).moved((0.0, 0.15, 0.0))]
    ears += [cylinder(0.008, 0.2, 12).moved((x, 0.32, 0.0)) for x in (-0.13, 0.13)]
    eyes = [sphere(0.035, 20, 28).moved((x, 0.17, -0.12)) for x in (-0.06, 0.06)]
    return part("skull", skull, shell), part("ears", join(ears), steel), part("eyes", join(eyes), glow)


def _leg(
    hip_of: PoseTrack, side: float, name: str, phase: float, shell: Material, steel: Material, rubber: Material
) -> list[Mover]:
    hip = SwingTrack(hip_of, (0.11 * side, -0.08, 0.0), 0, 0.5, STEP_S, phase)
    knee = SwingTrack(hip, (0.0, -0.42, 0.0), 0, 0.35, STEP_S, phase + 1.2, bias_rad=-0.4)
    ankle = SwingTrack(knee, (0.0, -0.4, 0.0), 0, 0.2, STEP_S, phase + 2.0, bias_rad=0.2)
    thigh = [cushion((0.15, 0.36, 0.17), 0.5, 32, 64).moved((0.0, -0.2, 0.0))]
    shin = [cushion((0.12, 0.34, 0.14), 0.5, 32, 64).moved((0.0, -0.2, 0.0))]
    foot = [cushion((0.13, 0.08, 0.28), 0.3, 24, 48).moved((0.0, -0.05, -0.05))]
    joint = [cylinder(0.06, 0.17, 48).turned(rotation(2, np.pi / 2))]
    return [
        Mover(f"{name} thigh", _parts(f"{name} thigh", shell, thigh, steel, joint), hip),
        Mover(f"{name} shin", _parts(f"{name} shin", shell, shin, steel, joint), knee),
        Mover(f"{name} foot", _parts(f"{name} foot", rubber, foot, steel, [cylinder(0.04, 0.12, 32)]), ankle),
    ]


def _arm(
    chest: PoseTrack, side: float, name: str, phase: float, shell: Material, steel: Material, rubber: Material
) -> list[Mover]:
    shoulder = SwingTrack(chest, (0.35 * side, 0.48, 0.0), 0, 0.45, STEP_S, phase)
    elbow = SwingTrack(shoulder, (0.0, -0.32, 0.0), 0, 0.25, STEP_S, phase + 0.6, bias_rad=0.5)
    hand = SwingTrack(elbow, (0.0, -0.3, 0.0), 1, 0.4, 2 * STEP_S, phase)
    upper = [cushion((0.12, 0.28, 0.12), 0.6, 32, 64).moved((0.0, -0.15, 0.0))]
    lower = [cushion((0.1, 0.26, 0.1), 0.6, 32, 64).moved((0.0, -0.14, 0.0))]
    ball = [sphere(0.075, 28, 40)]
    fingers = [cushion((0.03, 0.12, 0.03), 0.5, 16, 24).moved((0.035 * k, -0.06, 0.0)) for k in (-1, 0, 1)]
    return [
        Mover(f"{name} upper arm", _parts(f"{name} upper arm", shell, upper, steel, ball), shoulder),
        Mover(f"{name} forearm", _parts(f"{name} forearm", shell, lower, steel, [sphere(0.055, 24, 32)]), elbow),
        Mover(f"{name} hand", _parts(f"{name} hand", rubber, fingers, steel, [sphere(0.04, 16, 24)]), hand),
    ]


def _workshop() -> tuple[Part, ...]:
    rng = generator("robot")
    tiles = checkerboard(256, 4, (0.2, 0.21, 0.22), (0.42, 0.43, 0.42))
    plaster = noise(rng, 256, (0.35, 0.37, 0.4), (0.6, 0.62, 0.63))
    floor = rectangle((-5, 0, 5), (10, 0, 0), (0, 0, -10), (10, 10))
    walls = join(
        [
            rectangle((-5, 0, -5), (10, 0, 0), (0, 4, 0), (5, 2)),
            rectangle((-5, 0, 5), (0, 0, -10), (0, 4, 0), (5, 2)),
            rectangle((5, 0, -5), (0, 0, 10), (0, 4, 0), (5, 2)),
        ]
    )
    rails = [cylinder(0.02, 8.0, 16).turned(rotation(2, np.pi / 2)).moved((0.0, y, -4.6)) for y in (0.5, 0.9, 1.3)]
    posts = [cylinder(0.025, 1.4, 16).moved((x, 0.7, -4.6)) for x in np.linspace(-4, 4, 17)]
    crates = [box((x, s / 2, z), (s, s, s)) for x, z, s in ((-3.5, -3.0, 0.9), (-4.0, 1.5, 0.7), (3.8, -3.4, 1.1))]
    wood = noise(rng, 256, (0.3, 0.18, 0.08), (0.7, 0.5, 0.28), slope=1.3)
    return (
        part("floor", floor, matte("floor", (1.0, 1.0, 1.0), tiles, roughness=0.5)),
        part("walls", walls, matte("plaster", (1.0, 1.0, 1.0), plaster)),
        part("railing", join([*rails, *posts]), matte("railing", (0.9, 0.75, 0.1))),
        part("crates", join(crates), matte("crates", (1.0, 1.0, 1.0), wood)),
    )


def _camera() -> KeyedCamera:
    return round_trip(
        "follow",
        DURATION_S,
        50.0,
        lambda a: (0.8 * np.sin(a), 1.7 + 0.1 * np.sin(2 * a), 4.2),
        lambda a: (0.9 * np.cos(a), 1.05, 0.0),
    )
