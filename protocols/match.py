"""Which conditions are made equal before they are compared, and in what; `studyapp match` solves the named knobs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from protocols.quantity import Model, Name, Positive, wrong


class Knob(Model):
    """The parameter that may be turned to meet the target, and the range it may be turned in."""

    condition: Name
    parameter: Name
    low: float
    high: float
    whole: bool = False

    @model_validator(mode="after")
    def _range(self) -> Knob:
        if not self.low < self.high:
            raise wrong(f"low {self.low}, high {self.high}", "low less than high")
        return self


class Match(Model):
    """``cost`` or ``quality`` is made equal over ``conditions``: to ``target``, or to what ``to`` (a condition) has.

    cost: rays_per_s, samples_per_s (primary rays), ms_on_machine (median ms a frame); quality: rmse, flip, flicker
    against the reference. ``tolerance`` is relative.
    """

    cost: Literal["rays_per_s", "ms_on_machine", "samples_per_s"] | None = None
    quality: Literal["rmse", "psnr", "flip", "flicker"] | None = None
    conditions: Annotated[list[Name], Field(min_length=1)]
    to: Name | None = None
    target: Positive | None = None
    knobs: list[Knob] = Field(default_factory=list)
    tolerance: Annotated[float, Field(gt=0, le=1)] = 0.05

    @model_validator(mode="after")
    def _one_target(self) -> Match:
        if (self.cost is None) == (self.quality is None):
            raise wrong("both or neither of cost and quality", "one of cost and quality")
        if (self.to is None) == (self.target is None):
            raise wrong("both or neither of to and target", "one of to (a condition) and target (a number)")
        return self
