"""What every rendering technique is: one verb, ``render(view) -> Frame``.

Coordinates: pixel (0, 0) is top left, its centre at (0.5, 0.5), y down; the world is right-handed; a camera
looks down its own -z with +y up (glTF). Colours are linear Rec.709.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, ClassVar, Literal, Protocol

import numpy as np
from pydantic import BaseModel

if TYPE_CHECKING:
    from renderers.engine import Engine
    from stimuli.scene import CameraPath

Gaze = tuple[float, float]
"""Direction of the eye: (azimuth to the right, elevation up) in degrees from the panel's centre."""
Measure = Literal["total", "stages"]


@dataclass(frozen=True)
class ViewGeometry:
    """A flat screen area seen from ``distance_m``; its centre is ``offset_m`` (right, up) of the eye's foot point."""

    width_m: float
    height_m: float
    distance_m: float
    offset_m: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Viewport:
    """A second picture of the same gaze and pose: its own size, field and eye offset (stereo, insets)."""

    name: str
    size_px: tuple[int, int]
    yfov_rad: float
    eye_offset_m: float = 0.0
    centred_on_gaze: bool = False


@dataclass(frozen=True)
class View:
    """One refresh to be rendered.

    ``t0`` and ``t1`` are exact scene seconds: the interval (t0, t1] that this refresh stands for; ``t1 =
    start + index / rate``. ``size_px`` is (width, height). ``gaze`` is this refresh's (None: the panel's centre).
    ``geometry`` None: the display subtends the camera's own field. ``cut`` is True where history must not be used.
    """

    index: int
    t0: Fraction
    t1: Fraction
    size_px: tuple[int, int]
    camera: CameraPath
    gaze: Gaze | None = None
    geometry: ViewGeometry | None = None
    exposure: float = 1.0
    tone: str = "none"
    cut: bool = False
    viewports: tuple[Viewport, ...] = ()

    @property
    def rate_hz(self) -> Fraction:
        """Refreshes a second."""
        return 1 / (self.t1 - self.t0)


@dataclass
class Frame:
    """One rendered refresh and what it cost.

    ``color`` is (H, W, 3) float32, linear, in [0, 65504], not display-clipped, row 0 at the top. ``rays`` counts
    the rays really traced by kind (lazily reduced, see `LazyCounts`). ``seconds`` holds ``total`` and, with
    ``measure='stages'``, one entry a stage. ``time_s`` is exactly index / rate. ``clamped`` counts shading
    results that were brought back into [0, 65504] (nan included). ``channels`` holds optional pictures under
    their EXR names (``Z``, ``motion.X``, ...). A technique may reuse its arrays until its next ``render``.
    """

    color: np.ndarray
    rays: Mapping[str, int]
    seconds: Mapping[str, float]
    time_s: float
    clamped: int = 0
    alpha: np.ndarray | None = None
    channels: dict[str, np.ndarray] = field(default_factory=dict)
    viewports: dict[str, np.ndarray] = field(default_factory=dict)


class Technique(Protocol):
    """A way of making the frames of a scene. Everything random comes from ``seed``; ``reset`` starts anew."""

    name: ClassVar[str]
    Params: ClassVar[type[BaseModel]]

    def __init__(
        self, engine: Engine, size_px: tuple[int, int], params: BaseModel, seed: int, measure: Measure
    ) -> None: ...

    def reset(self, seed: int) -> None:
        """Forget all history; the same views then give the same frames, byte for byte."""
        ...

    def render(self, view: View) -> Frame:
        """The picture of this refresh."""
        ...


class LazyCounts(Mapping[str, int]):
    """Ray counts that are reduced from device arrays only when somebody reads them."""

    def __init__(self, sources: Mapping[str, int | Callable[[], int]]) -> None:
        self._sources: dict[str, int | Callable[[], int]] = dict(sources)

    def __getitem__(self, kind: str) -> int:
        value = self._sources[kind]
        if not isinstance(value, int):
            value = self._sources[kind] = int(value())
        return value

    def __iter__(self):
        return iter(self._sources)

    def __len__(self) -> int:
        return len(self._sources)
