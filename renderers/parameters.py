"""The parameters of every technique: pydantic models with units, ranges and defaults. No engine is imported here."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator


class Parameters(BaseModel):
    """Base of all parameter models: unknown names are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


LightSamples = Literal[1, 4, 9, 16, 25, 36, 49, 64, 81, 100, 144, 256]
"""Shadow rays for each light with an area: one in each cell of a square grid."""


class Reference(Parameters):
    """The gold standard: ``spp`` samples a pixel, averaged linearly before any tone curve; zero delay."""

    spp: int = Field(64, ge=1, le=65536)


class Vanilla(Parameters):
    """One sample at each pixel's centre. ``light_samples``: shadow rays for each light with an area, a square number;
    ``delay_frames``: the picture is of so many refreshes ago (double buffering)."""

    light_samples: LightSamples = 1
    delay_frames: int = Field(default=0, ge=0, le=8)


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
    light_samples: LightSamples = 1
    box_sigmas: float = Field(1.0, ge=0, le=8)
    least_sigma: float = Field(0.0, ge=0, le=1)


class TemporalAntialiasing(Parameters):
    """``form`` 'longest': longest motion of 3x3, variance box, YCoCg, anti-flicker (as Falcor); 'karis': Halton jitter,
    mean of min/max boxes, clip towards the centre, luminance weights (Karis 2014). ``alpha``: the newest's weight."""

    form: Literal["longest", "karis"] = "longest"
    alpha: float = Field(0.1, gt=0, le=1)
    box_sigmas: float = Field(1.0, ge=0, le=8)
    reflected_motion: bool = True
    light_samples: LightSamples = 1
    delay_frames: int = Field(default=0, ge=0, le=8)


class Checkerboard(Parameters):
    """Half of the pixels a frame, in alternating checkerboards; the others reprojected or interpolated."""

    reflected_motion: bool = True
    light_samples: LightSamples = 1
    box_sigmas: float = Field(1.0, ge=0, le=8)


class FramedLowResolution(Parameters):
    """Every refresh at ``samples_per_s`` primary rays a second (rounded down to whole pixels), enlarged bilinearly."""

    samples_per_s: float = Field(3.3e6, gt=0)
    light_samples: LightSamples = 1
    delay_frames: int = Field(default=0, ge=0, le=8)


class FramedLowRate(Parameters):
    """Full resolution as often as ``samples_per_s`` allows; the last whole frame is held between."""

    samples_per_s: float = Field(3.3e6, gt=0)
    light_samples: LightSamples = 1
    delay_frames: int = Field(default=0, ge=0, le=8)


class TraditionalFrameless(Parameters):
    """Bishop et al. 1994: ``samples_per_s`` single pixels a second in random order; each shows its newest sample."""

    samples_per_s: float = Field(400_000.0, gt=0)


FOVEAL_REGIONS: dict[str, tuple[float, float, float]] = {
    "small": (5.0, 10.0, 0.01),
    "medium": (10.0, 20.0, 0.05),
    "large": (15.0, 30.0, 0.1),
    "full": (math.inf, math.inf, 1.0),
}
"""r0, r1 in degrees and p_min of the paper's configurations (Weier et al. 2016, 4.2.1)."""


