"""Which conditions are made equal before they are compared, and in what; `studyapp match` solves the named knobs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from protocols.quantity import Model, Name, Positive, wrong


class Knob(Model):
    """The parameter that may be turned to meet the target: within a range, or to one of some values."""

    condition: Name
    parameter: Name
    low: float | None = None
    high: float | None = None
    whole: bool = False
    values: list[float | int | str | bool] | None = Field(default=None, min_length=2, max_length=50)

    @model_validator(mode="after")
    def _range(self) -> Knob:
        if self.values is not None:
            if self.low is not None or self.high is not None or self.whole:
                raise wrong("both a range and values", "one of them")
        elif self.low is None or self.high is None or not self.low < self.high:
            raise wrong(f"low {self.low}, high {self.high}", "low less than high (or values: [...])")
        return self


class Matched(Model):
    """What `studyapp match` found of one condition: ``value`` against ``target``, in the match's unit at the protocol's
    own size (the mean over scenes); ``mismatch`` = value / target - 1; ``matched``: within the tolerance."""

    condition: Name
    value: float
    target: float
    mismatch: float
    matched: bool


class Match(Model):
    """``cost`` or ``quality`` is made equal over ``conditions``: to ``target``, or to what ``to`` (a condition) has.

    cost: rays_per_s, samples_per_s (primary rays), ms_on_machine (median ms of a frame that is traced); quality: rmse,
    psnr, flip (a still eye's), flicker against the reference. ``tolerance`` is relative. ``found`` is written by
    `studyapp match` into the lock file, not by an author.
    """

    cost: Literal["rays_per_s", "ms_on_machine", "samples_per_s"] | None = None
    quality: Literal["rmse", "psnr", "flip", "flicker"] | None = None
    conditions: Annotated[list[Name], Field(min_length=1)]
    to: Name | None = None
    target: Positive | None = None
    knobs: list[Knob] = Field(default_factory=list)
    tolerance: Annotated[float, Field(gt=0, le=1)] = 0.05
    found: list[Matched] = Field(default_factory=list, max_length=100)

    @model_validator(mode="after")
    def _one_target(self) -> Match:
        if (self.cost is None) == (self.quality is None):
            raise wrong("both or neither of cost and quality", "one of cost and quality")
        if (self.to is None) == (self.target is None):
            raise wrong("both or neither of to and target", "one of to (a condition) and target (a number)")
        return self
