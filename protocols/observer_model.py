"""The generating model of simulated observers, as a protocol states it; `observer.py` answers from it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from protocols.quantity import Model, Name, NonNegative, Positive, Share, Text, wrong

Logit = Annotated[float, Field(ge=-50, le=50)]
Spread = Annotated[float, Field(ge=0, le=20)]


class Spreads(Model):
    """How observers differ: SD over observers, in logits, of their preference for a condition, and for a condition
    in a scene."""

    condition: Spread = 0.5
    scene_condition: Spread = 0.0


class ReactionTime(Model):
    """Shifted lognormal: shift + median exp(sd_log z), counted from the end of the stimulus; ``observer_sd_log``
    lets some observers be slower."""

    median_s: Positive = 0.7
    sd_log: Annotated[float, Field(ge=0, le=3)] = 0.35
    shift_s: NonNegative = 0.15
    observer_sd_log: Annotated[float, Field(ge=0, le=3)] = 0.2


class Means(Model):
    """A table of ratings: the levels of the factors ``by``, joined by ``:``, -> what is added to the mean rating."""

    by: Annotated[list[Name], Field(min_length=1, max_length=6)]
    values: dict[str, Annotated[float, Field(ge=-100, le=100)]]


class LikertModel(Model):
    """How ratings come about, in one of two ways.

    From ``thresholds`` (one fewer than points, rising): latent = utility of the condition (with this observer's
    deviations) + logistic noise times ``noise_sd``; the rating counts the thresholds below it. ``threshold_shift``:
    column (technique, scene, a factor) -> level -> what is added to every threshold there.

    From ``mean`` and ``means``: the mean rating of a cell over the population of observers is mean + the sum of the
    tables' entries (exactly so after rounding to the scale). ``observer_sd``: SD of an observer's offset;
    ``level_sd``: factor -> SD of an observer's offset for each of its levels; ``noise_sd``: from trial to trial.
    """

    thresholds: list[Logit] | None = None
    threshold_shift: dict[Name, dict[str, Logit]] = Field(default_factory=dict)
    mean: float | None = None
    means: list[Means] = Field(default_factory=list)
    observer_sd: Spread = 0.5
    level_sd: dict[Name, Spread] = Field(default_factory=dict)
    noise_sd: Spread = 1.0

    @model_validator(mode="after")
    def _one_way(self) -> LikertModel:
        if (self.thresholds is None) == (self.mean is None):
            raise wrong("both or neither of thresholds and mean", "one of thresholds and mean")
        if self.thresholds is not None and sorted(set(self.thresholds)) != self.thresholds:
            raise wrong(self.thresholds, "thresholds that rise")
        return self


class Pictures(Model):
    """Utilities taken from the frames really shown: minus ``logits_per_unit`` times a metric of their error against
    the reference. `studyapp` computes the metric from the play cache and the recorded refreshes and hands it in."""

    metric: Literal["rmse", "flip", "flicker"] = "rmse"
    logits_per_unit: Annotated[float, Field(gt=0, le=1e6)]


class ObserverModel(Model):
    """Simulated observers. ``utilities``: condition (or technique) -> logits; the chance that A is chosen over B is
    the logistic function of their difference. ``scene_utilities``: scene -> condition -> what is added there."""

    source: Text | None = Field(default=None, description="where the numbers come from")
    utilities: dict[Name, Logit] = Field(default_factory=dict)
    default_utility: Logit = 0.0
    scene_utilities: dict[Name, dict[Name, Logit]] = Field(default_factory=dict)
    sd: Spreads = Spreads()
    lapse: Share = 0.02
    side_bias: Logit = 0.0
    side_bias_sd: Spread = 0.1
    tie_width: Annotated[float, Field(ge=0, le=20)] = Field(
        default=0.5, description="utility difference taken as a tie"
    )
    rt: ReactionTime = ReactionTime()
    likert: dict[Name, LikertModel] = Field(default_factory=dict)
    pictures: Pictures | None = None
    no_answer: Share = Field(default=0.0, description="share of trials without any answer")