class Foveated(Parameters):
    """Weier et al. 2016. ``configuration`` names the paper's r0, r1 (degrees) and p_min; each may be set by itself.

    ``k_min``, ``k_max``: weights of a new sample against a cached one that is 1, and ``t_max`` or more frames old
    (None: 0.213 s); the same for ``light`` (area lights, ambient occlusion). ``eps_depth`` relative, ``eps_lum`` on
    display luma, ``eps_edge`` on max(n.d, 0): what is marked for resampling. ``n_fp`` taps in a pixel's footprint,
    ``footprint_sigma`` of a half of it; ``post_filter``: taps for the light of marked pixels (0: off).
    ``light_samples``: as for `Vanilla` (the paper's 8 is no square: 9), 1 by default so that 'full' is vanilla.
    ``rasteriser`` of the depth mesh, 'auto': moderngl where rays are traced on a GPU, else numba.

    The paper names no thresholds. Measured at 1182x1464 over the study's four scenes, 14 frames, medium: ``eps_lum``
    0.1 (SMAA's) traces 31 % of the pixels, 0.35 the 21 % of the paper, at an RMSE (8 bit codes) of 11 against 6 in
    tunnel_maps and the same in the others; half of the half footprint errs less (9.8) than 1 (11.9) or 0.25 (11.6).
    """

    configuration: Literal["small", "medium", "large", "full"] = "medium"
    r0_deg: float | None = Field(None, ge=0)
    r1_deg: float | None = Field(None, ge=0)
    p_min: float | None = Field(None, ge=0, le=1)
    k_min: float = Field(0.05, gt=0, le=1)
    k_max: float = Field(0.8, gt=0, le=1)
    light_k_min: float = Field(0.05, gt=0, le=1)
    light_k_max: float = Field(0.8, gt=0, le=1)
    t_max: int | None = Field(None, ge=1, le=100_000)
    eps_depth: float = Field(0.05, gt=0)
    eps_lum: float = Field(0.35, gt=0)
    eps_edge: float = Field(0.2, ge=0, le=1)
    n_fp: int = Field(4, ge=1, le=16)
    footprint_sigma: float = Field(0.5, ge=0, le=4)
    post_filter: int = Field(8, ge=0, le=64)
    support_divisor: float = Field(4.6, ge=1, le=64)
    reproject_movers: bool = True
    light_samples: LightSamples = 1
    rasteriser: Literal["auto", "numba", "moderngl"] = "auto"

    @property
    def region(self) -> tuple[float, float, float]:
        """r0 and r1 in degrees and p_min, single settings before the configuration's."""
        named = FOVEAL_REGIONS[self.configuration]
        own = (self.r0_deg, self.r1_deg, self.p_min)
        r0, r1, p_min = (a if b is None else b for a, b in zip(named, own, strict=True))
        return r0, r1, p_min

    @model_validator(mode="after")
    def _ordered(self) -> Foveated:
        r0, r1, _ = self.region
        if r1 < r0:
            raise ValueError(f"r1_deg of at least r0_deg = {r0:g} (it is {r1:g})")
        for low, high in (("k_min", "k_max"), ("light_k_min", "light_k_max")):
            if getattr(self, high) < getattr(self, low):
                raise ValueError(f"{high} of at least {low}")
        return self


class AdaptiveFrameless(Parameters):
    """Dayal et al. 2005. ``samples_per_s`` is the budget: every ray that starts at the eye, six a visit.

    Sampler: ``depth`` b of the deep buffer; ``kappa``, ``lambda_`` weigh undersampling and occlusion against variation,
    ``m`` is the threshold of undersampling (above 1 a buffer that is half empty never asks); each of the three counts
    times the tile's area to the ``area_power`` (0: splitting a textured tile never calms it, and it draws every tile
    to itself: on the kitchen's Interactive path 1.03 of full resolution instead of 0.77); ``i`` the gain;
    ``reprojected`` crosshairs a visit; a chunk has ``chunk_crosshairs`` and then ``tiling_moves`` splits or merges; a
    refresh's chunks are traced in ``launches`` (one by one where there are no more than that); at least
    ``least_tiles``, and tiles of ``least_mean_tile_px`` on average and ``least_tile_px`` each; ``decay_per_s`` ages
    samples. ``temporal_gradient``: 'fixed' compares samples at one place of the picture (the paper's), 'followed' at
    one point of the scene.
    Reconstructor: ``samples_kept_per_px`` newest samples; ``reproject`` them, along with movers (``reproject_movers``);
    ``filter_volume`` in volumes of a sample; gradients below ``least_spatial_gradient`` (display luma a pixel) and
    ``least_temporal_gradient`` (a second) count as these; ``filter_tail`` weighs samples out of reach;
    ``depth_tolerance``: older samples deeper than a newer one by this share are hidden (0: no such test);
    ``least_splat_px``: the smallest splat; ``splats`` 'auto': by moderngl where rays are traced on a GPU, else by
    numba.
    """

    samples_per_s: float = Field(400_000.0, gt=0)
    depth: int = Field(4, ge=1, le=16)
    kappa: float = Field(0.2, ge=0, le=1)
    lambda_: float = Field(0.2, ge=0, le=1)
    m: float = Field(1.0, ge=0)
    area_power: float = Field(1.0, ge=0, le=2)
    i: float = Field(0.3, gt=0)
    reprojected: int = Field(5, ge=0, le=6)
    chunk_crosshairs: int = Field(25, ge=1, le=100_000)
    launches: int = Field(2, ge=1, le=100_000)
    tiling_moves: int = Field(4, ge=1, le=64)
    least_tiles: int = Field(64, ge=1)
    least_mean_tile_px: int = Field(16, ge=1)
    least_tile_px: int = Field(4, ge=1)
    decay_per_s: float = Field(3.47, ge=0, le=100)
    temporal_gradient: Literal["fixed", "followed"] = "followed"
    samples_kept_per_px: float = Field(6.1, gt=0, le=256)
    reproject: bool = True
    reproject_movers: bool = True
    filter_volume: float = Field(4.0, gt=0)
    least_spatial_gradient: float = Field(1 / 255, gt=0)
    least_temporal_gradient: float = Field(0.01, gt=0)
    filter_tail: float = Field(1e-2, ge=0, le=1)
    depth_tolerance: float = Field(0.2, ge=0, le=10)
    least_splat_px: float = Field(2.0, ge=1, le=32)
    splats: Literal["auto", "numba", "moderngl"] = "auto"


