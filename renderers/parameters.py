"""The parameters of every technique: pydantic models with units, ranges and defaults. No engine is imported here."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class Parameters(BaseModel):
    """Base of all parameter models: unknown names are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Reference(Parameters):
    """The gold standard: ``spp`` samples a pixel, averaged linearly before any tone curve; zero delay."""

    spp: int = Field(64, ge=1, le=65536)


class Vanilla(Parameters):
    """One sample at each pixel's centre. ``light_samples``: shadow rays for each light with an area, a square number;
    ``delay_frames``: the picture is of so many refreshes ago (double buffering)."""

    light_samples: Literal[1, 4, 9, 16, 25, 36, 49, 64, 81, 100, 144, 256] = 1
    delay_frames: int = Field(0, ge=0, le=8)


class TemporallyDense(Parameters):
    """Andersson et al. 2019. ``order`` is each tile's pixel order; ``decision`` the function of Fig. 10 behind
    'adaptive'; ``neighbourhood`` the box an old pixel is clamped to (Fig. 7; the first is the paper's choice).

    ``box_sigmas`` and ``least_sigma`` (display-linear) shape that box; ``reproject`` False leaves the bare 2x2 mosaic.
    """

    order: Literal["adaptive", "hourglass", "bowtie", "random", "dominant"] = "adaptive"
    decision: Literal["combined", "up", "down", "dominant"] = "combined"
    neighbourhood: Literal["recent_immediate", "recent_3x3", "all_immediate"] = "recent_immediate"
    reproject: bool = True
    reflected_motion: bool = True
    box_sigmas: float = Field(1.0, ge=0, le=8)
    least_sigma: float = Field(0.0, ge=0, le=1)


class TemporalAntialiasing(Parameters):
    """``form`` 'longest': longest motion of 3x3, variance box, YCoCg, anti-flicker (as Falcor); 'karis': Halton jitter,
    mean of min/max boxes, clip towards the centre, luminance weights (Karis 2014). ``alpha``: the new sample's weight."""

    form: Literal["longest", "karis"] = "longest"
    alpha: float = Field(0.1, gt=0, le=1)
    box_sigmas: float = Field(1.0, ge=0, le=8)
    reflected_motion: bool = True
    delay_frames: int = Field(0, ge=0, le=8)


class Checkerboard(Parameters):
    """Half of the pixels a frame, in alternating checkerboards; the others reprojected or interpolated."""

    reflected_motion: bool = True
    box_sigmas: float = Field(1.0, ge=0, le=8)


class FramedLowResolution(Parameters):
    """Every refresh at ``samples_per_s`` primary rays a second (rounded down to whole pixels), enlarged bilinearly."""

    samples_per_s: float = Field(3.3e6, gt=0)
    delay_frames: int = Field(0, ge=0, le=8)


class FramedLowRate(Parameters):
    """Full resolution as often as ``samples_per_s`` allows; the last whole frame is held between."""

    samples_per_s: float = Field(3.3e6, gt=0)
    delay_frames: int = Field(0, ge=0, le=8)


class TraditionalFrameless(Parameters):
    """Bishop et al. 1994: ``samples_per_s`` single pixels a second in random order; each shows its newest sample."""

    samples_per_s: float = Field(400_000.0, gt=0)
