"""Questions as a protocol writes them: a choice between slots, a Likert item, a confirmation."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from protocols.quantity import Model, NonNegative, Positive, Text, wrong


class QuestionSpec(Model):
    """One question.

    ``kind`` choice: the options are the slots of the trial's candidates (and ``tie``, where allowed); likert: whole
    numbers ``low``..``high``, one key each; confirm: go on. ``keys``: key -> answer; None takes the usual keys.
    ``balance``: for every second participant the scale runs the other way (likert) or the keys of the answers are
    exchanged (choice); choices by position (left, right) are never exchanged.
    """

    kind: Literal["choice", "likert", "confirm"]
    text: Text
    low: int = Field(default=-3, ge=-50, le=50)
    high: int = Field(default=3, ge=-50, le=50)
    labels: dict[str, str] = Field(default_factory=dict, description="answer -> words beside it")
    ties: bool = False
    keys: dict[str, str] | None = None
    balance: bool = False
    window_s: Positive | None = Field(default=None, description="longest time to answer; none: no limit")
    min_view_s: NonNegative = 0.0
    expected_s: Positive = Field(
        default=2.0, description="usual time to answer, for the estimate of the session's length"
    )

    @model_validator(mode="after")
    def _consistent(self) -> QuestionSpec:
        if self.kind == "likert":
            if self.high <= self.low:
                raise wrong(f"low {self.low}, high {self.high}", "low less than high")
            if self.high - self.low > 10:
                raise wrong(f"{self.high - self.low + 1} points", "at most 11 points on a Likert scale")
            for label in self.labels:
                if label not in self.answers:
                    raise wrong(f"a label for {label!r}", f"labels for {' | '.join(self.answers)}")
            if self.keys is not None and sorted(self.keys.values()) != sorted(self.answers):
                raise wrong(f"keys for {sorted(self.keys.values())}", "one key for each point of the scale")
            if self.ties:
                raise wrong("ties on a likert question", "ties only where the kind is choice")
        return self

    @property
    def answers(self) -> tuple[str, ...]:
        """The points of a Likert scale as text, in order; () for other kinds."""
        return tuple(str(point) for point in range(self.low, self.high + 1)) if self.kind == "likert" else ()
