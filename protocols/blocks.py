"""Blocks: what kind of trial, which factors are crossed, in which order, how often."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from protocols.conditions import Settings
from protocols.quantity import Model, Name, Text, wrong

PAIR_KINDS = ("side_by_side", "forced_choice", "two_interval")
SIDE_BY_SIDE_KINDS = ("side_by_side", "forced_choice")
WORD_KINDS = ("instructions", "consent", "break")
Count = Annotated[int, Field(ge=1, le=1000)]


def _levels(value: Any) -> Any:
    """[a, b] means levels that set nothing but what the factor's own name says."""
    if isinstance(value, list) and all(isinstance(level, (str, int, float)) for level in value):
        names = [str(level) for level in value]
        if len(set(names)) != len(names):
            raise wrong(names, "every level once")
        return {name: {} for name in names}
    return value


Levels = Annotated[dict[Name, Settings], Field(min_length=1, max_length=200), BeforeValidator(_levels)]


class Compare(Model):
    """Which conditions stand together in a trial.

    ``of``: the conditions, or ``techniques`` for those of the study's ``techniques:`` line. ``alternatives``: how
    many stand together. ``sets``: ``all`` combinations, each ``against`` one, or those listed. ``spread_over``: each
    combination is shown with one level of these factors, which rotates from participant to participant, instead of
    with every level.
    """

    of: list[Name] = Field(min_length=1, max_length=60)
    alternatives: Annotated[int, Field(ge=2, le=4)] = 2
    sets: Literal["all"] | list[list[Name]] = "all"
    against: Name | None = None
    spread_over: list[Name] = Field(default_factory=list)


class Order(Model):
    """The order of a block's trials.

    ``by``: shuffle (all trials), as_written, or blocked (all trials of one level of ``blocked_by`` together).
    ``latin``: this factor's levels follow a Latin square balanced for carry-over, one row a participant.
    ``max_in_a_row``: factor (or condition, scene, side) -> longest run; ``min_distance``: factor (or cell) -> trials
    between two of the same.
    """

    by: Literal["shuffle", "as_written", "blocked"] = "shuffle"
    blocked_by: Name | None = None
    latin: Name | None = None
    max_in_a_row: dict[Name, Count] = Field(default_factory=dict)
    min_distance: dict[Name, Count] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> Order:
        if (self.by == "blocked") != (self.blocked_by is not None):
            raise wrong(f"by: {self.by}, blocked_by: {self.blocked_by}", "blocked_by exactly where by is blocked")
        return self


class Catch(Model):
    """Trials with a known answer. Pairs: ``good`` stands against ``bad``. Likert: ``bad`` (or ``good``) is shown and
    the rating must lie within ``expect``."""

    trials: Count = 2
    good: Name | None = None
    bad: Name | None = None
    expect: tuple[int, int] | None = None
    question: Name | None = None


class ExplicitTrial(Model):
    """A trial written out: levels of factors, the conditions that stand together, and settings of its own."""

    levels: dict[Name, str] = Field(default_factory=dict)
    compare: list[Name] | None = None
    set: Settings = Settings()
    repetitions: Count = 1


class Adaptive(Model):
    """Trials that depend on the answers: one procedure for each combination of the block's factors, interleaved.

    staircase (``down`` right answers make it harder, one wrong makes it easier) and quest_plus (Watson 2017): ``test``
    with ``parameter`` at one of ``values`` (easiest to tell first) stands against ``standard``; right is to choose
    the standard. active_pairs: the conditions of ``compare``, always the pair that promises most information.
    """

    kind: Literal["staircase", "quest_plus", "active_pairs"]
    parameter: Name | None = None
    values: list[float] = Field(default_factory=list, max_length=200)
    test: Name | None = None
    standard: Name | None = None
    down: Annotated[int, Field(ge=1, le=6)] = 2
    reversals: Annotated[int, Field(ge=2, le=40)] = 8
    trials: Annotated[int, Field(ge=1, le=1000)] = 60
    lapse: Annotated[float, Field(ge=0, le=0.2)] = 0.02

    @model_validator(mode="after")
    def _complete(self) -> Adaptive:
        if self.kind != "active_pairs":
            if self.parameter is None or self.test is None or self.standard is None:
                raise wrong("not all of parameter, test, standard", f"all three, since the kind is {self.kind}")
            if len(set(self.values)) < 2 or len(set(self.values)) != len(self.values):
                raise wrong(f"{len(self.values)} values", "at least two different values, easiest first")
        return self


class Block(Model):
    """A run of trials of one kind."""

    name: Name
    kind: Literal["side_by_side", "forced_choice", "two_interval", "likert", "instructions", "consent", "break"]
    text: Text | None = None
    reference: Name | None = Field(
        default=None, description="condition in the middle (or first, in two-interval trials)"
    )
    factors: dict[Name, Levels] = Field(default_factory=dict)
    compare: Compare | None = None
    questions: list[Name] = Field(default_factory=list)
    repetitions: Count = 1
    set: Settings = Settings()
    order: Order = Order()
    practice: Annotated[int, Field(ge=0, le=200)] | list[ExplicitTrial] = 0
    practice_set: Settings = Settings()
    feedback: bool = False
    catch: Catch | None = None
    trials: list[ExplicitTrial] | None = Field(
        default=None, description="trials written out instead of crossed factors"
    )
    adaptive: Adaptive | None = None
    break_every: Count | None = None
    break_text: Text = "Take a short break. Press a key to go on."
    only: dict[Name, str] = Field(
        default_factory=dict, description="between factor -> level whose people see this block"
    )

    @model_validator(mode="after")
    def _complete(self) -> Block:
        if self.kind in WORD_KINDS:
            if self.text is None:
                raise wrong("no text", f"text, since the kind is {self.kind}")
            for key in ("factors", "compare", "questions", "practice", "catch", "trials", "adaptive", "reference"):
                if getattr(self, key):
                    raise wrong(f"{key}: in a block of words", f"no {key} where the kind is {self.kind}")
            return self
        if not self.questions:
            raise wrong("no questions", "questions: [NAME, ...]")
        if self.kind == "side_by_side" and self.reference is None:
            raise wrong("no reference", "reference: CONDITION, which stands in the middle (or kind: forced_choice)")
        if self.kind == "likert" and (self.compare is not None or self.reference is not None):
            raise wrong("compare or reference", "one sequence a trial, where the kind is likert")
        if self.adaptive is not None:
            if self.kind not in PAIR_KINDS or self.trials is not None or self.practice or self.catch:
                raise wrong(
                    "adaptive with ratings, trials, practice or catch",
                    f"a block of pairs ({' | '.join(PAIR_KINDS)}) with nothing else that makes trials",
                )
            if (self.adaptive.kind == "active_pairs") != (self.compare is not None):
                raise wrong(f"adaptive {self.adaptive.kind}", "compare exactly where the kind is active_pairs")
        if self.kind in PAIR_KINDS and self.adaptive is None:
            if self.trials is None and self.compare is None:
                raise wrong("no compare", f"compare: {{of: [...]}}, since the kind is {self.kind}")
            if self.compare is not None and self.kind != "forced_choice" and self.compare.alternatives != 2:
                raise wrong(f"{self.compare.alternatives} alternatives", f"2, since the kind is {self.kind}")
        if self.reference and self.kind == "forced_choice" and self.compare and self.compare.alternatives > 3:
            raise wrong("4 alternatives and a reference", "at most 4 panels")
        return self