PolarMapping = Literal["acuity", "equal_density"]


class Probes(Parameters):
    """The grid of light probes (Majercik et al. 2019): ``grid`` probes along x, y, z; ``rays`` a probe and update;
    every probe once in ``every_frames``; ``hysteresis`` the old value's weight; ``settle_passes`` updates of the whole
    grid at the start and after a cut. ``bias``: how far off the surface the grid is asked, share of 3/4 of a spacing.

    ``occlusion_rays`` short rays, ``occlusion_radius`` long (world units), darken corners; 0: none.
    """

    grid: tuple[int, int, int] = (16, 8, 16)
    rays: int = Field(64, ge=1, le=1024)
    every_frames: int = Field(8, ge=1, le=64)
    hysteresis: float = Field(0.97, ge=0, lt=1)
    settle_passes: int = Field(8, ge=0, le=256)
    bias: float = Field(0.3, ge=0, le=2)
    sharpness: float = Field(50.0, gt=0)
    backface_share: float = Field(0.1, ge=0, le=1)
    occlusion_rays: int = Field(4, ge=0, le=64)
    occlusion_radius: float = Field(0.5, gt=0)


class Polar(Parameters):
    """Peuhkurinen and Mikkonen 2021. ``width`` x ``height`` texels (None: as the display's pixels per degree ask);
    ``mapping`` 'acuity' is the paper's, 'equal_density' follows acuity squared (``mar_slope``, ``mar_foveal_deg``).

    ``dynamic_width``: W * clamp(1 - ``width_slope_s_per_deg`` * head speed, ``least_width``, 1). ``quality``: samples
    of an area light; 'by_pose' 256 below ``still_deg_s``, 64 below ``fast_deg_s``, else 1. ``probes``: light probes for
    this technique even where the clip's lighting has none. ``mixed_reality``: over the room's capture, with ``alpha``.
    """

    width: int | None = Field(None, ge=2, le=8192)
    height: int | None = Field(None, ge=4, le=8192, multiple_of=2)
    mapping: PolarMapping = "acuity"
    mar_slope: float = Field(0.022, gt=0, le=1)
    mar_foveal_deg: float = Field(1 / 48, gt=0, le=1)
    dynamic_width: bool = True
    width_slope_s_per_deg: float = Field(1 / 200, ge=0, le=1)
    least_width: float = Field(0.5, gt=0, le=1)
    quality: Literal["by_pose", 1, 64, 256] = "by_pose"
    still_deg_s: float = Field(2.0, ge=0)
    fast_deg_s: float = Field(20.0, ge=0)
    probes: bool = False
    probe_settings: Probes = Field(default_factory=Probes)  # type: ignore[arg-type]
    mixed_reality: bool = False
