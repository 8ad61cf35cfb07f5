"""The one registry of techniques: names, parameter models, knobs, and where each lives.

This is all that `protocols` sees of `renderers`: nothing here imports drjit, mitsuba, moderngl or a technique.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module

import numpy as np
from pydantic import BaseModel

from renderers import parameters as p
from renderers.technique import Gaze, Technique, ViewGeometry
from stimuli.errors import InputError, problem


@dataclass(frozen=True)
class Entry:
    """One technique as protocols, the command line and the tradeoff search see it.

    ``knobs`` name the parameters that trade speed for accuracy, with the values a sweep tries; ``operating_point`` is
    where the technique's paper used it, as far as that is not its parameters' defaults. ``gaze_contingent``
    techniques may not stand side by side. ``framed``: full frames at any content rate. ``stateless``: a frame follows
    from its view alone, so a clip may be divided among workers; ``probes_remember``: and so it does where there are no
    light probes. ``averages``: frames are means of ``spp`` samples.
    ``counts_samples``: its frames say how often each pixel was sampled.
    ``own_times``: each sample has a time of its own, so meshes that change their shape are refused.
    ``density``: module of ``picture_probability``, how likely each pixel is traced in a frame; ``density_params``: the
    parameters that it hangs on. ``full_rate_params``: those that its pictures hang on where every pixel is traced in
    every frame; there two techniques with the same values show the same (None: never).
    ``headset``: it also renders the viewports of its paper's headset (`renderers.stereo`).
    """

    name: str
    summary: str
    params: type[BaseModel]
    module: str
    class_name: str
    knobs: Mapping[str, tuple[object, ...]]
    operating_point: Mapping[str, object] = field(default_factory=dict)
    gaze_contingent: bool = False
    framed: bool = False
    baseline: bool = False
    stateless: bool = False
    probes_remember: bool = False
    averages: bool = False
    counts_samples: bool = False
    own_times: bool = False
    density: str = ""
    density_params: tuple[str, ...] = ()
    full_rate_params: tuple[str, ...] | None = None
    headset: bool = False


_BUDGETS = (1e5, 4e5, 8e5, 1.6e6, 3.2e6, 6.4e6)
_DAYAL_2005 = {"samples_per_s": 4e5}
"""The middle budget of Table 1 in Dayal et al. 2005, the only one that all its methods and animations have."""

_ENTRIES: tuple[Entry, ...] = (
    Entry(
        name="reference",
        summary="the gold standard: many samples a pixel, no delay",
        params=p.Reference,
        module="renderers.reference",
        class_name="ReferenceRenderer",
        knobs={"spp": (1, 2, 4, 8, 16, 32, 64, 256)},
        framed=True,
        stateless=True,
        averages=True,
        counts_samples=True,
    ),
    Entry(
        name="vanilla",
        summary="one sample at each pixel's centre, every refresh",
        params=p.Vanilla,
        module="renderers.vanilla",
        class_name="Vanilla",
        knobs={},
        full_rate_params=("light_samples", "delay_frames"),
        framed=True,
        baseline=True,
        stateless=True,
        counts_samples=True,
    ),
    Entry(
        name="taa",
        summary="temporal antialiasing: a jittered sample a pixel, accumulated along the motion",
        params=p.TemporalAntialiasing,
        module="renderers.temporal_antialiasing",
        class_name="TemporalAntialiasing",
        knobs={"alpha": (0.05, 0.1, 0.2), "box_sigmas": (0.75, 1.0, 1.25), "form": ("longest", "karis")},
        framed=True,
        baseline=True,
        counts_samples=True,
    ),
    Entry(
        name="temporally_dense",
        summary="a quarter of the pixels a refresh in adaptive 2x2 orders, the others reprojected",
        params=p.TemporallyDense,
        module="renderers.temporally_dense.technique",
        class_name="TemporallyDense",
        knobs={"order": ("adaptive", "hourglass", "bowtie", "random"), "box_sigmas": (0.75, 1.0, 1.25)},
        counts_samples=True,
    ),
    Entry(
        name="foveated",
        summary="few pixels far from the gaze a refresh, the others reprojected (Weier et al. 2016)",
        params=p.Foveated,
        module="renderers.foveated.technique",
        class_name="Foveated",
        knobs={"configuration": ("small", "medium", "large"), "p_min": (0.01, 0.05, 0.1), "k_min": (0.05, 0.1, 0.2)},
        gaze_contingent=True,
        density="renderers.foveated.foveal_function",
        density_params=("configuration", "r0_deg", "r1_deg", "p_min"),
        full_rate_params=("light_samples",),
        counts_samples=True,
        headset=True,
    ),
    Entry(
        name="checkerboard",
        summary="half of the pixels a refresh, the others reprojected",
        params=p.Checkerboard,
        module="renderers.checkerboard",
        class_name="Checkerboard",
        knobs={"box_sigmas": (0.75, 1.0, 1.25)},
        baseline=True,
        counts_samples=True,
    ),
    Entry(
        name="framed_low_resolution",
        summary="every refresh at the resolution that a budget of samples allows, enlarged",
        params=p.FramedLowResolution,
        module="renderers.framed",
        class_name="FramedLowResolution",
        knobs={"samples_per_s": _BUDGETS},
        operating_point=_DAYAL_2005,
        baseline=True,
        stateless=True,
    ),
    Entry(
        name="framed_low_rate",
        summary="whole frames as often as a budget of samples allows, held between",
        params=p.FramedLowRate,
        module="renderers.framed",
        class_name="FramedLowRate",
        knobs={"samples_per_s": _BUDGETS},
        operating_point=_DAYAL_2005,
        baseline=True,
        counts_samples=True,
    ),
    Entry(
        name="adaptive_frameless",
        summary="samples at their own times where colour changes most, reconstructed by space-time filters",
        params=p.AdaptiveFrameless,
        module="renderers.adaptive_frameless.technique",
        class_name="AdaptiveFrameless",
        knobs={
            "samples_per_s": _BUDGETS,
            "filter_volume": (2.0, 4.0, 8.0),
            "reprojected": (0, 5),
        },
        operating_point=_DAYAL_2005,
        own_times=True,
    ),
    Entry(
        name="traditional_frameless",
        summary="pixels in random order, each at its own time; the newest sample is shown",
        params=p.TraditionalFrameless,
        module="renderers.adaptive_frameless.traditional",
        class_name="TraditionalFrameless",
        knobs={"samples_per_s": _BUDGETS},
        operating_point=_DAYAL_2005,
        baseline=True,
        own_times=True,
    ),
    Entry(
        name="polar",
        summary="rays in a polar buffer around the gaze, as dense as the eye's acuity asks",
        params=p.Polar,
        module="renderers.polar.technique",
        class_name="Polar",
        knobs={"mapping": ("acuity", "equal_density"), "width": (32, 64, 128, 256, 512), "quality": (1, 64, 256)},
        gaze_contingent=True,
        probes_remember=True,
        headset=True,
    ),
)
CATALOGUE: Mapping[str, Entry] = {entry.name: entry for entry in _ENTRIES}


def entry(name: str, where: str = "technique") -> Entry:
    """The entry of ``name``; InputError with the valid names where there is none."""
    if name not in CATALOGUE:
        raise InputError(problem(where, "unknown technique", repr(name), " | ".join(CATALOGUE)))
    return CATALOGUE[name]


def sampling_probability(
    name: str, params: BaseModel, size_px: tuple[int, int], geometry: ViewGeometry, gaze: Gaze | None = None
) -> np.ndarray | None:
    """(H, W): how likely technique ``name`` traces each pixel of a panel seen in ``geometry``; numpy alone. None where
    the technique's samples do not hang on eccentricity, and some pixels are not traced."""
    module = CATALOGUE[name].density
    if not module:
        return None if CATALOGUE[name].full_rate_params is None else np.ones(size_px[::-1])
    # The camera's field does not matter where the screen's geometry is given.
    return import_module(module).picture_probability(params, size_px, 1.0, geometry, gaze)


def side_by_side() -> tuple[str, ...]:
    """The techniques that may stand beside each other: those that do not follow the gaze, without the reference."""
    return tuple(name for name, entry in CATALOGUE.items() if not entry.gaze_contingent and name != "reference")


class _Techniques(Mapping[str, type[Technique]]):
    """name -> class; the class's module is imported when it is first asked for."""

    def __getitem__(self, name: str) -> type[Technique]:
        found = CATALOGUE[name]
        return getattr(import_module(found.module), found.class_name)

    def __iter__(self) -> Iterator[str]:
        return iter(CATALOGUE)

    def __len__(self) -> int:
        return len(CATALOGUE)


TECHNIQUES: Mapping[str, type[Technique]] = _Techniques()
