"""The table of extremes: scenes, cameras and clocks at the ends of what numbers can hold, and what must come out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Literal

import numpy as np

from stimuli.scene import CameraPath, Light, Mover, Part, PoseTrack, Scene, StillCamera
from tests.renderers.scenes_by_hand import Drift, box, crowd, diffuse, look_at, primitive, quad, scene

Wanted = Literal["sane", "same", "black", "clamped", "constant", "finite"]
LAMP = Light("point", (30.0, 28.0, 25.0), position=(1.5, 2.0, 4.0))
WALL = quad((-4, -4, -1), (8, 0, 0), (0, 8, 0), diffuse((0.7, 0.5, 0.4)), "wall")
BALL = box((0.6, 0.4, 0.2), (0.5, 0.4, 0.3), diffuse((0.3, 0.6, 0.8)))
CONSTANT = (0.25, 0.5, 0.125)


@dataclass(frozen=True)
class Placed:
    """A track or camera in a world that was scaled and shifted: the scale goes into a track, not into a camera."""

    inner: PoseTrack | CameraPath
    scale: float
    offset: tuple[float, float, float]
    rigid: bool = False
    name: str = "placed"

    @property
    def yfov_rad(self) -> float:
        """The camera's own."""
        return self.inner.yfov_rad  # type: ignore[union-attr]

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T, 4, 4) in the new world."""
        poses = np.array(self.inner.pose(time_s))
        if self.rigid:
            poses[:, :3, 3] = poses[:, :3, 3] * self.scale + self.offset
            return poses
        world = np.diag([self.scale] * 3 + [1.0])
        world[:3, 3] = self.offset
        return world @ poses


@dataclass(frozen=True)
class Later:
    """What begins at ``begin_s``, and rests until a second before it."""

    inner: PoseTrack | CameraPath
    begin_s: float
    name: str = "later"

    @property
    def yfov_rad(self) -> float:
        """The camera's own."""
        return self.inner.yfov_rad  # type: ignore[union-attr]

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T, 4, 4)."""
        return self.inner.pose(np.maximum(np.asarray(time_s, float) - self.begin_s, -1.0))


@dataclass(frozen=True)
class Walk:
    """A camera that slides from ``start`` (look-at pose) with ``velocity`` units a second."""

    start: StillCamera
    velocity: tuple[float, float, float]
    name: str = "walk"

    @property
    def yfov_rad(self) -> float:
        """The start's."""
        return self.start.yfov_rad

    def pose(self, time_s: np.ndarray) -> np.ndarray:
        """(T, 4, 4)."""
        poses = self.start.pose(np.atleast_1d(time_s))
        poses[:, :3, 3] += np.atleast_1d(time_s)[:, None] * np.asarray(self.velocity)
        return poses


EYE = Walk(look_at((0.3, 0.2, 5), (0, 0, 0)), (2.0, 0.7, 0.0))


def ordinary(*more: Part, lights: tuple[Light, ...] = (LAMP,), camera: CameraPath = EYE, movers: int = 2) -> Scene:
    """A wall, a box, two moving boxes, a lamp, a little ambient light, a sliding camera; and what is added."""
    dim = (0.05, 0.05, 0.05)
    return replace(scene((WALL, BALL, *more), crowd(movers), lights, ambient=dim, background=dim), camera=camera)


