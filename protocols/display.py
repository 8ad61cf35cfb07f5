"""The display a protocol asks for, and where the eye is: size in metres, distance, pixels, refresh rate."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from protocols.quantity import Model, Positive, Rate, Share, Size


class Display(Model):
    """What the study needs of a display. The lab file says what the room has; `run` compares the two."""

    refresh_hz: Rate = "240"
    size_px: Size = (1920, 1080)
    width_m: Positive = 0.53
    height_m: Positive | None = Field(default=None, description="None: square pixels")
    distance_m: Positive = 0.6
    background: Share = Field(default=0.5, description="display code of the surround, 0 black to 1 white")
    geometry: Literal["screen", "camera"] = Field(
        default="camera",
        description="eccentricity from the screen's size and distance, or from the camera's field",
    )
    view: Literal["monitor", "headset"] = Field(
        default="monitor", description="what techniques render; a session is shown on a monitor, so headset is refused"
    )

    @property
    def pixels_per_degree(self) -> float:
        """At the screen's centre, along x."""
        return math.radians(1) * self.distance_m / (self.width_m / self.size_px[0])

    def panel_m(self, size_px: Size) -> tuple[float, float]:
        """Width and height in metres of a panel of ``size_px`` shown pixel for pixel."""
        pitch = self.width_m / self.size_px[0]
        height = self.height_m / self.size_px[1] if self.height_m else pitch
        return size_px[0] * pitch, size_px[1] * height
