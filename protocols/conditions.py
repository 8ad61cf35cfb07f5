"""What is shown: settings that cascade, scenes, and conditions (technique + parameters + rate)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from protocols.quantity import Exact, Model, Name, NonNegative, PositiveExact, Rate, Share, Size

Fixation = Literal["free", "fixed", "moving"]
Lighting = Literal["direct", "ambient_occlusion", "probes"]
Mirror = Literal["none", "sides", "pictures"]
Channels = Annotated[list[Literal["depth", "motion", "samples"]], Field(max_length=3)]


class Settings(Model):
    """How a trial's pictures are made and shown. Every value may be left out; the next wider level then decides.

    From wide to narrow: the study's ``defaults``, the scene, the block's ``set``, a factor's level, a trial's own.
    """

    size_px: Size | None = None
    duration_s: PositiveExact | None = None
    rate_hz: Rate | None = Field(default=None, description="content rate, where the condition names none")
    start_s: Exact | None = None
    warm_up_s: Exact | None = None
    path: Name | None = Field(
        default=None, description="file | still | sway | toycar | interactive | a name under paths"
    )
    animation: str | None = None
    lighting: Lighting | None = None
    loop: Literal["once", "closed"] | None = None
    fixation: Fixation | None = Field(default=None, description="free look, a cross at the centre, or a moving target")
    live: bool | None = Field(default=None, description="rendered per refresh instead of played from the store")
    gap_px: Annotated[int, Field(ge=0, le=4096)] | None = None
    mirror: Mirror | None = Field(
        default=None,
        description="sides: panels stand right to left (a display seen by way of a mirror); pictures: those left of "
        "the middle are flipped, so that equal places meet at the seam",
    )
    interval_gap_s: NonNegative | None = Field(default=None, description="pause between the two intervals")
    iti_s: NonNegative | None = Field(default=None, description="pause before a trial")
    response: Literal["after", "during"] | None = None
    replays: Annotated[int, Field(ge=0, le=100)] | None = None
    condition: Name | None = None
    params: dict[Name, Any] | None = Field(default=None, description="added to the parameters of the condition")
    channels: Channels | None = Field(
        default=None, description="stored beside the colours, for other programs: depth, motion, samples"
    )


DEFAULTS = Settings(
    size_px=(512, 512), duration_s="4", start_s="0", warm_up_s="1", path="file", lighting="direct", loop="once",
    fixation="free", live=False, gap_px=16, mirror="none", interval_gap_s=0.5, iti_s=0.5, response="after",
    replays=0,
)  # fmt: skip


class Scene(Settings):
    """A scene under the study's own name for it. ``instead``: a procedural scene that stands in where the file is
    not found; the substitution is printed by `check` and stands in the session."""

    scene: str = Field(min_length=1, max_length=300, description="a procedural scene's name or a file's path")
    instead: Name | None = None
    exposure: Annotated[float, Field(gt=0, le=1e12)] | None = Field(
        default=None, description="none: from the reference"
    )


def _scene(value: Any) -> Any:
    return {"scene": value} if isinstance(value, str) else value


class Condition(Model):
    """A technique with its parameters and rate. ``technique``: a name of the catalogue, ``module:Class``, or
    ``imported:NAME`` for clips brought into the store from another renderer."""

    technique: str = Field(min_length=1, max_length=200)
    params: dict[Name, Any] = Field(default_factory=dict)
    rate_hz: Rate | None = Field(default=None, description="none: the trial's setting, else the display's refresh rate")
    live: bool | None = None
    channels: Channels | None = Field(default=None, description="none: the trial's setting")
    reference_error: Annotated[float, Field(gt=0, le=1)] | None = Field(
        default=None,
        description="standard error of display values in [0, 1] that decides a reference's samples, at most spp",
    )
    label: str | None = Field(default=None, max_length=80, description="how plots name it")

    @property
    def external(self) -> bool:
        """True where the catalogue does not know the technique's parameters."""
        return ":" in self.technique


def _condition(value: Any) -> Any:
    return {"technique": value} if isinstance(value, str) else value


SceneEntry = Annotated[Scene, BeforeValidator(_scene)]
ConditionEntry = Annotated[Condition, BeforeValidator(_condition)]


class Timing(Model):
    """What counts as a well-timed trial, and what is done with one that is not."""

    miss_policy: Literal["hold", "skip"] = Field(default="hold", description="after a miss: go on late, or skip frames")
    max_missed: Annotated[int, Field(ge=0)] = Field(default=0, description="missed refreshes that a trial may have")
    requeue: bool = Field(default=True, description="a trial whose timing failed is shown again at the block's end")
    lock: bool = Field(default=True, description="the display must be locked at the protocol's rate")
    luminance_limit: Share = Field(
        default=0.01, description="largest difference of mean luminance between compared clips"
    )
    photometry_max_age_days: Annotated[int, Field(ge=1)] = 180


class Gaze(Model):
    """What is asked of the eye tracker. Angles in degrees of visual angle."""

    required: bool = False
    rate_hz: Rate = "60"
    points: Literal[5, 9, 13] = 9
    accuracy_deg: NonNegative = 1.0
    precision_deg: NonNegative = 0.5
    loss: Share = 0.2
    drift_deg: NonNegative = 2.0
    fixation_limit_deg: NonNegative = Field(
        default=3.0, description="a fixated trial whose gaze strays further is flagged"
    )
    latency_p95_ms: NonNegative = 60.0
    show: bool = Field(default=False, description="a mark on the participant's own display where they look")
