"""A room as a box, the origin in the middle of its floor: its six faces, seen from inside."""

from __future__ import annotations

from dataclasses import dataclass

from stimuli.procedural.shapes import Mesh, rectangle

Repeat = tuple[float, float]


@dataclass(frozen=True)
class Room:
    """``width_m`` along x, ``depth_m`` along z, ``height_m``; textures repeat so often along each face."""

    width_m: float
    depth_m: float
    height_m: float

    def floor(self, repeat: Repeat = (1, 1)) -> Mesh:
        """The floor, facing up."""
        return rectangle((-self.width_m / 2, 0, self.depth_m / 2), (self.width_m, 0, 0), (0, 0, -self.depth_m), repeat)

    def ceiling(self, repeat: Repeat = (1, 1)) -> Mesh:
        """The ceiling, facing down."""
        corner = (-self.width_m / 2, self.height_m, -self.depth_m / 2)
        return rectangle(corner, (self.width_m, 0, 0), (0, 0, self.depth_m), repeat)

    def left(self, repeat: Repeat, front_m: float, width_m: float, low_m: float, height_m: float) -> Mesh:
        """A piece of the left wall: ``width_m`` from z = ``front_m`` to the back, ``height_m`` from ``low_m`` up."""
        return rectangle((-self.width_m / 2, low_m, front_m), (0, 0, -width_m), (0, height_m, 0), repeat)

    def left_wall(self, repeat: Repeat) -> Mesh:
        """The whole left wall."""
        return self.left(repeat, self.depth_m / 2, self.depth_m, 0, self.height_m)

    def right_wall(self, repeat: Repeat) -> Mesh:
        """The wall at +x."""
        corner = (self.width_m / 2, 0, -self.depth_m / 2)
        return rectangle(corner, (0, 0, self.depth_m), (0, self.height_m, 0), repeat)

    def back_wall(self, repeat: Repeat) -> Mesh:
        """The wall at -z."""
        corner = (-self.width_m / 2, 0, -self.depth_m / 2)
        return rectangle(corner, (self.width_m, 0, 0), (0, self.height_m, 0), repeat)

    def front_wall(self, repeat: Repeat) -> Mesh:
        """The wall at +z."""
        corner = (self.width_m / 2, 0, self.depth_m / 2)
        return rectangle(corner, (-self.width_m, 0, 0), (0, self.height_m, 0), repeat)