def placed(subject: Scene, scale: float, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Scene:
    """``subject`` in a world scaled and shifted; the lamp's power grows with the square."""
    world = np.diag([scale] * 3 + [1.0])
    world[:3, 3] = offset
    parts = tuple(replace(part, matrix=world @ part.matrix) for part in subject.static)
    movers = tuple(replace(m, track=Placed(m.track, scale, offset)) for m in subject.movers)
    lights = tuple(
        replace(
            light,
            intensity=tuple(v * scale**2 for v in light.intensity),
            position=tuple(np.asarray(light.position) * scale + offset),
        )
        for light in subject.lights
    )
    return replace(
        subject, static=parts, movers=movers, lights=lights, camera=Placed(subject.camera, scale, offset, True)
    )


def later(subject: Scene, begin_s: float) -> Scene:
    """``subject`` whose clock begins at ``begin_s``."""
    movers = tuple(replace(m, track=Later(m.track, begin_s)) for m in subject.movers)
    return replace(subject, movers=movers, camera=Later(subject.camera, begin_s))


def field_of(degrees: float) -> Scene:
    """The ordinary scene seen with a vertical field of so many degrees."""
    return ordinary(camera=replace(EYE, start=replace(EYE.start, yfov_rad=float(np.radians(degrees)))))


def lamp(power: float) -> Light:
    """The lamp with another intensity."""
    return replace(LAMP, intensity=(power,) * 3)


def triangles(points: list, faces: list) -> Part:
    """A part of bare triangles."""
    return Part("triangles", primitive(np.array(points, float), faces), WALL.material)


def needles() -> Part:
    """Triangles 100 long and 1e-6 wide."""
    points = [[x, y, -0.5] for k in range(8) for x, y in ((-50, k), (50, k), (50, k + 1e-6))]
    return triangles(points, np.arange(24).reshape(-1, 3).tolist())


def moving(velocity: float) -> Scene:
    """Camera and movers at ``velocity`` units a second."""
    movers = tuple(
        Mover(f"m{k}", (box((0, 0, 0), (0.3, 0.3, 0.3), diffuse()),), Drift((k - 0.5, 0, 0), (velocity, velocity, 0)))
        for k in range(2)
    )
    subject = ordinary(camera=replace(EYE, velocity=(velocity, 0.0, 0.0)))
    return replace(subject, movers=movers)


def flat_field() -> Scene:
    """One colour everywhere: no gradient for anything to follow."""
    glow = diffuse((0.0, 0.0, 0.0), ambient=CONSTANT)
    wall = quad((-400, -400, -1), (800, 0, 0), (0, 800, 0), glow)
    return replace(scene((wall,), ambient=(1.0, 1.0, 1.0), background=CONSTANT), camera=EYE)


def mirrors() -> Scene:
    """Two mirrors face to face, the camera between them."""
    silver = diffuse((0.02, 0.02, 0.02), specular=(0.97, 0.97, 0.97), shine=500.0)
    pair = (
        quad((-4, -4, -2), (8, 0, 0), (0, 8, 0), silver, "mirror"),
        quad((-4, -4, 8), (8, 0, 0), (0, 8, 0), silver, "mirror"),
    )
    return replace(scene((BALL, *pair), (), (LAMP,)), camera=EYE)


@dataclass(frozen=True)
class Extreme:
    """One row: ``make`` the scene; what must come out: ``same`` picture as the ordinary scene's, ``black``,
    ``constant`` colour, ``clamped`` (at least one shading result was brought back to 65504), ``sane``
    (something is seen) or merely ``finite``."""

    name: str
    make: Callable[[], Scene]
    wanted: Wanted = "sane"
    size_px: tuple[int, int] = (22, 17)
    rate_hz: Fraction = Fraction(240)
    start_s: Fraction = Fraction(0)
    overflows: bool = field(default=False)


_SCALES = tuple(Extreme(f"scale {s:g}", lambda s=s: placed(ordinary(), s), "same") for s in (1e-6, 1e-3, 1e3, 1e6))
_SIZES = tuple(Extreme(f"size {w}x{h}", ordinary, size_px=(w, h)) for w, h in ((1, 1), (1, 9), (9, 1), (7, 5), (2, 3)))
_RATES = tuple(
    Extreme(f"{rate} Hz", ordinary, rate_hz=rate) for rate in (Fraction(24), Fraction(60000, 1001), Fraction(1000))
)
TABLE: tuple[Extreme, ...] = (
    Extreme("ordinary", ordinary, "same"),
    *_SCALES,
    Extreme("origin shifted by 1e5", lambda: placed(ordinary(), 1.0, (1e5, -1e5, 1e5)), "same"),
    Extreme("tiny and far away", lambda: placed(ordinary(), 1e-3, (1e2, 1e2, -1e2)), "same"),
    Extreme(
        "triangles without area",
        lambda: ordinary(triangles([[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 1, 1], [0, 2, 1]], [[0, 1, 2], [0, 3, 4]])),
        "same",
    ),
    Extreme("every triangle twice", lambda: ordinary(WALL, BALL), "same"),
    Extreme("needle triangles", lambda: ordinary(needles())),
    Extreme(
        "light without area",
        lambda: ordinary(
            lights=(LAMP, Light("area", (1e3,) * 3, corner=(0, 0, 3), edge_u=(0, 0, 0), edge_v=(0, 1, 0)))
        ),
        "same",
    ),
    Extreme("sphere light of radius 0", lambda: ordinary(lights=(LAMP, Light("sphere", (1e3,) * 3))), "same"),
    Extreme(
        "coincident lights",
        lambda: ordinary(lights=(replace(LAMP, intensity=tuple(v / 2 for v in LAMP.intensity)),) * 2),
        "same",
    ),
    Extreme("light on a surface", lambda: ordinary(lights=(replace(LAMP, position=(0.0, 0.0, -1.0)),))),
    Extreme("light in the eye", lambda: ordinary(lights=(replace(LAMP, position=(0.3, 0.2, 5.0)),))),
    Extreme(
        "camera in a wall",
        lambda: ordinary(
            camera=look_at((-2, 0, -1), (0.6, 0.4, 0.2)), lights=(replace(LAMP, position=(-3.0, 1.0, 2.0)),)
        ),
        "finite",  # what reprojects points has none in front of the eye
    ),
    Extreme("parallel mirrors", mirrors),
    Extreme("radiance 1e-30", lambda: ordinary(lights=(lamp(1e-30),))),
    Extreme("radiance 1e30", lambda: ordinary(lights=(lamp(1e30),)), "clamped"),
    Extreme("radiance 3e38", lambda: ordinary(lights=(lamp(3e38),)), "clamped", overflows=True),
    Extreme(
        "no light", lambda: replace(ordinary(lights=(lamp(0.0),)), ambient=(0.0,) * 3, background=(0.0,) * 3), "black"
    ),
    Extreme("field of 0.01 degrees", lambda: field_of(0.01)),
    Extreme("field of 179 degrees", lambda: field_of(179.0)),
    *_SIZES,
    *_RATES,
    Extreme("time 1e6 s", lambda: later(ordinary(), 1e6), "same", start_s=Fraction(10**6)),
    Extreme("no motion", lambda: moving(0.0)),
    Extreme("1e6 units a second", lambda: moving(1e6)),
    Extreme("a hundred movers", lambda: ordinary(movers=100)),
    Extreme("no gradient", flat_field, "constant"),
    Extreme("empty scene", lambda: replace(scene(background=CONSTANT), camera=EYE), "constant"),
)
